"""What participants earned and spent, by kind of work and week, from what the bridge's index tells."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterable
from datetime import UTC, datetime, timedelta
from decimal import Decimal

from pydantic import BaseModel

from rodeo.bus.messages import Amount, Task
from rodeo.bus.queries import Transaction
from rodeo.charging.tariff import price_at
from rodeo.site.sections import TariffConfig

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
    """Gas of the transactions that its key signed."""
    fee_eth: Decimal = Decimal(0)
    """What they cost on the site's own chain."""
    without_gas: int = 0
    """Transactions whose gas nobody knows (yet): on a stopped site those that nobody had asked for."""


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

    A transaction about several tasks counts for the first of them.
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
            signed.fee_eth += Decimal(one.fee_wei or 0) / 10**18
            signed.without_gas += one.gas_used is None
    return [lines[key] for key in sorted(lines)]


def sums(lines: Iterable[Line]) -> list[Line]:
    """One line for each participant, over all weeks and kinds, with the first of its weeks."""
    found: dict[str, Line] = {}
    for one in lines:
        total = found.setdefault(
            one.participant, Line(week=one.week, participant=one.participant, kind="all kinds")
        )
        total.week = min(total.week, one.week)
        for name in _NUMBERS:
            setattr(total, name, getattr(total, name) + getattr(one, name))
    return list(found.values())


COLUMNS = (
    "week",
    "participant",
    "kind",
    "done",
    "earned, IEC",
    "bought",
    "spent, IEC",
    "kWh",
    "electricity, EUR",
    "transactions",
    "gas",
)


def cells(line: Line) -> tuple[str, ...]:
    """A line for people, under `COLUMNS`."""
    return (
        line.week,
        line.participant,
        line.kind,
        str(line.done),
        f"{line.earned_iec.normalize():f}",
        str(line.bought),
        f"{line.spent_iec.normalize():f}",
        f"{line.energy_kwh:.3f}",
        f"{line.electricity_eur:.3f}",
        str(line.transactions),
        f"{line.gas:,}" + (f" + {line.without_gas} unknown" if line.without_gas else ""),
    )


def as_csv(lines: Iterable[Line]) -> str:
    """For spreadsheets, with the fields of `Line`."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(Line.model_fields), lineterminator="\n")
    writer.writeheader()
    writer.writerows(line.model_dump(mode="json") for line in lines)
    return text.getvalue()


_NUMBERS = [name for name, field in Line.model_fields.items() if field.annotation is not str]


def _monday(time_s: float) -> str:
    day = datetime.fromtimestamp(time_s, UTC).date()
    return (day - timedelta(days=day.weekday())).isoformat()
