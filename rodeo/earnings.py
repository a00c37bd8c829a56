"""What participants earned and spent, by kind of work and week, from what the bridge's index tells."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from datetime import UTC, datetime, timedelta
from decimal import Decimal

from pydantic import BaseModel

from rodeo.config import TariffConfig
from rodeo.messages import Amount, Task
from rodeo.queries import Transaction
from rodeo.tariff import price_at

_ENERGY = "energy_wh"
"""Parameter of a task that sells energy: how much was ordered."""


class Line(BaseModel):
    """One participant's affairs with one kind of work in one week (UTC, from Monday)."""

    week: str
    """Its Monday, as 2026-05-04."""
    participant: str
    kind: str
    done: int = 0
    """Tasks that it was paid for."""
    earned_iec: Amount = Decimal(0)
    bought: int = 0
    """Tasks that it paid for."""
    spent_iec: Amount = Decimal(0)
    energy_kwh: float = 0.0
    """That it ordered in tasks that it paid for."""
    electricity_eur: float = 0.0
    """What that costs by the site's tariffs."""
    transactions: int = 0
    gas: int = 0
    """Of the transactions that its key signed."""


def earnings(
    tasks: Iterable[Task],
    transactions: Iterable[Transaction],
    tariffs: Iterable[TariffConfig],
    *,
    first_s: float = 0.0,
    last_s: float = math.inf,
    participants: Collection[str] = (),
    kinds: Collection[str] = (),
) -> list[Line]:
    """The lines, by week, participant and kind. Times are the blocks', s; empty collections filter nothing.

    A transaction about several tasks counts for the first of them. One whose receipt nobody knows counts with
    no gas.
    """
    tariffs = list(tariffs)
    known = {task.id: task for task in tasks}
    lines: dict[tuple[str, str, str], Line] = {}

    def line(time_s: float, participant: str, kind: str) -> Line | None:
        wanted = (not participants or participant in participants) and (not kinds or kind in kinds)
        if not wanted or not first_s <= time_s <= last_s:
            return None
        key = _monday(time_s), participant, kind
        return lines.setdefault(key, Line(week=key[0], participant=participant, kind=kind))

    for task in known.values():
        if task.settled is None or not task.paid_iec:
            continue
        if done := line(task.settled, task.executor_name or task.executor or "nobody", task.kind):
            done.done += 1
            done.earned_iec += task.paid_iec
        if bought := line(task.settled, task.creator_name or task.creator, task.kind):
            bought.bought += 1
            bought.spent_iec += task.paid_iec
            energy_kwh = float(task.params.get(_ENERGY, 0.0)) / 1000
            bought.energy_kwh += energy_kwh
            bought.electricity_eur += energy_kwh * float(price_at(tariffs, task.settled))
    for one in transactions:
        about = next((known[number] for number in one.task_ids if number in known), None)
        sender = one.sender_name or one.sender
        if about is not None and sender and (signed := line(one.time_s, sender, about.kind)):
            signed.transactions += 1
            signed.gas += one.gas_used or 0
    return [lines[key] for key in sorted(lines)]


def _monday(time_s: float) -> str:
    day = datetime.fromtimestamp(time_s, UTC).date()
    return (day - timedelta(days=day.weekday())).isoformat()
