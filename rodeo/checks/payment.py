"""Pay by quantity: price times quantity up to the agreed price, where the kind's rules have rates."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

from rodeo.checks.case import Case
from rodeo.currency import Currency
from rodeo.kinds import kinds_of
from rodeo.tariff import applying_between


class Step(NamedTuple):
    """A quantity that both sides vouch for."""

    since_s: float
    until_s: float
    """Between these site times it was provided."""
    quantity: Decimal
    """In the kind's measure."""


def by_rates_iec(case: Case, steps: Iterable[Step]) -> Decimal | None:
    """What `steps` are paid, as far as the token can pay it; None where the price is for the whole task.

    A step costs the lowest rate of its time. Who provides says when a step ends: by long ones, or by one that
    it dates back, it must not gain.
    """
    price = case.chain_record.task.price_iec if case.chain_record else None
    rates = kinds_of(case.site)[case.kind].rates if case.kind else ()
    if not rates or not price:
        return None
    due = Fraction(0)
    for step in steps:
        lowest = min(rate.iec for rate in applying_between(rates, *sorted(step[:2])))
        due += Fraction(step.quantity) * Fraction(lowest)
    return min(price, payable_iec(case, due))


def payable_iec(case: Case, due: Fraction) -> Decimal:
    """As much of what is due as the site's token can pay."""
    currency: Currency = case.site.economy.currency
    return currency.payable(due)
