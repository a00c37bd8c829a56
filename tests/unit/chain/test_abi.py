"""The client follows the ABI: nothing that the contracts offer is left out by accident."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rodeo import chain
from rodeo.chain import artifacts
from rodeo.chain.calls import Calls, OrganizationCalls
from rodeo.chain.contract_calls import (
    CommitteeJudgeCalls,
    DeviceRegistryCalls,
    DisputeJudgeCalls,
    RoleJudgeCalls,
)
from rodeo.chain.contracts.abi import (
    ChallengeRequest,
    Fault,
    Finding,
    Instance,
    Namers,
    Revocation,
    Ruling,
    ServiceState,
    TaskRequest,
    Terms,
    Windows,
)
from rodeo.chain.contracts.generate import BETWEEN_CONTRACTS, IGNORED_EVENTS, OF_GOVERNANCE, generated
from rodeo.chain.contracts.types import Event, Policy, Role
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import ContractCalls

ADDRESS = "0x" + "00" * 19 + "01"
DEPLOYMENT = Deployment(
    chain_id=1,
    genesis_hash="0x00",
    block=0,
    contracts={
        name: "0x" + "00" * 19 + f"{index:02}"
        for index, name in enumerate((*artifacts.CONTRACTS, *artifacts.DISPUTES), start=1)
    },
)

SAMPLES: dict[str, Any] = {
    "request": TaskRequest("cleaning", 1, 60, 60, 1, bytes(32), 0, "0x" + "00" * 20, "{}"),
    "role": "robot",
    "kind": "cleaning",
    "state": ServiceState.ACTIVE,
    "proof_hash": bytes(32),
    "root": bytes(32),
    "rules": bytes(32),
    "members_only": True,
    "terms": Terms(2, 1, 3),
    "name": "panther1",
    "r": bytes(32),
    "s": bytes(32),
    "vs": bytes(32),
    "policy": Policy.LOWEST_PRICE,
    **dict.fromkeys(
        ("finding", "f"),
        Finding(1, 1, *[bytes(32)] * 3, Ruling.ACCEPTED, Fault.NOBODY, 1, "accepted"),
    ),
    "signature": bytes(65),
    "signatures": bytes(192),
    "windows": Windows(60, 60, 10, 60, 60, 0),
    "instances": [Instance(ADDRESS, 60, 0, 1, 1), Instance(ADDRESS, 0, 60, 0, 0)],
}


def _entries(kind: str) -> list[tuple[str, dict[str, Any]]]:
    return [
        (artifacts.load(name).name, entry)
        for name in (*artifacts.CONTRACTS, "DisputeJudge")
        for entry in artifacts.load(name).abi
        if entry["type"] == kind
    ]


@pytest.mark.parametrize("name", ["contracts/abi.py", "contract_calls.py", "contracts/events.py"])
def test_the_generated_files_are_what_the_artifacts_say(name: str) -> None:
    assert (Path(chain.__file__).parent / name).read_text() == generated()[name], "run `make contracts`"


def test_another_abi_makes_another_file(monkeypatch: pytest.MonkeyPatch) -> None:
    before = generated()
    built = artifacts.load("TaskManager")
    (cancelled,) = (entry for entry in built.abi if entry.get("name") == "TaskCancelled")
    inputs = [*cancelled["inputs"], {"name": "by", "type": "address", "internalType": "address"}]
    changed = [entry | {"inputs": inputs} if entry is cancelled else entry for entry in built.abi]
    monkeypatch.setattr(
        artifacts,
        "load",
        lambda name, load=artifacts.load: (
            replace(load(name), abi=changed) if name == "TaskManager" else load(name)
        ),
    )
    monkeypatch.setattr(artifacts, "enums", lambda: {"Fault": ["Nobody", "Oracle", "TwoOracles"]})
    after, events = generated(), "contracts/events.py"
    assert "    by: str\n" in after[events] and "    by: str\n" not in before[events]
    assert "    TWO_ORACLES = 2\n" in after["contracts/abi.py"]


def test_every_event_has_a_record_or_is_ignored_on_purpose() -> None:
    records = {record.__name__ for record in Event.__subclasses__()}
    declared = {entry["name"] for _, entry in _entries("event")}
    of_governance = {name for names in OF_GOVERNANCE.values() for name in names} & records
    assert of_governance == {f"Proposal{did}" for did in ("Created", "Queued", "Executed", "Canceled")} | {
        *("VoteCast", "VoteCastWithParams"),
        *("CallScheduled", "CallSalt", "CallExecuted", "Cancelled", "MinDelayChange"),
        *("RoundOpened", "BudgetVoteCast", "BudgetPaid"),
    }
    assert declared - IGNORED_EVENTS == records - of_governance
    assert declared >= IGNORED_EVENTS


ALL_CALLS = (
    Calls(DEPLOYMENT),
    OrganizationCalls(DEPLOYMENT),
    RoleJudgeCalls(DEPLOYMENT, "OracleJudge"),
    CommitteeJudgeCalls(DEPLOYMENT, "OracleCommittee"),
    DeviceRegistryCalls(DEPLOYMENT),
    DisputeJudgeCalls(DEPLOYMENT),
)


@pytest.mark.parametrize("calls", ALL_CALLS, ids=lambda calls: type(calls).__name__)
def test_every_call_encodes(calls: ContractCalls) -> None:
    for name in _methods(calls):
        method = getattr(calls, name)
        parameters = method.__annotations__
        arguments = [
            _sample(parameter, kind) for parameter, kind in parameters.items() if parameter != "return"
        ]
        assert method(*arguments).data.startswith("0x")


def test_every_transaction_has_a_call() -> None:
    encoded = set()
    for calls in ALL_CALLS:
        for name in _methods(calls):
            method = getattr(calls, name)
            arguments = [_sample(p, k) for p, k in method.__annotations__.items() if p != "return"]
            encoded.add(method(*arguments).name)
    declared = {
        entry["name"]
        for contract, entry in _entries("function")
        if entry["stateMutability"] == "nonpayable"
        and entry["name"] not in BETWEEN_CONTRACTS.get(contract, ())
    }
    assert declared == encoded


def _methods(calls: object) -> list[str]:
    return [name for name in dir(calls) if not name.startswith("_")]


def _sample(parameter: str, annotation: str) -> Any:
    if annotation == "Role":
        return Role.ORACLE
    if annotation == "Revocation":
        return Revocation.SUPERSEDED
    if annotation == "ChallengeRequest":
        return ChallengeRequest(ADDRESS, 1, 1, 0, "wrong")
    if annotation == "Namers":
        return Namers.ANYBODY
    if parameter in SAMPLES:
        return SAMPLES[parameter]
    samples: dict[str, Any] = {"int": 1, "str": ADDRESS, "bool": True}
    samples |= {"list[bytes]": [b"\x01"], "list[str]": [ADDRESS]}
    return samples[annotation]
