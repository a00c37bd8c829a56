"""What happened to an account's money, in words, and what electricity cost meanwhile."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from decimal import Decimal
from typing import Any

from rodeo.config import TariffConfig
from services.console.formatting import moment

Json = dict[str, Any]

_HOUR_S = 3600
_DAY_S = 24 * _HOUR_S

_REASONS = {
    "escrow": "Reward of task {task} into escrow",
    "payment": "Payment for task {task}",
    "surplus": "Unspent reward of task {task}",
    "refund": "Refund of task {task}",
    "bond": "Bond of a service",
    "penalty": "Penalty for task {task}",
    "bond_returned": "Bond refunded",
    "collected": "Collected later",
    "deposit": "Deposit into the treasury",
    "withdrawal": "Withdrawal from the treasury",
    "mint": "First supply",
    "burn": "Burnt",
    "transfer": "Transfer",
}

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def reason(transfer: Json) -> str:
    """Why the money moved."""
    return _REASONS.get(transfer["reason"], str(transfer["reason"])).format(task=transfer["task_id"])


def price_at(tariffs: Iterable[TariffConfig], time_s: float) -> Decimal:
    """EUR/kWh at this site time."""
    ordered = sorted(tariffs, key=lambda tariff: tariff.from_hour)
    hour = int(time_s % _DAY_S // _HOUR_S)
    begun = [tariff for tariff in ordered if tariff.from_hour <= hour]
    return (begun or ordered)[-1].eur_kwh


def prices(tariffs: list[TariffConfig], first_s: float, last_s: float) -> list[tuple[float, float]]:
    """(site time, EUR/kWh) at both ends and at each change in between; at most 200 days of changes."""
    times = {first_s, last_s}
    start_s = first_s - first_s % _DAY_S
    for day in range(min(200, int((last_s - start_s) // _DAY_S) + 1)):
        times |= {start_s + day * _DAY_S + tariff.from_hour * _HOUR_S for tariff in tariffs}
    return [
        (time_s, float(price_at(tariffs, time_s))) for time_s in sorted(times) if first_s <= time_s <= last_s
    ]


def transfers_csv(transfers: Iterable[Json]) -> str:
    """One line per transfer of an account, newest first."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["time_utc", "from", "to", "change_iec", "balance_iec", "why", "task", "transaction"])
    for one in transfers:
        writer.writerow(
            [
                moment(one["time_s"]),
                _cell(one["sender_name"] or one["sender"]),
                _cell(one["to_name"] or one["to"]),
                one["change_iec"],
                one["balance_iec"],
                reason(one),
                "" if one["task_id"] is None else one["task_id"],
                one["tx_hash"],
            ]
        )
    return text.getvalue()


def _cell(text: str) -> str:
    """A text that no spreadsheet takes for a formula."""
    return "'" + text if text.startswith(_FORMULA_STARTS) else text
