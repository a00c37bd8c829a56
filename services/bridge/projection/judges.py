"""Committees of judges: seats, quorums, stakes, and the cases that they decide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rodeo.chain import artifacts
from rodeo.chain.artifacts import ORACLES
from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import Ruling
from rodeo.money.currency import Currency
from services.bridge import schema
from services.bridge.projection import At, Table
from services.bridge.projection.kinds import Kinds
from services.bridge.rows import Rows

_OfStake = events.StakeDeposited | events.WithdrawalAnnounced | events.StakeWithdrawn | events.StakeLost


class Judges:
    """Events of the committees of oracles and of those that decide about challenges."""

    def __init__(self, rows: Rows, contracts: Mapping[str, str], kinds: Kinds, currency: Currency) -> None:
        self._rows, self._contracts, self._kinds, self._currency = rows, contracts, kinds, currency

    def table(self) -> Table:
        return {
            events.JudgeSeated: self._seated,
            events.JudgeKeyChanged: lambda one, at: self._rows.change(
                schema.judges, self._committee(at.log.contract), one.seat, key=one.key
            ),
            events.QuorumChanged: self._quorum_changed,
            events.InstancesChanged: self._instances_changed,
            events.StakeDeposited: lambda one, _: self._change_stake(one, stake=one.amount),
            events.WithdrawalAnnounced: lambda one, _: self._change_stake(
                one, one.until, stake=-one.amount, leaving=one.amount
            ),
            events.StakeWithdrawn: lambda one, _: self._change_stake(one, 0, leaving=-one.amount),
            events.StakeLost: self._lose_stake,
            events.InstanceRuled: self._instance_ruled,
            events.Challenged: self._challenged,
            events.CaseSettled: self._case_settled,
        }

    @property
    def _later_committees(self) -> list[str]:
        """Names of the committees that decide about challenges."""
        return [name for name in artifacts.COMMITTEES[1:] if name in self._contracts]

    def _committee(self, contract: str) -> str:
        """The name of the committee that logs at this address."""
        found = (name for name in self._later_committees if self._contracts[name] == contract)
        return next(found, ORACLES)

    def _staked_in(self, committee: str) -> str | None:
        """The name of the organization's committee at this address. Anybody may deposit for the seats of
        another contract."""
        names = (ORACLES, *self._later_committees)
        return next((name for name in names if self._contracts.get(name) == committee), None)

    def _seated(self, event: events.JudgeSeated, at: At) -> None:
        self._rows.add(
            schema.judges,
            committee=self._committee(at.log.contract),
            seat=event.seat,
            key=event.key,
            first_key=event.key,
            owner=event.owner,
            stake=0,
            leaving=0,
            leaving_until_s=0,
        )

    def _quorum_changed(self, event: events.QuorumChanged, at: At) -> None:
        seats = [seat for seat in range(64) if event.seats >> seat & 1]
        committee = self._committee(at.log.contract)
        if committee == ORACLES:
            chosen = {"panel": event.panel, "rotation_s": event.rotation}
            self._kinds.change(event.kind, votes=event.votes, seats=seats, **chosen)
        else:
            self._change_challenges(committee, event.kind, votes=event.votes, seats=seats)

    def _instances_changed(self, event: events.InstancesChanged, at: At) -> None:
        # If one is named twice, the first counts.
        needed = {self._staked_in(one.committee): one.judge_stake for one in reversed(event.instances)}
        # Nobody decides about a challenge of the last one.
        stakes = [self._currency.text(one.stake) for one in event.instances[:-1]]
        self._kinds.change(event.kind, judge_stake=needed.get(ORACLES, 0), challenge_stakes=stakes)
        for committee in self._later_committees:
            self._change_challenges(committee, event.kind, judge_stake=needed.get(committee, 0))

    def _change_challenges(self, committee: str, kind: str, **values: Any) -> None:
        key = {"committee": committee, "kind": kind}
        before = self._rows.find(schema.challenge_kinds, committee, kind)
        unknown = {**key, "votes": 0, "seats": [], "judge_stake": 0}
        self._rows.put(schema.challenge_kinds, **{**(before or unknown), **values})

    def _change_stake(self, event: _OfStake, until_s: int | None = None, **by: int) -> None:
        committee = self._staked_in(event.committee)
        if committee is None:
            return
        row = self._rows.get(schema.judges, committee, event.seat)
        values = {name: row[name] + change for name, change in by.items()}
        if until_s is not None:
            values["leaving_until_s"] = until_s
        self._rows.change(schema.judges, committee, event.seat, **values)

    def _lose_stake(self, event: events.StakeLost, at: At) -> None:
        """Take the stake that counts for votes first, as the contract does."""
        committee = self._staked_in(event.committee)
        if committee is not None:
            counted = min(event.amount, self._rows.get(schema.judges, committee, event.seat)["stake"])
            self._change_stake(event, stake=-counted, leaving=counted - event.amount)

    # -- cases ---------------------------------------------------------------------------------------------

    def _instance_ruled(self, event: events.InstanceRuled, at: At) -> None:
        if event.ruling is Ruling.NONE:
            return
        task = self._rows.get(schema.tasks, event.task_id)
        # A case keeps the stakes that it began with.
        began = task["dispute"] or {"stakes_iec": self._kinds.get(task["kind"])["challenge_stakes"]}
        dispute = {"instance": event.instance, "until": event.until or at.time_s}
        dispute["stakes_iec"] = began["stakes_iec"]
        self._rows.change(schema.tasks, event.task_id, dispute=dispute)
        before = self._rows.find(schema.cases, event.task_id, event.attempt)
        committee = artifacts.COMMITTEES[event.instance]
        # Judges stake for what they accept, and nothing overturns the last ruling.
        stakes = (
            event.ruling is Ruling.ACCEPTED and event.until and self._judge_stake(committee, task["kind"])
        )
        self._rows.put(
            schema.cases,
            task_id=event.task_id,
            attempt=event.attempt,
            number=task["number"],
            until=event.until,
            staked=bool(stakes) or (before is not None and before["staked"]),
            settled=False,
        )

    def _judge_stake(self, committee: str, kind: str) -> int:
        """Deposit that each of its judges needs to vote on this kind."""
        if committee == ORACLES:
            return int(self._kinds.get(kind)["judge_stake"])
        row = self._rows.find(schema.challenge_kinds, committee, kind)
        return 0 if row is None else int(row["judge_stake"])

    def _challenged(self, event: events.Challenged, at: At) -> None:
        task = self._rows.get(schema.tasks, event.task_id)
        dispute = task["dispute"] | {
            "until": event.until,
            "challenger": event.challenger,
            "stake_iec": self._currency.text(event.stake),
            "because": event.reason,
        }
        self._rows.change(schema.tasks, event.task_id, dispute=dispute)
        self._rows.change(schema.cases, event.task_id, task["attempt"], until=event.until, staked=True)

    def _case_settled(self, event: events.CaseSettled, at: At) -> None:
        self._rows.change(schema.cases, event.task_id, event.attempt, settled=True)
        task = self._rows.get(schema.tasks, event.task_id)
        if task["dispute"] is not None and task["attempt"] == event.attempt:
            self._rows.change(schema.tasks, event.task_id, dispute=task["dispute"] | {"settled": True})
