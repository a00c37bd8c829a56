"""Commands about the organization's rules and its members."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from eth_utils import to_checksum_address
from pydantic import Field, model_validator

from rodeo.bus.messages import (
    NO_RULES,
    Address,
    ExecutionWindow,
    Hex32,
    Iec,
    Kind,
    Party,
    Payment,
    Policy,
    RoleName,
    Window,
)
from rodeo.chain.contracts import types
from rodeo.chain.contracts.abi import Terms, Windows
from rodeo.chain.contracts.types import Role, hex_bytes
from rodeo.commands.declare import Command, Line, command
from rodeo.commands.errors import KindWithoutChecks, KindWithoutQuorum, KindWithoutRules
from rodeo.commands.examples import DIGEST
from rodeo.commands.people import BY_ADMINISTRATOR, FOR_GOOD
from rodeo.errors import InvalidRequest
from rodeo.kinds import (
    DEFAULT_PRICE_IEC,
    GRACE_S,
    GRACE_STEP_S,
    MAX_WINDOW_S,
    PEOPLES_MIN_WINDOW_S,
    VERDICT_WINDOWS_S,
)

if TYPE_CHECKING:
    from rodeo.chain.encoding import Call
    from rodeo.commands.desk import Desk

Judge = Literal["oracle", "auditor"] | Address
"""The judge of a kind's proofs: the organization's oracles, however many have to agree; its auditors; or
another contract."""

_UNDECLARED = PEOPLES_MIN_WINDOW_S, MAX_WINDOW_S, PEOPLES_MIN_WINDOW_S // 2
"""Execution windows and grace period of a kind that the site file does not list: people do it, and have to
accept in the grace period."""


def _allowed_in_words(said: Mapping[str, Any]) -> str:
    if not said["allowed"]:
        return f"{said['kind']} is no longer accepted."
    judge = said["judge"]
    judges = judge if judge in ("oracle", "auditor") else f"contract {judge}"
    return f"{said['kind']} is accepted and judged by the {judges}."


@command(
    line=Line(
        "organization kind {kind}",
        _allowed_in_words,
        spelled={"allowed": "--allow/--disallow"},
        completed="installed_rules",
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class AllowKind(Command):
    """Allow a kind of work, or stop allowing it. To allow it, set who judges it.

    Repeat it after an update of the kind's package, or of its networks or rates in the site file: new tasks
    are then judged by the new rules."""

    kind: Kind = Field(description="The kind of task.", examples=["window_cleaning"])
    allowed: bool = Field(True, description="Allow it, or stop allowing it.")
    judge: Judge | None = Field(
        None,
        description=(
            "Who judges it: auditor (people), oracle, or the address of a contract. Required to allow"
            " a kind. Services go on under the judge before until their providers agree (`rodeo "
            "service agree`)."
        ),
        examples=["oracle"],
    )
    min_window_s: ExecutionWindow | None = Field(
        None,
        description=(
            "Shortest execution window, in seconds. By default, as for the next two, what the kind "
            "has now, or what its package says."
        ),
    )
    max_window_s: ExecutionWindow | None = Field(None, description="Longest execution window, in seconds.")
    grace_s: Annotated[int, Field(ge=0, le=2550, multiple_of=10)] | None = Field(
        None,
        description=(
            "How long an executor may give a task back so that the attempt does not count, in tens of"
            " seconds, at most half of the shortest window. 0: three minutes, or that half if it is "
            "less."
        ),
    )
    reference_price_iec: Payment | None = Field(
        None,
        description=(
            "The most that an attempt counts in its provider's record, in IEC. By default what it is "
            "now, or the kind's `price_iec`."
        ),
    )
    min_verdict_window_s: Window | None = Field(None, description="Shortest verdict window, in seconds.")
    max_verdict_window_s: Window | None = Field(None, description="Longest verdict window, in seconds.")
    audit_window_s: Annotated[int, Field(ge=0, le=30 * 86_400)] | None = Field(
        None,
        description=(
            "How long after the verdict window a ruling may still be replaced, in seconds: by "
            "auditors where the judge cannot decide. Where nobody rules, the attempt is void."
        ),
    )
    rules_sha256: Hex32 | None = Field(
        None,
        description=(
            "Hash of the rules by which it is judged, beside those that are current. Where the oracle"
            " judges, the default is the hash of the kind as it is installed, with the networks and "
            "rates of the site file (`rodeo kind show`)."
        ),
        examples=[DIGEST],
    )

    @model_validator(mode="after")
    def _has_a_judge(self) -> Self:
        if self.allowed != (self.judge is not None):
            raise ValueError("judge is needed to allow a kind, and only then")
        if self.rules_sha256 is not None and not self.allowed:
            raise ValueError("rules_sha256 goes with a kind that is allowed")
        if (self.min_verdict_window_s is None) != (self.max_verdict_window_s is None):
            raise ValueError("min_verdict_window_s and max_verdict_window_s go together: set both or neither")
        if None not in (self.min_window_s, self.max_window_s) and self.min_window_s > self.max_window_s:  # type: ignore[operator]
            raise ValueError("min_window_s is longer than max_window_s")
        return self

    def calls(self, desk: Desk) -> list[Call]:
        calls = desk.client.organization_calls
        if self.judge == "oracle" and desk.kinds.by_people(self.kind):
            raise KindWithoutChecks(
                "the oracle has no checks for this kind: let auditors judge it",
                kind=self.kind,
                kinds_with_checks=sorted(name for name, kind in desk.kinds.items() if not kind.by_people),
            )
        found = self._windows(desk)
        if self.judge is None:
            return [*found, calls.disallow_kind(self.kind)]
        # Last, so that nobody posts such a task before its rules hold.
        judge = _judge_for(desk, self.kind, self.judge)
        kept = desk.index.rules.of(self.kind, judge)
        rules = self.rules_sha256 or next(reversed(kept), NO_RULES)
        if self.judge == "oracle" and rules == NO_RULES:
            raise KindWithoutRules(
                "say by which rules the oracle judges this kind: `rodeo kind show` names those of a kind",
                kind=self.kind,
            )
        return [*found, calls.allow_kind(self.kind, judge, hex_bytes(rules))]

    def _windows(self, desk: Desk) -> list[Call]:
        """What sets the kind's windows and reference price, where the command names any, or the kind has none
        and is allowed. What the command leaves out stays as it is."""
        row, kind = desk.index.rules.kind(self.kind), desk.kinds.get(self.kind)
        has_windows = row is not None and row["max_window_s"] > 0
        named = (
            *(self.min_window_s, self.max_window_s, self.grace_s),
            *(self.min_verdict_window_s, self.max_verdict_window_s, self.audit_window_s),
        )
        price_iec = self.reference_price_iec
        if price_iec is None and all(one is None for one in named) and (has_windows or not self.allowed):
            return []
        if row is not None and has_windows:
            known = (
                *(row["min_window_s"], row["max_window_s"], row["grace_s"]),
                *(row["min_verdict_window_s"], row["max_verdict_window_s"], row["audit_window_s"]),
            )
            price = row["reference_price"]
        else:
            declared = _UNDECLARED if kind is None else (*kind.windows_s, kind.grace_period_s)
            known = (*declared, *VERDICT_WINDOWS_S, 0)
            price_iec = price_iec or (DEFAULT_PRICE_IEC if kind is None else kind.reference_price_iec)
        if price_iec is not None:
            price = desk.currency.to_units(price_iec)
        shortest, longest, grace, *judged = (
            now if one is None else one for one, now in zip(named, known, strict=True)
        )
        if self.grace_s is None and grace > shortest // 2:
            grace = min(GRACE_S, shortest // 2 // GRACE_STEP_S * GRACE_STEP_S)
        if shortest > longest:
            raise InvalidRequest(
                "the shortest execution window is longer than the longest",
                min_window_s=shortest,
                max_window_s=longest,
            )
        if grace > shortest // 2:
            raise InvalidRequest(
                "the grace period is at most half of the shortest execution window",
                grace_s=grace,
                min_window_s=shortest,
            )
        calls = desk.client.organization_calls
        return [calls.set_windows(self.kind, Windows(shortest, longest, grace, *judged), price)]


@command(
    line=Line(
        "organization retire-rules {kind} {rules_sha256}",
        "No task of {kind} is posted under {rules_sha256} any more.",
    ),
    console=FOR_GOOD,
    proposable=True,
)
class RetireRules(Command):
    """Let nobody post a task under these rules any more. Tasks that were posted under them keep them."""

    kind: Kind = Field(description="The kind of task.", examples=["window_cleaning"])
    rules_sha256: Hex32 = Field(description="Their hash.", examples=[DIGEST])

    def calls(self, desk: Desk) -> list[Call]:
        calls = desk.client.organization_calls
        return [calls.retire_rules(self.kind, hex_bytes(self.rules_sha256))]


@command(
    line=Line("organization policy {policy}", "Services are now chosen by {policy}."),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class SetPolicy(Command):
    """Set how a service is chosen for a task."""

    policy: Policy = Field(
        description="first_come, lowest_price, highest_reputation.", examples=["lowest_price"]
    )

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.set_policy(types.Policy[self.policy.upper()])]


@command(
    line=Line("organization terms", "Services offered from now on agree to these terms."),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class SetTerms(Command):
    """Set the terms for services that are offered from now on."""

    bond_iec: Iec = Field(
        Decimal(0), description="Bond that a service locks until it retires, in IEC.", examples=["50"]
    )
    penalty_iec: Iec = Field(
        Decimal(0), description="Amount that a failed attempt costs, in IEC.", examples=["20"]
    )
    max_failures: Annotated[int, Field(ge=0, lt=2**8)] = Field(
        0, description="Failures in a row until suspension; 0: never.", examples=[2]
    )

    @model_validator(mode="after")
    def _penalty_within_bond(self) -> Self:
        # A proposal is executed days later, so the contract's refusal would come late.
        if self.penalty_iec > self.bond_iec:
            raise ValueError("the penalty is higher than the bond")
        return self

    def calls(self, desk: Desk) -> list[Call]:
        terms = Terms(
            desk.currency.to_units(self.bond_iec),
            desk.currency.to_units(self.penalty_iec),
            self.max_failures,
        )
        return [desk.client.organization_calls.set_terms(terms)]


@command(
    line=Line(
        "organization members-only",
        lambda said: (
            f"{'Only members' if said['enabled'] else 'Everybody'} may offer services and post tasks now."
        ),
        spelled={"enabled": "--on/--off"},
        defaults={"enabled": True},
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class SetMembersOnly(Command):
    """Let only members, or everybody, offer services and post tasks."""

    enabled: bool = Field(description="Only members may, or everybody.", examples=[True])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.set_members_only(self.enabled)]


@command(
    line=Line(
        "organization pause {duration_s}",
        "No new tasks are taken for {duration}.",
        spelled={"duration_s": "SECONDS"},
    ),
    console=BY_ADMINISTRATOR,
)
class PauseTasks(Command):
    """Take no new tasks for a while, as a guardian. Everything that runs continues."""

    duration_s: Window = Field(description="At most three days.", examples=[3600])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.pause_tasks(self.duration_s)]


@command(
    line=Line("organization resume", "New tasks are taken."),
    console=BY_ADMINISTRATOR,
    proposable=True,
    of_administrator=False,
)
class ResumeTasks(Command):
    """Take new tasks again before a pause ends."""

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.resume_tasks()]


@command(
    line=Line("organization admit {account}", "{account} is now a member."),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class Admit(Command):
    """Make somebody a member."""

    account: Party = Field(description="A participant's name or an address.", examples=["alice"])

    def calls(self, desk: Desk) -> list[Call]:
        account = desk.names.address(self.account)
        return [desk.client.organization_calls.grant_role(Role.MEMBER, account), *_counted(desk, account)]


@command(
    line=Line("organization dismiss {account}", "{account} is no longer a member."),
    console=FOR_GOOD,
    proposable=True,
)
class Dismiss(Command):
    """End a membership."""

    account: Party = Field(description="A participant's name or an address.", examples=["alice"])

    def calls(self, desk: Desk) -> list[Call]:
        account = desk.names.address(self.account)
        return [desk.client.organization_calls.revoke_role(Role.MEMBER, account), *_counted(desk, account)]


@command(
    line=Line("organization grant {role} {account}", "{account} now has the role {role}."), proposable=True
)
class GrantRole(Command):
    """Give somebody a role."""

    role: RoleName = Field(
        description=("administrator, operator, treasurer, oracle, auditor, member, guardian, allocator."),
        examples=["auditor"],
    )
    account: Party = Field(description="A participant's name or an address.", examples=["alice"])

    def calls(self, desk: Desk) -> list[Call]:
        role, account = Role[self.role.upper()], desk.names.key_address(self.account)
        counted = _counted(desk, account) if role is Role.MEMBER else []
        return [desk.client.organization_calls.grant_role(role, account), *counted]


@command(
    line=Line("organization revoke {role} {account}", "{account} no longer has the role {role}."),
    proposable=True,
)
class RevokeRole(Command):
    """Take a role back."""

    role: RoleName = Field(
        description=("administrator, operator, treasurer, oracle, auditor, member, guardian, allocator."),
        examples=["auditor"],
    )
    account: Party = Field(description="A participant's name or an address.", examples=["alice"])

    def calls(self, desk: Desk) -> list[Call]:
        role, account = Role[self.role.upper()], desk.names.key_address(self.account)
        counted = _counted(desk, account) if role is Role.MEMBER else []
        return [desk.client.organization_calls.revoke_role(role, account), *counted]


def _judge_for(desk: Desk, kind: str, judge: str) -> str:
    """The address of the contract that judges `kind` from now on. A kind that oracles judge already keeps its
    contract, even if the number of oracles has changed. Raises KindWithoutQuorum."""
    deployment, present = (
        desk.client.deployment,
        desk.index.rules.numbers().get(desk.index.rules.number_of(kind)),
    )
    if present is not None and desk.names.judge(present["judge"]) == judge:
        return str(present["judge"])
    if judge == "auditor":
        return deployment.address("AuditorJudge")
    if judge != "oracle":
        return to_checksum_address(judge)
    if not desk.index.rules.judges():
        return deployment.address("OracleJudge")
    if not desk.client.judges.quorum(kind).votes:
        raise KindWithoutQuorum(
            "several oracles judge here: say first how many have to agree about this kind, with "
            "`rodeo organization quorum`",
            kind=kind,
        )
    can_be_challenged = deployment.has_disputes and bool(desk.client.judges.instances(kind))
    return deployment.address("DisputeJudge" if can_be_challenged else "OracleCommittee")


def _counted(desk: Desk, account: str) -> list[Call]:
    """The call that tells the votes contract whether `account` is a member. While that contract knows too few
    members, nobody can propose; and a dismissed member counts for the quorum."""
    if not desk.client.deployment.decides_by_vote:
        return []
    return [desk.client.governance_calls.votes.sync(account)]
