"""Commands about decisions after a delay: proposals, votes, and money that members split."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, StringConstraints

from rodeo.bus.messages import Id, Party, Payment, Support
from rodeo.bus.session import validate
from rodeo.chain.contracts.types import ZERO_ADDRESS, TimelockRole, hex_bytes
from rodeo.chain.proposals import (
    BUDGET_CREDITS,
    Operation,
    Proposed,
    proposal_key,
    protected_text,
    shares,
)
from rodeo.commands.declare import COMMANDS, Command, Line, NameOf, command
from rodeo.commands.errors import (
    ActsAtOnce,
    AlreadyProposed,
    MembersDecide,
    NoCredits,
    NotARecipient,
    NothingToPay,
    NoVotes,
    TooFewCredits,
    UnexpectedBudgetVoteState,
    UnexpectedProposalState,
    UnknownBudgetVote,
    UnknownProposal,
)
from rodeo.commands.people import BY_ADMINISTRATOR, BY_ANYBODY, BY_MEMBER, BY_PROPOSER
from rodeo.errors import InvalidRequest

if TYPE_CHECKING:
    from rodeo.chain.encoding import Call
    from rodeo.commands.desk import Desk, Row

Proposable = Annotated[str, NameOf(lambda one: one.proposable)]
"""A command of the organization that its members can decide about, or that its administrator proposes."""


@command("operator", console=BY_PROPOSER)
class Propose(Command):
    """Let the members vote on a command of the organization, or where its administrator decides, start the
    delay of one. Everybody can read what it would call on chain."""

    command: Proposable = Field(examples=["set_terms"])
    request: dict[str, Any] = Field(
        {},
        description="The command's own fields.",
        examples=[{"bond_iec": "50", "penalty_iec": "20", "max_failures": 2}],
    )
    description: Annotated[str, StringConstraints(min_length=1, max_length=4096)] = Field(
        examples=["a bond, so that robots take only what they can do"]
    )

    def calls(self, desk: Desk) -> list[Call]:
        _require_timelock(desk)
        calls = self._proposed().proposed(desk.of_organization())
        if not desk.client.deployment.decides_by_vote:
            salt, delay_s = os.urandom(32), desk.client.decisions.delay_s()
            return [desk.client.governance_calls.schedule(calls, self.description, salt, delay_s)]
        text = protected_text(self.description, desk.key_address)
        made = desk.client.governance_calls.proposal_id(calls, text)
        if (number := desk.index.votes.proposal_number(proposal_key(made))) is not None:
            # The governor identifies a proposal by its calls and its text, even after it has ended.
            raise AlreadyProposed(
                "this account proposed the same before with the same words: change the words",
                proposal=number,
                description=self.description,
            )
        return [desk.client.governance_calls.propose(calls, text)]

    def spends(self, desk: Desk) -> int:
        # The wallet decides it now, whoever executes it later, unless members vote on it.
        return 0 if desk.client.deployment.decides_by_vote else self._proposed().spends(desk)

    def _proposed(self) -> Command:
        return validate(COMMANDS[self.command], self.request)


@command(
    "ros_dao",
    line=Line(
        "organization vote {proposal} {support}",
        "{participant} voted {support} on proposal {proposal}.",
        spelled={"proposal": "NUMBER"},
    ),
    console=BY_MEMBER,
)
class CastVote(Command):
    """Vote on a proposal as a member. A vote cannot be changed.

    It counts with the votes of the time when the proposal was made."""

    proposal: Id = Field(description="Its number: `rodeo organization proposals`.", examples=[3])
    support: Support = Field(description="for, against or abstain.", examples=["for"])

    def calls(self, desk: Desk) -> list[Call]:
        _require_votes(desk)
        key = _proposal(desk, self.proposal)["id"]
        return [desk.client.governance_calls.cast_vote(int(key, 16), self.support)]


@command(
    "ros_dao",
    line=Line(
        "organization queue {proposal}",
        "Proposal {proposal} can be executed after the delay: `rodeo organization proposals` says when.",
        spelled={"proposal": "NUMBER"},
    ),
    console=BY_ANYBODY,
)
class QueueProposal(Command):
    """Start the delay of a proposal that succeeded."""

    proposal: Id = Field(description="Its number: `rodeo organization proposals`.", examples=[3])

    def calls(self, desk: Desk) -> list[Call]:
        _require_votes(desk)
        return [desk.client.governance_calls.queue(_proposed(_proposal(desk, self.proposal)))]


@command(
    "ros_dao",
    line=Line(
        "organization execute {proposal}", "Proposal {proposal} is executed.", spelled={"proposal": "NUMBER"}
    ),
    console=BY_ANYBODY,
)
class ExecuteProposal(Command):
    """Do what was decided or proposed, after the delay. Anybody may."""

    proposal: Id = Field(description="Its number: `rodeo organization proposals`.", examples=[3])

    def calls(self, desk: Desk) -> list[Call]:
        row = _proposal(desk, self.proposal)
        if desk.client.deployment.decides_by_vote:
            return [desk.client.governance_calls.execute(_proposed(row))]
        _require_state(desk, row, "ready")
        return [desk.client.governance_calls.perform(_operation(row), hex_bytes(row["id"]))]


@command(
    line=Line(
        "organization cancel {proposal}", "Proposal {proposal} is cancelled.", spelled={"proposal": "NUMBER"}
    ),
    console=BY_ADMINISTRATOR,
)
class CancelProposal(Command):
    """Withdraw a proposal of the administrator before it is executed."""

    proposal: Id = Field(description="Its number: `rodeo organization proposals`.", examples=[3])

    def calls(self, desk: Desk) -> list[Call]:
        row = _proposal(desk, self.proposal)
        _require_no_votes(desk, "a proposal is decided by votes, and nobody withdraws it")
        _require_state(desk, row, "waiting", "ready")
        return [desk.client.governance_calls.cancel(hex_bytes(row["id"]))]


@command(line=Line("organization propose hand-over {account}", ""), proposable=True)
class HandOver(Command):
    """Let another key propose and cancel in place of the administrator's, where no members decide."""

    account: Party = Field(
        description="Who proposes from then on: a participant or an address.", examples=["alice"]
    )

    def calls(self, desk: Desk) -> list[Call]:
        _require_timelock(desk)
        _require_no_votes(desk, "the members decide, and no key proposes in their place")
        holders = desk.index.rules.roles()
        former = sorted({one for role in TimelockRole for one in holders.get(role, ())})
        to = desk.names.key_address(self.account)
        return desk.client.governance_calls.hand_over(former, to)


@command(
    line=Line("organization propose delay {delay_s}", "", spelled={"delay_s": "SECONDS"}), proposable=True
)
class SetDelay(Command):
    """Change the delay of everything that is proposed later."""

    delay_s: Annotated[int, Field(gt=0, le=30 * 24 * 3600)] = Field(
        description="From a proposal, or decision, to its execution.", examples=[172800]
    )

    def calls(self, desk: Desk) -> list[Call]:
        _require_timelock(desk)
        return [desk.client.governance_calls.set_delay(self.delay_s)]


@command(
    line=Line(
        "organization propose budget-vote {amount_iec} {recipients}",
        "",
        spelled={"recipients": "RECIPIENT..."},
    ),
    proposable=True,
)
class OpenBudgetVote(Command):
    """Let the members split an amount of the treasury. It begins when the proposal is executed."""

    recipients: Annotated[list[Party], Field(min_length=1, max_length=16)] = Field(
        description="Participants' names or addresses, each once.", examples=[["panther1", "alice"]]
    )
    amount_iec: Payment = Field(description="What is split, in IEC.", examples=["100"])
    duration_s: Annotated[int, Field(ge=60, lt=2**32)] = Field(
        3 * 24 * 3600, description="How long members may vote, in seconds."
    )

    def calls(self, desk: Desk) -> list[Call]:
        _require_votes(desk)
        amount = desk.currency.to_units(self.amount_iec)
        recipients = [desk.payee("recipients", one) for one in self.recipients]
        for number, (one, who) in enumerate(zip(recipients, self.recipients, strict=True)):
            if one in (ZERO_ADDRESS, *desk.client.deployment.contracts.values()):
                raise NotARecipient(
                    "the zero address and the organization's own contracts cannot be paid a share",
                    recipient=who,
                )
            if one in recipients[:number]:
                raise NotARecipient("each recipient is named once", recipient=who)
        # The members would split what is not there.
        desk.require_funds(desk.client.organization, amount)
        return [desk.client.governance_calls.budgets.open(recipients, amount, self.duration_s)]

    def spends(self, desk: Desk) -> int:
        return desk.currency.to_units(self.amount_iec)


def _budget_vote_in_words(said: Mapping[str, Any]) -> str:
    spent = sum(votes * votes for votes in said["votes"].values())
    return f"{said['participant']} voted in budget vote {said['budget_vote']}, with {spent} credits."


@command(
    "ros_dao",
    line=Line(
        "organization vote-budget {budget_vote} {votes}",
        _budget_vote_in_words,
        spelled={"budget_vote": "NUMBER", "votes": "RECIPIENT=VOTES..."},
    ),
    console=BY_MEMBER,
)
class CastBudgetVote(Command):
    """Vote on who gets how much, as a member: n votes cost n * n credits. Voting again replaces the votes.

    A member has 100 credits in each budget vote.
    """

    budget_vote: Id = Field(description="Its number: `rodeo organization budget-votes`.", examples=[0])
    votes: Annotated[
        dict[Party, Annotated[int, Field(strict=True, ge=0, lt=2**32)]], Field(max_length=16)
    ] = Field(
        description="A whole number of votes for each recipient, for example alice=6 bob=8: 36 and 64 of the "
        "credits. Who is left out gets none.",
        examples=[{"panther1": 6, "alice": 8}],
    )

    def calls(self, desk: Desk) -> list[Call]:
        row = _budget_vote(desk, self.budget_vote, "open")
        places = {_place(desk, row, who): votes for who, votes in self.votes.items()}
        if len(places) < len(self.votes):
            raise InvalidRequest("a recipient is named twice", votes=self.votes)
        votes = [places.get(place, 0) for place in range(len(row["recipients"]))]
        if (needed := sum(one * one for one in votes)) > BUDGET_CREDITS:
            raise TooFewCredits(
                "these votes cost more credits than a member has: n votes cost n * n",
                votes=self.votes,
                needed=needed,
                credits=BUDGET_CREDITS,
            )
        if not desk.client.decisions.has_credits(desk.key_address, int(row["opened"])):
            raise NoCredits(
                "only members from before the budget vote was opened have credits in it",
                participant=desk.participant,
                budget_vote=row["number"],
            )
        return [desk.client.governance_calls.budgets.vote(row["number"], votes)]


@command("ros_dao", "operator", console=BY_ANYBODY)
class PayBudgetShare(Command):
    """Pay one recipient its share after the end of a budget vote. Anybody may."""

    budget_vote: Id = Field(examples=[0])
    recipient: Party = Field(examples=["panther1"])

    def calls(self, desk: Desk) -> list[Call]:
        row = _budget_vote(desk, self.budget_vote, "ended")
        place = _place(desk, row, self.recipient)
        share, paid = shares(row["amount"], row["votes"])[place], row["paid"][place]
        if paid is not None or not share:
            raise NothingToPay(
                "this recipient got no votes" if paid is None else "this recipient was paid its share",
                budget_vote=row["number"],
                recipient=self.recipient,
                paid_iec=desk.currency.text(int(paid or 0)),
            )
        desk.require_funds(desk.client.organization, share)
        return [desk.client.governance_calls.budgets.pay(row["number"], place)]


def _require_timelock(desk: Desk) -> None:
    if not desk.client.deployment.has_timelock:
        raise ActsAtOnce("the administrator's key acts at once in this organization, and nothing is proposed")


def _require_state(desk: Desk, row: Row, *wanted: str) -> None:
    """Raises UnexpectedProposalState, of a proposal where nobody votes."""
    state = desk.client.decisions.operation_state(hex_bytes(row["id"]))
    if state not in wanted:
        raise UnexpectedProposalState(
            "this cannot be done to the proposal in its state; `rodeo organization proposals` shows it",
            proposal=row["number"],
            state=state,
            wanted=" or ".join(wanted),
        )


def _require_no_votes(desk: Desk, problem: str) -> None:
    if desk.client.deployment.decides_by_vote:
        raise MembersDecide(problem)


def _require_votes(desk: Desk) -> None:
    if not desk.client.deployment.decides_by_vote:
        raise NoVotes("this organization has an administrator, and its members do not vote")


def _proposal(desk: Desk, number: int) -> Row:
    _require_timelock(desk)
    found = desk.index.votes.proposal(number)
    if found is None:
        raise UnknownProposal("no such proposal", proposal=number)
    return found


def _budget_vote(desk: Desk, number: int, state: str) -> Row:
    """A budget vote in which members vote still (`open`), or no more (`ended`)."""
    _require_votes(desk)
    row = desk.index.votes.budget_vote(number)
    if row is None:
        raise UnknownBudgetVote(
            "no such budget vote; `rodeo organization budget-votes` lists them", budget_vote=number
        )
    found = "open" if desk.client.decisions.voting_time_s() < row["end"] else "ended"
    if found != state:
        raise UnexpectedBudgetVoteState(
            "voting has ended" if state == "open" else "voting is still open: shares are paid after it ends",
            budget_vote=number,
            end_s=row["end"],
        )
    return row


def _place(desk: Desk, row: Row, who: str) -> int:
    """Where a recipient stands in the list of a budget vote. Raises NotARecipient."""
    recipients, address = row["recipients"], desk.payee("recipient", who)
    if address not in recipients:
        raise NotARecipient(
            "this budget vote has no such recipient",
            recipient=who,
            known=[desk.names.name(one) or one for one in recipients],
        )
    return int(recipients.index(address))


def _proposed(row: Row) -> Proposed:
    return Proposed(
        targets=row["targets"],
        values=[int(one) for one in row["values"]],
        calldatas=[bytes.fromhex(one[2:]) for one in row["calldatas"]],
        description_hash=hex_bytes(row["description_hash"]),
    )


def _operation(row: Row) -> Operation:
    return Operation(
        targets=row["targets"],
        values=[int(one) for one in row["values"]],
        calldatas=[bytes.fromhex(one[2:]) for one in row["calldatas"]],
        predecessor=hex_bytes(row["predecessor"]),
        salt=hex_bytes(row["salt"]),
    )
