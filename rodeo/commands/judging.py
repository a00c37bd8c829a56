"""Commands about rulings: rule, vote, challenge, and who judges what with which stake."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from decimal import Decimal
from typing import TYPE_CHECKING, Annotated, Any, Self

from eth_utils import is_address, to_checksum_address
from pydantic import Field, StringConstraints, model_validator

from rodeo.bus.messages import (
    JUDGES,
    NO_RULES,
    Address,
    Attempt,
    Fault,
    Finding,
    Hex32,
    Id,
    Iec,
    Kind,
    Message,
    Party,
    Payment,
    Ruling,
    Signature,
    SignedVote,
    Standing,
    Task,
    Vote,
)
from rodeo.chain import signed_requests
from rodeo.chain.artifacts import ORACLES
from rodeo.chain.contracts.abi import Instance, Quorum
from rodeo.chain.contracts.types import Role, halves, hex_bytes
from rodeo.commands.declare import Command, Line, command
from rodeo.commands.errors import (
    AnotherRuling,
    CannotSign,
    CanOnlyLose,
    InvalidQuorum,
    KindWithoutQuorum,
    NoDispute,
    NotAJudge,
    StakeTooLow,
    UnknownKind,
    UnknownParticipant,
)
from rodeo.commands.examples import ADDRESS, BEFORE, DIGEST, REPORT_URI, SIGNATURE, VOTE
from rodeo.commands.people import BY_ADMINISTRATOR, BY_ANYBODY, BY_PROVIDER, FOR_GOOD, PEOPLE
from rodeo.errors import InvalidRequest
from rodeo.judging import votes
from rodeo.judging.rulings import can_only_lose

if TYPE_CHECKING:
    from eth_account.signers.local import LocalAccount
    from eth_typing import ChecksumAddress

    from rodeo.chain.encoding import Call
    from rodeo.chain.signed_requests import Said
    from rodeo.commands.desk import Desk, Row


@command("ros_dao", "oracle", *PEOPLE)
class Rule(Command):
    """Rule on a proof, as the judge of its kind, or as an auditor on what that judge has passed on."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    attempt: Attempt = Field(description="The attempt, counted from 1.", examples=[1])
    proof_sha256: Hex32 = Field(examples=[DIGEST])
    ruling: Finding = Field(examples=["accepted"])
    fault: Fault = Field(
        "nobody", description="The party at fault for a void ruling, and for an undecided one."
    )
    amount_iec: Iec | None = Field(
        None,
        description=(
            "The part of the agreed price that the executor is paid. The rest of the reward goes back"
            " to the creator."
        ),
        examples=["100"],
    )
    reason: str = Field(max_length=500, examples=["accepted"])
    rules_sha256: Hex32 | None = Field(
        None, description="Hash of the rules that were applied; by default those of the task."
    )
    report_sha256: Hex32 = Field(examples=[BEFORE])
    report_uri: str = Field(max_length=2048, examples=[REPORT_URI])

    @model_validator(mode="after")
    def _pays_what_is_accepted(self) -> Self:
        if (self.ruling == "accepted") != (self.amount_iec is not None):
            raise ValueError("an accepted proof is paid an amount; after any other ruling there is none")
        return self

    def calls(self, desk: Desk) -> list[Call]:
        task = desk.task(self.task_id)
        judge, removed = _judge_of(desk, task)
        said = votes.finding(
            Vote(
                task_id=self.task_id,
                attempt=self.attempt,
                proof_sha256=self.proof_sha256,
                report_sha256=self.report_sha256,
                rules_sha256=self.rules_sha256 or task["rules_sha256"] or NO_RULES,
                ruling=self.ruling,
                fault=self.fault,
                amount_iec=self.amount_iec or Decimal(0),
                reason=self.reason,
            ),
            desk.currency,
        )
        auditors = desk.client.judge_calls.auditor
        if removed:
            return [auditors.rule(said, self.report_uri)]
        if task["passed_on"] and task["attempt"] == self.attempt:
            return [auditors.rule_for(judge, said, self.report_uri)]
        for calls, contract in ((desk.client.judge_calls.oracle, "OracleJudge"), (auditors, "AuditorJudge")):
            if judge == desk.client.deployment.address(contract):
                return [calls.rule(said, self.report_uri)]
        raise NotAJudge("no single account rules on this task: its judges post votes", judge=judge)


@command("oracle", "operator")
class PostVotes(Command):
    """Post what enough judges of a committee agree on. Anyone who holds their votes may send this."""

    vote: Vote = Field(examples=[VOTE])
    report_uri: str = Field(max_length=2048, examples=[REPORT_URI])
    signatures: list[Signature] = Field(min_length=1, max_length=64, examples=[[SIGNATURE, "0x" + "6c" * 64]])

    def calls(self, desk: Desk) -> list[Call]:
        judge, _ = _judge_of(desk, desk.task(self.vote.task_id))
        said = votes.finding(self.vote, desk.currency)
        signatures = b"".join(hex_bytes(one) for one in self.signatures)
        for calls, contract in (
            (desk.client.judge_calls.committee(), "OracleCommittee"),
            (desk.client.judge_calls.dispute, "DisputeJudge"),
        ):
            if judge == desk.client.deployment.contracts.get(contract):
                return [calls.post_votes(said, self.report_uri, signatures)]
        raise NotAJudge("nobody votes on this task: another contract judges it", judge=judge)


def _what_a_challenge_costs(words: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Nothing where the ruling cannot be challenged: the bridge says why."""
    task: Task = words["task"]
    if (agreed := challenge_of(task)) is None:
        return "", {}
    question = (
        f"A challenge of the ruling on task {task.id} takes {agreed['stake_iec']} IEC of "
        f"{words['participant']}, which are lost if the ruling is right. Challenge it?"
    )
    return question, agreed


def challenge_of(task: Task) -> dict[str, Any] | None:
    """The fields by which a challenge is of the ruling that stands now, and takes no other stake; None where
    that cannot be challenged."""
    dispute = task.dispute
    if dispute is None or dispute.challenge_iec is None:
        return None
    return {"attempt": task.attempt, "instance": dispute.instance, "stake_iec": f"{dispute.challenge_iec:f}"}


@command(
    "ros_dao",
    line=Line(
        "task dispute challenge {task_id}",
        "{participant} challenged the ruling on task {task_id}.",
        valid_s=600,
        asks=_what_a_challenge_costs,
    ),
    console=BY_PROVIDER,
    signable=True,
)
class Challenge(Command):
    """Challenge the ruling that stands on a task, with a stake that is lost if the ruling is right. Creator,
    executor and judges may. A party may take over what a judge has challenged. What is signed for somebody
    else to send challenges this ruling alone."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    reason: Annotated[str, StringConstraints(max_length=500, pattern=r"\S")] = Field(
        description="Why the ruling is wrong.", examples=["the item lies beside the bin"]
    )
    attempt: Attempt | None = Field(
        None, description="The attempt that was ruled on. By default the last one.", examples=[1]
    )
    instance: Annotated[int, Field(ge=0, lt=2)] | None = Field(
        None,
        description="Whose ruling: 0 for the oracles, 1 for the judges of challenges. By default the last.",
        examples=[0],
    )
    stake_iec: Payment | None = Field(
        None, description="The stake that is agreed to, in IEC. By default whatever it is.", examples=["20"]
    )

    def calls(self, desk: Desk) -> list[Call]:
        task = self._meant(desk)
        stake, against = stake_of(desk, task), (task["attempt"], task["dispute"]["instance"])
        _require_can_win(desk, task, desk.key_address)
        desk.require_funds(desk.key_address, stake)
        return [
            *desk.approval(_disputes(desk), stake),
            desk.client.judge_calls.dispute.challenge(self.task_id, *against, self.reason),
        ]

    def _meant(self, desk: Desk) -> Row:
        """The task, while the ruling is the one that was meant. Raises NoDispute, AnotherRuling."""
        task = disputed(desk, self.task_id)
        stake_iec = desk.currency.from_units(stake_of(desk, task))
        stands = {"attempt": task["attempt"], "instance": task["dispute"]["instance"], "stake_iec": stake_iec}
        if any(getattr(self, name) not in (None, value) for name, value in stands.items()):
            stands["stake_iec"] = f"{stake_iec:f}"
            raise AnotherRuling("another ruling stands now: look at it before you challenge it", **stands)
        return task

    def spends(self, desk: Desk) -> int:
        return stake_of(desk, disputed(desk, self.task_id))

    def to_sign(self, desk: Desk, nonce: int, deadline: int) -> Said:
        task = self._meant(desk)
        _require_can_win(desk, task, desk.address)
        desk.require_funds(desk.address, stake_of(desk, task))
        return signed_requests.Challenge(
            challenger=desk.address,
            judge=_disputes(desk),
            task_id=self.task_id,
            attempt=task["attempt"],
            instance=task["dispute"]["instance"],
            reason=self.reason,
            nonce=nonce,
            deadline=deadline,
        )

    def takes(self, desk: Desk) -> tuple[str, int]:
        return _disputes(desk), self.spends(desk)


@command(
    "ros_dao",
    "robot_agent",
    "charger",
    line=Line("task conclude {task_id}", "Task {task_id} is {task.state}.", shows_task=True),
    console=BY_ANYBODY,
)
class Conclude(Command):
    """Do what the ruling says that stands on a task, once its time is over. Where nobody has ruled by the
    deadline, the attempt becomes void. Anybody may."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.calls.conclude(self.task_id)]


@command(
    "ros_dao",
    line=Line("task dispute settle {task_id}", "The stakes of task {task_id} are settled."),
    console=BY_ANYBODY,
)
class SettleStakes(Command):
    """Free and pay the stakes of a challenged attempt that is over. Anybody may."""

    task_id: Id = Field(description="The task, by its number in `rodeo task list`.", examples=[7])
    attempt: Attempt | None = Field(None, description="By default the last one.", examples=[1])

    def calls(self, desk: Desk) -> list[Call]:
        _disputes(desk)
        attempt = self.attempt or int(desk.task(self.task_id)["attempt"])
        return [desk.client.judge_calls.dispute.settle(self.task_id, attempt)]


@command(
    line=Line(
        "organization remove-judge {kind}",
        "The judge of {kind} rules no more. `rodeo organization kind {kind} --judge` sets another.",
    ),
    console=FOR_GOOD,
    proposable=True,
    of_administrator=False,
)
class RemoveJudge(Command):
    """Remove the judge of a kind at once and for good, as a guardian or administrator.

    Its rulings that nobody has concluded become void, and the auditors may replace them. `kind --judge` sets
    another judge."""

    kind: Kind = Field(description="The kind of task.", examples=["window_cleaning"])

    def calls(self, desk: Desk) -> list[Call]:
        present, numbers = desk.index.rules.number_of(self.kind), desk.index.rules.numbers()
        if not present:
            raise UnknownKind("this kind never had a judge", kind=self.kind, known=desk.index.rules.kinds())
        # The kind may have had another judge between two numbers of this one, under which tasks still run.
        judge = numbers[present]["judge"]
        others = [
            number
            for number, row in numbers.items()
            if row["kind"] == self.kind and row["judge"] == judge and not row["removed"]
        ]
        wanted = [present, *(number for number in others if number != present)]
        return [desk.client.organization_calls.remove_judge(number) for number in wanted]


@command(
    line=Line(
        "organization judge-key {judge} {key}",
        "{judge} votes with the key {key} on proofs that are submitted from now on. What it signed with the "
        "old key counts no more.",
    ),
    proposable=True,
    of_administrator=False,
)
class ChangeJudgeKey(Command):
    """Let a judge of the committee vote with another key, for every kind of work."""

    judge: Party = Field(
        description="The oracle's name, or the address of its key until now.", examples=["anna"]
    )
    key: Address = Field(
        description="Address of the key with which it votes from now on.", examples=[ADDRESS]
    )
    signature: Signature = Field(
        description="The key's own signature: `sign-seat` makes it.", examples=[SIGNATURE]
    )

    def calls(self, desk: Desk) -> list[Call]:
        old, key = _judges_key(desk, self.judge), to_checksum_address(self.key)
        return [desk.client.judge_calls.committee().change_key(old, key, *halves(self.signature))]


@command(
    line=Line(
        "organization seat {key}",
        "The judge with the key {key} has a seat. `rodeo organization quorum` lets it judge.",
    ),
    proposable=True,
)
class SeatJudge(Command):
    """Give a judge the next seat of the committee. It judges nothing until `quorum` names it."""

    key: Address = Field(description="Address of the key with which the judge votes.", examples=[ADDRESS])
    owner: Party | None = Field(
        None,
        description=("For whom it works, whose tasks it does not judge: a participant or an address."),
        examples=["panther1"],
    )
    signature: Signature = Field(
        description="The key's own signature: `sign-seat` makes it.", examples=[SIGNATURE]
    )

    def calls(self, desk: Desk) -> list[Call]:
        key = to_checksum_address(self.key)
        owner = key if self.owner is None else desk.names.address(self.owner)
        return [desk.client.judge_calls.committee().seat(key, owner, *halves(self.signature))]


@command(line=Line("organization unseat {judge}", "{judge} judges nothing any more."), proposable=True)
class UnseatJudge(Command):
    """Let a judge of the committee judge no kind of work any more. As many votes are needed as before.

    Its seat stays, so that a later quorum can name it."""

    judge: Party = Field(description="The oracle's name, or the address of its key.", examples=["anna"])

    def calls(self, desk: Desk) -> list[Call]:
        bit = _judges_bit(desk, self.judge)
        quorums = {
            row["kind"]: desk.client.judges.quorum(row["kind"]) for row in desk.index.rules.all_kinds()
        }
        calls = [
            _quorum_call(desk, kind, now.votes, now.seats & ~bit, now)
            for kind, now in quorums.items()
            if now.seats & bit
        ]
        if not calls:
            raise NotAJudge("this judge judges no kind of work", judge=self.judge)
        return calls


@command(
    line=Line(
        "organization quorum {kind} {votes}",
        "{kind} is now judged by {votes} judges that agree.",
        spelled={"judges": "--judge"},
    ),
    proposable=True,
)
class SetQuorum(Command):
    """Set which judges of the committee judge a kind, and how many have to agree.

    This also applies to proofs that wait."""

    kind: Kind = Field(description="The kind of task.", examples=["window_cleaning"])
    votes: Annotated[int, Field(ge=1, le=64)] = Field(
        description="How many judges have to agree: more than half of a panel.", examples=[3]
    )
    judges: Annotated[list[Party], Field(min_length=1, max_length=64)] | None = Field(
        None,
        description=("A judge of this kind, by name or key; repeat it. By default all that judge it now."),
        examples=[["anna", "bert", "carl", "dora"]],
    )
    panel: Annotated[int, Field(ge=1, le=64)] | None = Field(
        None, description="How many may vote at once. By default as before."
    )
    rotation_s: Annotated[int, Field(ge=0, lt=2**32)] | None = Field(
        None, description=("Seconds after which one more may vote; 0: never. By default as before.")
    )

    def calls(self, desk: Desk) -> list[Call]:
        if self.kind not in desk.kinds:  # else it may be allowed afterwards
            desk.require_kind(self.kind)
        now = desk.client.judges.quorum(self.kind)
        seats = now.seats
        if self.judges is not None:
            seats = 0
            for one in self.judges:
                seats |= _judges_bit(desk, one)
        if self.rotation_s is not None:
            now = replace(now, rotation=self.rotation_s)
        return [_quorum_call(desk, self.kind, self.votes, seats, now, self.panel)]


_Case = Annotated[int, Field(ge=60, le=7 * 86_400)]
"""Part of a case in which a ruling can be challenged, or is decided about, s."""


@command(
    line=Line(
        "organization instances {kind}",
        "Later rulings on {kind} can be challenged as these instances say.",
        spelled={
            "windows_s": "--window",
            "decisions_s": "--decision",
            "stakes_iec": "--stake",
            "judge_stakes_iec": "--judge-stake",
        },
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class SetInstances(Command):
    """Set which committees decide about challenges of rulings on a kind: one after the other, or none.

    Each option is repeated for each committee. Cases that run keep what they began with. Each committee needs
    its quorum for the kind first.
    """

    kind: Kind = Field(description="The kind of task.", examples=["window_cleaning"])
    windows_s: list[_Case] = Field(
        default_factory=list,
        max_length=2,
        description="How long a ruling of the committee before can be challenged, in seconds; repeat it.",
        examples=[[3600]],
    )
    decisions_s: list[_Case] = Field(
        default_factory=list,
        max_length=2,
        description="How long the committee may take, in seconds; after it the ruling stands. Repeat it.",
        examples=[[86_400]],
    )
    stakes_iec: list[Payment] = Field(
        default_factory=list,
        max_length=2,
        description="What a challenge costs whoever is wrong, in IEC: more for each later one. Repeat it.",
        examples=[["20"]],
    )
    judge_stakes_iec: list[Iec] = Field(
        default_factory=list,
        max_length=2,
        description="What each judge of the committee before must have at stake for its vote to count, in "
        "IEC; 0 for none. Repeat it.",
        examples=[["20"]],
    )

    @model_validator(mode="after")
    def _says_all_of_each_committee(self) -> Self:
        said = (self.windows_s, self.decisions_s, self.stakes_iec, self.judge_stakes_iec)
        if len({len(one) for one in said}) > 1:
            raise ValueError("window, decision, stake and judge stake go together: repeat all as often")
        # A proposal is executed days later, so the contract's refusal would come late.
        if self.stakes_iec != sorted(set(self.stakes_iec)):
            raise ValueError("each later challenge costs more than the one before")
        return self

    def calls(self, desk: Desk) -> list[Call]:
        _disputes(desk)
        deployment, to_units = desk.client.deployment, desk.currency.to_units
        committees = deployment.committees[: 1 + len(self.windows_s)]
        if len(committees) <= len(self.windows_s):
            raise InvalidRequest(
                "this organization has fewer committees that decide about challenges",
                committees=len(deployment.committees) - 1,
            )
        for committee in committees:
            if not desk.client.judges.quorum(self.kind, committee).votes:
                raise KindWithoutQuorum(
                    "say first which judges of the committee judge this kind",
                    kind=self.kind,
                    committee=committee,
                )
        # What an instance says of the next one: how it is challenged, and with which stakes.
        challenged = [
            *zip(self.windows_s, self.stakes_iec, self.judge_stakes_iec, strict=True),
            (0, Decimal(0), Decimal(0)),
        ]
        instances = [
            Instance(deployment.address(committee), window_s, decision_s, to_units(stake), to_units(own))
            for committee, decision_s, (window_s, stake, own) in zip(
                committees, [0, *self.decisions_s], challenged, strict=True
            )
        ]
        return [desk.client.judge_calls.dispute.set_instances(self.kind, instances)]


@command(
    line=Line(
        "organization deposit-stake {judge} {amount_iec}",
        "{participant} deposited {amount_iec} IEC for {judge}.",
    )
)
class DepositStake(Command):
    """Add to the stake of a judge: an oracle, or who decides about challenges. Without it its votes do not
    count. Anybody may pay."""

    judge: Party = Field(description="The judge's name, or the address of its key.", examples=["anna"])
    amount_iec: Payment = Field(description="In IEC.", examples=["100"])

    def calls(self, desk: Desk) -> list[Call]:
        disputes, amount = _disputes(desk), desk.currency.to_units(self.amount_iec)
        committee, seat = _staked(desk, self.judge)
        desk.require_funds(desk.key_address, amount)
        return [
            *desk.approval(disputes, amount),
            desk.client.judge_calls.dispute.deposit_stake(committee, seat, amount),
        ]

    def spends(self, desk: Desk) -> int:
        return desk.currency.to_units(self.amount_iec)


@command(
    line=Line(
        "organization announce-withdrawal {judge} {amount_iec}",
        "{amount_iec} IEC of {judge} leave. In 30 days `rodeo organization withdraw-stake` pays them.",
    )
)
class AnnounceWithdrawal(Command):
    """Begin to take the stake of a judge back, as whom it works for. It does not count for votes any more.

    It can still be lost until `withdraw-stake` pays it, 30 days later."""

    judge: Party = Field(description="The judge's name, or the address of its key.", examples=["anna"])
    amount_iec: Payment = Field(description="In IEC.", examples=["100"])

    def calls(self, desk: Desk) -> list[Call]:
        _disputes(desk)
        amount = desk.currency.to_units(self.amount_iec)
        committee, seat = _staked(desk, self.judge)
        return [desk.client.judge_calls.dispute.announce_withdrawal(committee, seat, amount)]


@command(line=Line("organization withdraw-stake {judge}", "The stake of {judge} that was announced is paid."))
class WithdrawStake(Command):
    """Pay the stake of a judge that was announced to whom it works for."""

    judge: Party = Field(description="The judge's name, or the address of its key.", examples=["anna"])

    def calls(self, desk: Desk) -> list[Call]:
        _disputes(desk)
        return [desk.client.judge_calls.dispute.withdraw_stake(*_staked(desk, self.judge))]


class SignVote(Message):
    """Sign a vote on the challenged ruling on a task, as a judge of the committee that decides about the
    challenge. Nothing is sent."""

    task_id: Id
    ruling: Ruling
    fault: Fault = "nobody"
    amount_iec: Iec | None = Field(
        None, description="What an accepted proof is paid; by default the agreed price."
    )
    reason: str | None = Field(
        None,
        max_length=500,
        description="Only equal votes count together, and the reason is part of them. By default it names "
        "the judges.",
    )

    def signed(self, desk: Desk, account: LocalAccount | None) -> SignedVote:
        """The vote of a judge with this key, who relies on the report of the ruling that stands. Raises
        RequestError."""
        if account is None:
            raise CannotSign("this participant signs for itself: its vote is EIP-712 typed data")
        task = disputed(desk, self.task_id)
        instance = task["dispute"]["instance"] + 1
        committees = desk.client.deployment.committees
        if instance >= len(committees):
            raise NoDispute("nobody decides about a challenge of this ruling", task_id=task["id"])
        judge = desk.client.judges.seat(account.address, committees[instance])
        if judge is None:
            raise NotAJudge(
                "this participant does not judge what is challenged", participant=desk.participant
            )
        accepted, amount = self.ruling == "accepted", self.amount_iec
        if not accepted and amount is not None:
            raise InvalidRequest("only an accepted proof is paid an amount", ruling=self.ruling)
        if accepted and amount is None:
            amount = desk.currency.from_units(task["price"])
        paid = desk.currency.to_units(amount or Decimal(0))
        if self.ruling == "impossible":
            paid = task["price"] // 10  # IMPOSSIBLE_SHARE of the contract
        _require_stake(desk, judge.number, committees[instance], task["kind"], instance, paid)
        vote = Vote(
            task_id=task["id"],
            attempt=task["attempt"],
            proof_sha256=task["proof_sha256"],
            report_sha256=task["report_sha256"] or NO_RULES,
            rules_sha256=task["rules_sha256"] or NO_RULES,
            ruling=self.ruling,
            fault=self.fault,
            amount_iec=amount or Decimal(0),
            reason=self.reason or f"decided by {JUDGES[instance]}",
        )
        deployment = desk.client.deployment
        signature = votes.sign(
            vote, account, deployment.chain_id, deployment.address(committees[instance]), desk.currency
        )
        return SignedVote(vote=vote, report_uri=task["report_uri"] or "", signature=signature)


def _judge_of(desk: Desk, task: Row) -> tuple[str, bool]:
    """The contract that judged the kind when the task was posted, and whether it was removed."""
    number = desk.index.rules.numbers()[task["number"]]
    return number["judge"], number["removed"]


def disputed(desk: Desk, task_id: int) -> Row:
    """A task on which a ruling stands that can be challenged, or was. Raises NoDispute."""
    task = desk.task(task_id)
    if task["dispute"] is None or task["state"] != "ruled":
        raise NoDispute("no ruling stands here that can be challenged", task_id=task_id, state=task["state"])
    return task


def _require_stake(desk: Desk, seat: int, committee: str, kind: str, instance: int, paid: int) -> None:
    """A vote without it would keep those of the others from counting. Raises StakeTooLow."""
    instances = desk.client.judges.instances(kind)
    needed = instances[instance].judge_stake if instance < len(instances) else 0
    if needed:  # nothing overturns the last instance, whose judges stake nothing
        needed = max(needed, desk.client.judges.stake_needed(seat, committee, paid))
    if (stake := desk.client.judges.stake(seat, committee)) < needed:
        raise StakeTooLow(
            "the stake of this judge is too low for its vote to count: somebody has to deposit",
            participant=desk.participant,
            stake_iec=desk.currency.text(stake),
            needed_iec=desk.currency.text(needed),
        )


def _require_can_win(desk: Desk, task: Row, challenger: str) -> None:
    """Raises CanOnlyLose."""
    owners = {row["address"]: row["owner"] for row in desk.index.rules.devices()}
    accounts = {challenger, owners.get(challenger, challenger)}
    if challenger in desk.index.rules.roles().get(Role.OPERATOR, []):
        accounts.add(desk.client.deployment.address("Organization"))
    # As `DisputeJudge`: a device speaks for its owner, and an owner for its devices.
    creator, executor = (
        not accounts.isdisjoint({task[party], owners.get(task[party], task[party])})
        for party in ("creator", "executor")
    )
    standing = Standing.model_validate(task["standing"])
    if why := can_only_lose(standing, desk.currency.from_units(task["price"]), creator, executor):
        raise CanOnlyLose(why, task_id=task["id"], stake_iec=desk.currency.text(stake_of(desk, task)))


def stake_of(desk: Desk, task: Row) -> int:
    """What a challenge of the ruling costs whoever is wrong, wei. Raises NoDispute."""
    stakes, instance = task["dispute"]["stakes_iec"], task["dispute"]["instance"]
    if instance >= len(stakes):
        raise NoDispute("nobody decides about a challenge of this ruling", task_id=task["id"])
    return desk.currency.to_units(Decimal(stakes[instance]))


def _quorum_call(
    desk: Desk, kind: str, votes: int, seats: int, now: Quorum, panel: int | None = None
) -> Call:
    """What has `votes` of the seats with these bits judge `kind`. A decision by vote is executed days
    later, so the contract's refusal would come late. Raises InvalidQuorum."""
    count = seats.bit_count()
    if panel is None:
        panel = count if now.panel == now.count else min(now.panel, count)
    if not panel < 2 * votes <= 2 * panel or panel > count:
        raise InvalidQuorum(
            "the votes must be more than half of the panel, and the panel at most all judges of the kind",
            kind=kind,
            votes=votes,
            panel=panel,
            judges=count,
        )
    return desk.client.judge_calls.committee().set_quorum(kind, votes, panel, now.rotation, seats)


def _judges_key(desk: Desk, who: str) -> str:
    """Address with which a judge votes, who is named, or `who` itself. Raises UnknownParticipant."""
    keys = {row["name"]: row["key"] for row in desk.index.rules.judges()}
    known = keys.get(who)
    if known is None and not is_address(who):
        raise UnknownParticipant("no such judge", who=who, known=sorted(filter(None, keys)))
    return to_checksum_address(known or who)


def _judges_bit(desk: Desk, who: str) -> int:
    """The bit that stands for a judge's seat. Raises UnknownParticipant."""
    return 1 << _judges_seat(desk, who)


def _judges_seat(desk: Desk, who: str) -> int:
    """Raises UnknownParticipant."""
    sitting = desk.client.judges.seat(_judges_key(desk, who))
    if sitting is None:
        raise UnknownParticipant("no judge votes with this key", who=who)
    return sitting.number


def _staked(desk: Desk, who: str) -> tuple[ChecksumAddress, int]:
    """Committee and seat of a judge: of an oracle, or of a participant who decides about challenges.
    Raises UnknownParticipant."""
    key = desk.names.keys.get(who, who)
    if who not in {row["name"] for row in desk.index.rules.judges()} and is_address(key):
        for committee in desk.client.deployment.committees[1:]:
            if (judge := desk.client.judges.seat(key, committee)) is not None:
                return desk.client.deployment.address(committee), judge.number
    return desk.client.deployment.address(ORACLES), _judges_seat(desk, who)


def _disputes(desk: Desk) -> ChecksumAddress:
    """Where judges have stakes. Raises NoDispute."""
    if not desk.client.deployment.has_disputes:
        raise NoDispute("rulings cannot be challenged here, so nobody has a stake")
    return desk.client.deployment.address("DisputeJudge")
