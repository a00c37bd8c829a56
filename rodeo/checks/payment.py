"""Pay by quantity: price times quantity up to the agreed price, where the kind's rules have rates."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

from rodeo.charging.tariff import applying_between
from rodeo.checks.case import Case
from rodeo.kinds import kinds_of
from rodeo.money.currency import Currency

WAITS_S = 1800.0
"""From the assignment to the first step, and from the last one to the submission: long enough for a robot
that drives to a dock."""


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
    it dates back, it must not gain. Where all clocks are said to be of long after the assignment, or of long
    before the submission, the chain only knows that it was in between.
    """
    price = case.chain_record.task.price_iec if case.chain_record else None
    rates = kinds_of(case.site)[case.kind].rates if case.kind else ()
    if not rates or not price:
        return None
    due, steps = Fraction(0), list(steps)
    times_s = [time_s for step in steps for time_s in step[:2]]
    for step in steps:
        lowest = min(rate.iec for rate in applying_between(rates, *_widened(case, sorted(step[:2]), times_s)))
        due += Fraction(step.quantity) * Fraction(lowest)
    return min(price, payable_iec(case, due))


def _widened(case: Case, step_s: list[float], times_s: list[float]) -> list[float]:
    """When a step was at the earliest and at the latest, of which the two sides say when it was."""
    assert case.chain_record is not None
    task, waits_s = case.chain_record.task, WAITS_S + case.slack_s
    if task.assigned is not None and min(times_s) - task.assigned > waits_s:
        step_s = [task.assigned, *step_s]
    if task.proof_submitted is not None and task.proof_submitted - max(times_s) > waits_s:
        step_s = [*step_s, task.proof_submitted]
    return [step_s[0], step_s[-1]]


def payable_iec(case: Case, due: Fraction) -> Decimal:
    """As much of what is due as the site's token can pay."""
    currency: Currency = case.site.economy.currency
    return currency.payable(due)
