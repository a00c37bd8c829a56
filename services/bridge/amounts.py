"""Amounts as the DAO plane writes them: decimal strings of IEC."""

from __future__ import annotations

from typing import Any

from rodeo.chain import Event, from_wei

_AMOUNTS = frozenset({"reward", "price", "paid", "refund", "value", "amount", "bond", "penalty"})
"""Arguments of contract events that are wei of IECoin."""


def iec(wei: int) -> str:
    """Wei as a decimal string of IEC, without exponent."""
    return f"{from_wei(wei):f}"


def event_args(event: Event) -> dict[str, Any]:
    """The event's arguments for JSON; amounts are named `..._iec`."""
    return {
        (f"{name}_iec" if name in _AMOUNTS else name): (iec(value) if name in _AMOUNTS else _fitting(value))
        for name, value in event.args().items()
    }


def _fitting(value: Any) -> Any:
    """Numbers that a program in another language might round are decimal strings."""
    return str(value) if isinstance(value, int) and value >= 2**63 else value
