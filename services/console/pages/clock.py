"""The site's clock and how fast it goes, as an element of a page."""

from __future__ import annotations

from nicegui import ui

from rodeo.person.pace import Pace


class Clock(ui.element, component="clock.js"):
    """It continues by itself between what `show` says."""

    def __init__(self, zone: str) -> None:
        super().__init__()
        self._props["zone"] = zone

    def show(self, pace: Pace | None) -> None:
        self.run_method("show", None if pace is None else [pace.now_s, pace.speed])
