"""ABI and bytecode of the contracts, as `contracts/build.mjs` wrote them into this folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

CONTRACTS = (
    "IECoin",
    "FirstComeFirstServed",
    "LowestPrice",
    "HighestReputation",
    "Organization",
    "DeviceRegistry",
    "ServiceManager",
    "Providers",
    "TaskManager",
    "SignedRequests",
    "TaskQueues",
    "AuditorJudge",
    "OracleJudge",
    "OracleCommittee",
)

COMMITTEES = ("OracleCommittee", "DisputeCommittee", "AppealCommittee")
"""The judges, one after the other, if rulings can be challenged: as many as the organization has."""

ORACLES = COMMITTEES[0]

DISPUTES = (*COMMITTEES[1:], "DisputeJudge")
"""Contracts that an organization has, too, if rulings can be challenged; without an appeal two of them."""

JUDGES = ("OracleJudge", "OracleCommittee", "DisputeJudge", "AuditorJudge")
"""Contracts that the organization names as the judge of a kind. What one of them cannot decide it passes on
to the auditors, which are the last."""

_BUILT_FROM = {
    "AuditorJudge": "RoleJudge",
    "OracleJudge": "RoleJudge",
    **dict.fromkeys(COMMITTEES, "CommitteeJudge"),
}
"""Contract -> its artifact, where that has another name."""

GOVERNANCE = ("MemberVotes", "OrganizationTimelock", "OrganizationGovernor", "BudgetVotes")
"""Contracts that an organization has, too, if its members decide by vote. If its administrator proposes and
waits, it has the timelock alone."""

TOLD = (*CONTRACTS, "DisputeJudge", *GOVERNANCE)
"""Contracts whose events and errors are read."""

CREATED_BY = {
    "SignedRequests": ("TaskManager", 1),
    "TaskQueues": ("TaskManager", 2),
    "Providers": ("ServiceManager", 1),
    "DeviceRegistry": ("Organization", 1),
}
"""Contract -> the one whose constructor creates it, and its number among those, from 1."""

REGISTRY = "OrganizationRegistry"
"""Creates all others."""


@dataclass(frozen=True)
class Artifact:
    """A built contract."""

    name: str
    """Name of the contract in the sources: RoleJudge for the OracleJudge, for instance."""
    abi: list[dict[str, Any]]
    bytecode: bytes
    """Init code, without constructor arguments."""
    deployed_code: bytes
    """What the constructor leaves on chain, with zeros where immutables go."""
    immutables: tuple[tuple[int, int], ...]
    """(start, length) in bytes of each immutable in the deployed code."""

    def matches(self, code: bytes) -> bool:
        """Whether `code`, read from a chain, is this contract, whatever its immutables are."""
        masked = bytearray(code)
        for start, length in self.immutables:
            masked[start : start + length] = bytes(length)
        return bytes(masked) == self.deployed_code


@cache
def enums() -> dict[str, list[str]]:
    """Enum of the contracts -> its members, in their order."""
    found: dict[str, list[str]] = json.loads((resources.files(__name__) / "enums.json").read_text())
    return found


@cache
def load(name: str) -> Artifact:
    """What contract `name` is built from: one of CONTRACTS, DISPUTES or GOVERNANCE, or REGISTRY."""
    text = (resources.files(__name__) / f"{_BUILT_FROM.get(name, name)}.json").read_text()
    built = json.loads(text)
    return Artifact(
        name=built["contractName"],
        abi=built["abi"],
        bytecode=bytes.fromhex(built["bytecode"].removeprefix("0x")),
        deployed_code=bytes.fromhex(built["deployedBytecode"].removeprefix("0x")),
        immutables=tuple((start, length) for start, length in built["immutables"]),
    )
