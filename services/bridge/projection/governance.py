"""The organization's settings and roles, proposals, and votes on budgets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from eth_utils import keccak

from rodeo.chain.contracts import events
from rodeo.chain.contracts.types import TimelockRole
from rodeo.chain.proposals import SUPPORT, proposal_key, shown_text, text_of
from rodeo.money.currency import Currency
from services.bridge import schema
from services.bridge.projection import At, Table, hex_of
from services.bridge.rows import Rows


class Settings:
    """Events that set one thing of the organization, roles among them."""

    def __init__(self, rows: Rows, contracts: Mapping[str, str], currency: Currency) -> None:
        self._rows, self._timelock = rows, contracts.get("OrganizationTimelock")
        self._currency = currency

    def table(self) -> Table:
        text, put = self._currency.text, self._put
        return {
            events.TermsChanged: lambda one, _: put(
                "terms",
                {
                    "bond_iec": text(one.bond),
                    "penalty_iec": text(one.penalty),
                    "max_failures": one.max_failures,
                },
            ),
            events.MembersOnlyChanged: lambda one, _: put("members_only", one.members_only),
            events.BudgetChanged: lambda one, at: put(
                f"budget {one.role}",
                {"amount_iec": text(one.amount), "period_s": one.period, "since_s": at.time_s},
            ),
            events.TasksPaused: lambda one, _: put("paused_until_s", one.until),
            events.TasksResumed: lambda *_: put("paused_until_s", 0),
            events.AuditorsChanged: lambda one, _: put("auditors", one.auditors),
            events.PolicyChanged: lambda one, _: put("policy", one.policy),
            events.RoleGranted: lambda one, at: self._set_role(one, at, held=True),
            events.RoleRevoked: lambda one, at: self._set_role(one, at, held=False),
        }

    def _put(self, name: str, value: object) -> None:
        self._rows.put(schema.settings, name=name, value=value)

    def _set_role(self, event: events.RoleGranted | events.RoleRevoked, at: At, *, held: bool) -> None:
        """Set the role if this contract knows it: the timelock has the proposers', the organization all
        others. Each may grant any 32 bytes as a role."""
        if (at.log.contract == self._timelock) == (event.role in list(TimelockRole)):
            self._rows.put(schema.roles, role=event.role, address=event.account, held=held)


class Proposals:
    """Events of the governor and the timelock."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def table(self) -> Table:
        return {
            events.ProposalCreated: self._created,
            # Whoever votes says how, by calling one function or another: both count.
            events.VoteCast: self._vote_cast,
            events.VoteCastWithParams: self._vote_cast,
            events.ProposalQueued: lambda one, _: self._change(
                proposal_key(one.proposal_id), ready=one.eta_seconds
            ),
            events.ProposalExecuted: lambda one, _: self._change(
                proposal_key(one.proposal_id), ended="executed"
            ),
            events.ProposalCanceled: lambda one, _: self._change(
                proposal_key(one.proposal_id), ended="canceled"
            ),
            events.CallScheduled: self._scheduled,
            events.CallSalt: lambda one, _: self._change_operation(one.id, salt=hex_of(one.salt)),
            events.Cancelled: lambda one, _: self._change_operation(one.id, ended="canceled"),
            events.CallExecuted: self._executed,
            events.MinDelayChange: self._delay_changed,
        }

    def _change(self, key: str, **values: Any) -> None:
        self._rows.change(schema.proposals, key, **values)

    def _created(self, event: events.ProposalCreated, at: At) -> None:
        self._rows.add(
            schema.proposals,
            id=proposal_key(event.proposal_id),
            number=self._next_number(),
            proposer=event.proposer,
            description=shown_text(event.description, event.proposer),
            description_hash=hex_of(keccak(text=event.description)),
            targets=event.targets,
            values=[str(one) for one in event.values],
            calldatas=[hex_of(one) for one in event.calldatas],
            created=at.time_s,
            vote_end=event.vote_end,
            **dict.fromkeys(SUPPORT, 0),
        )

    def _vote_cast(self, event: events.VoteCast | events.VoteCastWithParams, at: At) -> None:
        support, key = SUPPORT[event.support], proposal_key(event.proposal_id)
        self._change(key, **{support: self._rows.get(schema.proposals, key)[support] + event.weight})
        self._rows.add(schema.ballots, proposal=key, voter=event.voter, support=support, weight=event.weight)

    def _scheduled(self, event: events.CallScheduled, at: At) -> None:
        """The next call of an operation of the timelock."""
        key = hex_of(event.id)
        if not event.index:
            # A cancelled operation may be scheduled again, and begins anew.
            self._rows.put(
                schema.proposals,
                id=key,
                number=self._next_number(),
                description="",
                targets=[],
                values=[],
                calldatas=[],
                predecessor=hex_of(event.predecessor),
                salt=hex_of(bytes(32)),
                created=at.time_s,
                ready=at.time_s + event.delay,
                **dict.fromkeys(SUPPORT, 0),
            )
        before = self._rows.get(schema.proposals, key)
        targets, calldatas = [*before["targets"], event.target], [*before["calldatas"], hex_of(event.data)]
        description = text_of(targets, [bytes.fromhex(one[2:]) for one in calldatas])
        values = [*before["values"], str(event.value)]
        self._change(key, targets=targets, values=values, calldatas=calldatas, description=description)

    def _change_operation(self, operation_id: bytes, **values: Any) -> None:
        # One without calls logs no call, and does nothing.
        if self._rows.find(schema.proposals, hex_of(operation_id)) is not None:
            self._change(hex_of(operation_id), **values)

    def _executed(self, event: events.CallExecuted, at: At) -> None:
        """Calls that the founder has the organization execute at once are no proposal. Calls that it
        schedules and does not execute before the delay is set stay one: they can be executed at any time."""
        self._change_operation(event.id, ended="executed")
        key, founded = hex_of(event.id), self._rows.find(schema.settings, "founded")
        number = (self._rows.find(schema.proposals, key) or {}).get("number")
        is_last = number is not None and number == self._count()
        if is_last and (founded is None or founded["value"] == at.log.tx_hash):
            self._change(key, number=None)
            self._rows.put(schema.settings, name="proposals", value=self._count() - 1)

    def _delay_changed(self, event: events.MinDelayChange, at: At) -> None:
        if event.new_duration and self._rows.find(schema.settings, "founded") is None:
            self._rows.put(schema.settings, name="founded", value=at.log.tx_hash)

    def _next_number(self) -> int:
        """The number of a new proposal."""
        number = self._count() + 1
        self._rows.put(schema.settings, name="proposals", value=number)
        return number

    def _count(self) -> int:
        row = self._rows.find(schema.settings, "proposals")
        return 0 if row is None else int(row["value"])


class BudgetVotes:
    """Events of votes on how a budget is shared."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def table(self) -> Table:
        return {
            events.RoundOpened: self._opened,
            events.BudgetVoteCast: self._cast,
            events.BudgetPaid: self._paid,
        }

    def _opened(self, event: events.RoundOpened, at: At) -> None:
        self._rows.add(
            schema.budget_votes,
            number=event.round_id,
            amount=event.amount,
            opened=at.time_s,
            end=event.end,
            recipients=event.recipients,
            votes=[0] * len(event.recipients),
            paid=[None] * len(event.recipients),
        )

    def _cast(self, event: events.BudgetVoteCast, at: At) -> None:
        """The member's votes, in place of those that it gave before."""
        ballot = self._rows.find(schema.budget_ballots, event.round_id, event.account)
        before = [0] * len(event.votes) if ballot is None else ballot["votes"]
        votes = self._rows.get(schema.budget_votes, event.round_id)["votes"]
        added = [total + new - old for total, new, old in zip(votes, event.votes, before, strict=True)]
        self._rows.change(schema.budget_votes, event.round_id, votes=added)
        self._rows.put(
            schema.budget_ballots, budget_vote=event.round_id, voter=event.account, votes=event.votes
        )

    def _paid(self, event: events.BudgetPaid, at: At) -> None:
        before = self._rows.get(schema.budget_votes, event.round_id)
        paid = [
            str(event.amount) if one == event.recipient else amount
            for one, amount in zip(before["recipients"], before["paid"], strict=True)
        ]
        self._rows.change(schema.budget_votes, event.round_id, paid=paid)
