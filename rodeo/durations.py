"""Lengths of time as people read them."""

from __future__ import annotations


def span(seconds: float | None) -> str:
    """2 h 5 min, 3 min 20 s, 12 s"""
    if seconds is None:
        return ""
    whole = max(0, round(seconds))
    days, hours, minutes = whole // 86400, whole // 3600 % 24, whole // 60 % 60
    if days:
        return f"{days} d {hours} h"
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {whole % 60} s" if minutes else f"{whole} s"
