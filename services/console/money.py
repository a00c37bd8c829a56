"""What happened to an account's money, in words."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from decimal import Decimal

from rodeo.bus.queries import Transfer
from rodeo.display.formatting import moment

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


def reason(transfer: Transfer) -> str:
    """Why the money moved."""
    return _REASONS.get(transfer.reason, transfer.reason).format(task=transfer.task_id)


def change(transfer: Transfer) -> Decimal:
    """IEC of the account that was asked for."""
    return transfer.change_iec or Decimal(0)


def transfers_csv(transfers: Iterable[Transfer]) -> str:
    """One line per transfer of an account, newest first."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["time_utc", "from", "to", "change_iec", "balance_iec", "why", "task", "transaction"])
    for one in transfers:
        writer.writerow(
            [
                moment(one.time_s),
                _cell(one.sender_name or one.sender),
                _cell(one.to_name or one.to),
                f"{change(one):f}",
                # Unknown for a token that was there before the organization.
                "" if one.balance_iec is None else f"{one.balance_iec:f}",
                reason(one),
                "" if one.task_id is None else one.task_id,
                one.tx_hash,
            ]
        )
    return text.getvalue()


def _cell(text: str) -> str:
    """A text that no spreadsheet takes for a formula."""
    return "'" + text if text.startswith(_FORMULA_STARTS) else text
