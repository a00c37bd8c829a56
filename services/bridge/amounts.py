"""Amounts as the DAO plane writes them: decimal strings of the payment token."""

from __future__ import annotations

from typing import Any

from rodeo.chain.contracts.types import Event
from rodeo.money.currency import Currency

_AMOUNTS = frozenset({"reward", "price", "paid", "refund", "value", "amount", "bond", "penalty", "stake"})
"""Arguments of contract events that are wei of the payment token."""


def event_args(event: Event, currency: Currency) -> dict[str, Any]:
    """The event's arguments for JSON; amounts are named `..._iec`."""
    return {
        (f"{name}_iec" if name in _AMOUNTS else name): (
            currency.text(value) if name in _AMOUNTS else _fitting(value)
        )
        for name, value in event.args().items()
    }


def _fitting(value: Any) -> Any:
    """Numbers that a program in another language might round are decimal strings."""
    return str(value) if isinstance(value, int) and value >= 2**63 else value
