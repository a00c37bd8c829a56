"""Tokens: balances, and why each transfer was made."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rodeo.chain.contracts import events
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import ZERO_ADDRESS, Event
from services.bridge import schema
from services.bridge.projection import At, Table
from services.bridge.projection.providers import Providers
from services.bridge.rows import Rows

_Why = tuple[str, str | None, str | None, int]
"""Text, sender, receiver and amount."""


@dataclass(frozen=True)
class _Reason:
    """Why tokens moved. None is anybody."""

    task_id: int | None
    text: str
    sender: str | None = None
    to: str | None = None
    amount: int = 0

    def explains(self, transfer: events.Transfer) -> bool:
        return (
            self.sender in (None, transfer.sender)
            and self.to in (None, transfer.to)
            and self.amount == transfer.value
        )


class Tokens:
    """Events of the payment token, explained by their neighbours in the same transaction."""

    def __init__(self, rows: Rows, contracts: Mapping[str, str], providers: Providers) -> None:
        self._rows, self._contracts, self._providers = rows, contracts, providers
        self._reasons: dict[str, list[_Reason]] = {}
        self._explanations = self._table_of_explanations()

    def prepare(self, logs: list[Log]) -> None:
        """See all events that will be applied: the explanation of a transfer may come before it or after."""
        self._reasons = defaultdict(list)
        for log in logs:
            if (explain := self._explanations.get(type(log.event))) is not None:
                why = _Reason(getattr(log.event, "task_id", None), *explain(log.event))
                self._reasons[log.tx_hash] += [*self._payments(log), why]

    def table(self) -> Table:
        return {
            events.PaymentDeferred: lambda one, _: self._change_balance(one.account, owed=one.amount),
            events.PaymentCollected: lambda one, _: self._change_balance(one.account, owed=-one.amount),
            events.Transfer: self._transferred,
        }

    def _transferred(self, event: events.Transfer, at: At) -> None:
        sender_balance = self._add_balance(event.sender, -event.value)
        to_balance = self._add_balance(event.to, event.value)
        reason = self._reason(at.log.tx_hash, event)
        self._rows.add(
            schema.transfers,
            seq=at.seq,
            block=at.log.block,
            time_s=at.time_s,
            tx_hash=at.log.tx_hash,
            sender=event.sender,
            to=event.to,
            amount=event.value,
            sender_balance=sender_balance,
            to_balance=to_balance,
            task_id=reason.task_id,
            reason=reason.text,
        )

    def _add_balance(self, address: str, change: int) -> int | None:
        # Tokens are minted from and burnt to the zero address.
        if address == ZERO_ADDRESS:
            return None
        return int(self._change_balance(address, balance=change)["balance"])

    def _change_balance(self, address: str, **changes: int) -> Mapping[str, Any]:
        row = self._rows.find(schema.balances, address) or {"address": address, "balance": 0, "owed": 0}
        after = {**row, **{name: row[name] + change for name, change in changes.items()}}
        self._rows.put(schema.balances, **after)
        return after

    def _table_of_explanations(self) -> Mapping[type[Event], Callable[[Any], _Why]]:
        """Event -> why tokens move in its transaction."""
        tasks, organization = self._contracts.get("TaskManager"), self._contracts.get("Organization")
        disputes, payout_of = self._contracts.get("DisputeJudge"), self._providers.payout_of
        return {
            events.TaskRegistered: lambda one: ("escrow", one.creator, tasks, one.reward),
            events.TaskSettled: lambda one: ("surplus", tasks, None, one.refund),
            events.TaskFailed: lambda one: ("refund", tasks, None, one.refund),
            events.TaskCancelled: lambda one: ("refund", tasks, None, one.refund),
            events.TermsAgreed: lambda one: ("bond", None, tasks, one.bond),
            events.BondPenalized: lambda one: ("penalty", tasks, organization, one.amount),
            events.BondReturned: lambda one: ("bond_returned", tasks, payout_of(one.provider), one.amount),
            events.PaymentCollected: lambda one: ("collected", tasks, payout_of(one.account), one.amount),
            events.Challenged: lambda one: ("stake", one.challenger, disputes, one.stake),
            events.StakePaid: lambda one: ("stake_paid", disputes, one.account, one.amount),
            events.StakeDeposited: lambda one: ("judge_stake", one.payer, disputes, one.amount),
            events.StakeWithdrawn: lambda one: ("judge_stake_paid", disputes, one.account, one.amount),
            events.Deposited: lambda one: ("deposit", one.sender, organization, one.amount),
            events.Withdrawn: lambda one: ("withdrawal", organization, one.to, one.amount),
        }

    def _payments(self, log: Log) -> list[_Reason]:
        """A retired service gets its bond back, or what was set aside of it, in the same transfer."""
        if not isinstance(event := log.event, events.TaskSettled):
            return []
        bonds = [one.amount for one in self._reasons[log.tx_hash] if one.text == "bond_returned"]
        tasks, paid = self._contracts.get("TaskManager"), event.paid
        return [_Reason(event.task_id, "payment", tasks, event.payout, paid + bond) for bond in (0, *bonds)]

    def _reason(self, tx_hash: str, transfer: events.Transfer) -> _Reason:
        reasons = self._reasons.get(tx_hash, [])
        for position, reason in enumerate(reasons):
            if reason.explains(transfer):
                return reasons.pop(position)
        if transfer.sender == ZERO_ADDRESS:
            return _Reason(None, "mint")
        return _Reason(None, "burn" if transfer.to == ZERO_ADDRESS else "transfer")
