"""Which contract each command of a judge calls, and which judge a kind gets."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import pytest
from eth_utils import to_checksum_address

from rodeo.chain import artifacts
from rodeo.chain.calls import Calls, JudgeCalls, OrganizationCalls
from rodeo.chain.contract_calls import DisputeJudgeCalls
from rodeo.chain.contracts.abi import Windows
from rodeo.chain.deployment import Deployment
from rodeo.commands.desk import Desk
from rodeo.commands.errors import (
    AnotherRuling,
    KindWithoutQuorum,
    KindWithoutRules,
    NoDispute,
    NotAJudge,
    UnknownKind,
)
from rodeo.errors import InvalidRequest
from rodeo.money.currency import IEC
from services.bridge.names import Names
from services.bridge.wallet import parse

NAMES = (*artifacts.CONTRACTS, *artifacts.DISPUTES)
ADDRESSES = {name: to_checksum_address(f"0x{place:040x}") for place, name in enumerate(NAMES, 1)}
KIND, OTHER = "waste_disposal", f"0x{99:040x}"
DIGEST = "0x" + "0a" * 32
VOTE: dict[str, Any] = {
    **dict.fromkeys(("proof_sha256", "report_sha256", "rules_sha256"), DIGEST),
    "task_id": 1,
    "attempt": 1,
    "ruling": "accepted",
    "amount_iec": "5",
    "reason": "it is clean",
}
RULE = {**VOTE, "report_uri": ""}
VOTES = {"vote": VOTE, "report_uri": "", "signatures": ["0x" + "01" * 64]}


def called(
    name: str,
    request: dict[str, Any],
    judge: str = "OracleJudge",
    *,
    removed: bool = False,
    seats: int = 0,
    votes: int = 0,
    instances: int = 0,
    kept: tuple[str, ...] = (DIGEST,),
    others: dict[int, dict[str, Any]] | None = None,
    **task: Any,
) -> list[tuple[str, str]]:
    """(Contract, function) of each call of the command; `judge` has judged the kind since before the task,
    and under the numbers of `others`, but for what these say."""
    deployment = Deployment(chain_id=1, genesis_hash="0x", block=0, contracts=ADDRESSES)
    number = {"kind": KIND, "judge": ADDRESSES.get(judge, judge), "removed": removed}
    numbers = {1: number, **{at: {**number, **row} for at, row in (others or {}).items()}}
    row = {"id": 1, "number": 1, "attempt": 1, "kind": KIND, "rules_sha256": DIGEST, "state": "submitted"}
    row |= {"dispute": None, "passed_on": False} | task
    client: Any = SimpleNamespace(
        deployment=deployment,
        calls=Calls(deployment),
        organization_calls=OrganizationCalls(deployment),
        judge_calls=JudgeCalls(deployment),
        currency=IEC,
        judges=SimpleNamespace(
            quorum=lambda _kind, _committee="": SimpleNamespace(votes=votes),
            instances=lambda _kind: [SimpleNamespace(stake=1)] * instances,
        ),
    )
    rules: Any = SimpleNamespace(
        numbers=lambda: numbers,
        number_of=lambda kind: max(numbers) if kind == KIND else 0,
        judges=lambda: [{}] * seats,
        of=lambda _kind, now: list(kept) if now == number["judge"] else [],
        kinds=lambda: [KIND],
        kind=lambda _kind: {f"{one.name}_s": 180 for one in fields(Windows)} | {"reference_price": 1},
    )
    index: Any = SimpleNamespace(rules=rules, tasks=SimpleNamespace(get=lambda _id: row))
    unused: Any = SimpleNamespace()
    kinds: Any = SimpleNamespace(by_people=lambda _kind: False, get=lambda _kind: None)
    names = Names.__new__(Names)
    names._contracts, names._addresses = deployment.contracts, {}
    desk = Desk("alice", client, index, names, unused, unused, kinds)
    contracts = {address: contract for contract, address in ADDRESSES.items()}
    return [(contracts[call.to], call.name) for call in parse(name, request).calls(desk)]


def test_a_ruling_goes_to_the_judge_that_the_task_was_posted_under() -> None:
    assert called("rule", RULE) == [("OracleJudge", "rule")]
    assert called("rule", RULE, "AuditorJudge") == [("AuditorJudge", "rule")]
    assert called("post_votes", VOTES, "OracleCommittee") == [("OracleCommittee", "postVotes")]
    assert called("post_votes", VOTES, "DisputeJudge") == [("DisputeJudge", "postVotes")]


@pytest.mark.parametrize("judge", ["OracleJudge", "OracleCommittee", "DisputeJudge"])
def test_auditors_rule_in_the_place_of_who_passed_a_case_on_or_was_removed(judge: str) -> None:
    assert called("rule", RULE, judge, passed_on=True) == [("AuditorJudge", "ruleFor")]
    assert called("rule", RULE, judge, removed=True, passed_on=True) == [("AuditorJudge", "rule")]


def test_a_ruling_on_another_attempt_than_was_passed_on_is_the_judges_own() -> None:
    assert called("rule", RULE, passed_on=True, attempt=2) == [("OracleJudge", "rule")]


@pytest.mark.parametrize(
    ("command", "request_", "judge"),
    [
        ("rule", RULE, "OracleCommittee"),
        ("rule", RULE, "DisputeJudge"),
        ("rule", RULE, OTHER),
        ("post_votes", VOTES, "OracleJudge"),
        ("post_votes", VOTES, OTHER),
    ],
)
def test_who_judges_otherwise_is_not_asked(command: str, request_: dict[str, Any], judge: str) -> None:
    with pytest.raises(NotAJudge) as refused:
        called(command, request_, judge)
    assert refused.value.details == {"judge": ADDRESSES.get(judge, judge)}


def test_a_kind_gets_the_oracles_as_the_organization_has_them() -> None:
    allow = {"kind": KIND, "judge": "oracle", "rules_sha256": DIGEST}
    there: dict[str, Any] = {"judge": "AuditorJudge", "seats": 3}
    assert judge_set(allow, judge="AuditorJudge") == "OracleJudge"
    assert judge_set(allow, votes=2, **there) == "OracleCommittee"
    assert judge_set(allow, votes=2, instances=2, **there) == "DisputeJudge"
    assert judge_set(allow | {"judge": "auditor"}) == "AuditorJudge"
    with pytest.raises(KindWithoutQuorum):
        judge_set(allow, **there)


def test_new_rules_do_not_change_which_oracles_judge_a_kind() -> None:
    allow = {"kind": KIND, "judge": "oracle", "rules_sha256": DIGEST}
    assert judge_set(allow, seats=3, votes=2, instances=2) == "OracleJudge"
    assert judge_set(allow, judge="DisputeJudge", seats=3) == "DisputeJudge"


def judge_set(request: dict[str, Any], **there: Any) -> str:
    """The judge that allowKind names."""
    named: list[str] = []
    real = OrganizationCalls.allow_kind

    def allow_kind(self: OrganizationCalls, kind: str, judge: str, rules: bytes) -> Any:
        named.append(judge)
        return real(self, kind, judge, rules)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(OrganizationCalls, "allow_kind", allow_kind)
        called("allow_kind", request, **there)
    (address,) = named
    return next(name for name, one in ADDRESSES.items() if one == address)


def test_another_judge_of_a_kind_does_not_keep_the_rules_of_the_one_before() -> None:
    allow = {"kind": KIND, "judge": "oracle", "audit_window_s": 60}
    assert called("allow_kind", allow) == [("Organization", "setWindows"), ("Organization", "allowKind")]
    with pytest.raises(KindWithoutRules):
        called("allow_kind", allow, "AuditorJudge")


def test_a_kind_without_a_judge_has_none_to_remove() -> None:
    assert called("remove_judge", {"kind": KIND}) == [("Organization", "removeJudge")]
    with pytest.raises(UnknownKind):
        called("remove_judge", {"kind": "painting"})


def test_a_judge_is_removed_from_all_numbers_of_the_kind_that_it_has() -> None:
    """Tasks of each of them still run, also where another judge came between."""
    others = {
        2: {"judge": ADDRESSES["AuditorJudge"]},
        3: {"kind": "painting"},
        4: {"removed": True},
        5: {},
        6: {},
    }
    removed: list[int] = []
    real = OrganizationCalls.remove_judge

    def remove_judge(self: OrganizationCalls, number: int) -> Any:
        removed.append(number)
        return real(self, number)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(OrganizationCalls, "remove_judge", remove_judge)
        called("remove_judge", {"kind": KIND}, others=others)
    assert removed == [6, 1, 5]


@pytest.mark.parametrize(
    "task",
    [{}, {"dispute": {"instance": 0}}, {"dispute": {"instance": 1, "stakes_iec": ["1"]}, "state": "ruled"}],
)
def test_a_ruling_that_nobody_can_replace_is_not_challenged(task: dict[str, Any]) -> None:
    """A ruling of no instance, a concluded one, or one of the last instance."""
    with pytest.raises(NoDispute):
        called("challenge", {"task_id": 1, "reason": "no"}, instances=2, **task)


@pytest.mark.parametrize("meant", [{"attempt": 2}, {"instance": 1}, {"stake_iec": "19"}])
def test_a_challenge_that_was_meant_for_another_ruling_takes_no_stake(meant: dict[str, Any]) -> None:
    stands = {"state": "ruled", "dispute": {"instance": 0, "stakes_iec": ["20", "40"]}}
    with pytest.raises(AnotherRuling) as refused:
        called("challenge", {"task_id": 1, "reason": "no", **meant}, **stands)
    assert refused.value.details == {"attempt": 1, "instance": 0, "stake_iec": "20"}


def test_what_concerns_providers_goes_to_the_contract_that_knows_them() -> None:
    assert called("set_namers", {"service_id": 1, "namers": "anybody"}) == [("Providers", "setNamers")]
    assert called("match_task", {"task_id": 1, "service_id": 2}) == [("TaskManager", "matchTask")]
    assert called("vouch", {"account": OTHER}) == [("Organization", "vouchFor")]


INSTANCES = {
    "kind": KIND,
    "windows_s": [3600, 1800],
    "decisions_s": [86_400, 43_200],
    "stakes_iec": ["20", "40"],
    "judge_stakes_iec": ["10", "5"],
}


def test_what_an_instance_says_of_the_next_one_is_told_with_the_one_before() -> None:
    told: list[Any] = []
    real = DisputeJudgeCalls.set_instances

    def set_instances(self: DisputeJudgeCalls, kind: str, instances: list[Any]) -> Any:
        told.extend(instances)
        return real(self, kind, instances)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(DisputeJudgeCalls, "set_instances", set_instances)
        assert called("set_instances", INSTANCES, votes=2) == [("DisputeJudge", "setInstances")]
    iec = 10**18
    assert [(one.window, one.decision, one.stake, one.judge_stake) for one in told] == [
        (3600, 0, 20 * iec, 10 * iec),
        (1800, 86_400, 40 * iec, 5 * iec),
        (0, 43_200, 0, 0),
    ]
    assert [one.committee for one in told] == [ADDRESSES[name] for name in artifacts.COMMITTEES]


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        ({"stakes_iec": ["40", "20"]}, InvalidRequest),
        ({"decisions_s": [86_400]}, InvalidRequest),
    ],
)
def test_instances_that_the_contract_would_refuse_are_not_proposed(
    wrong: dict[str, Any], error: type[Exception]
) -> None:
    with pytest.raises(error):
        called("set_instances", INSTANCES | wrong, votes=2)


def test_an_instance_needs_its_quorum_first() -> None:
    with pytest.raises(KindWithoutQuorum) as refused:
        called("set_instances", INSTANCES)
    assert refused.value.details == {"kind": KIND, "committee": "OracleCommittee"}
