"""What the contracts keep, in Python. Amounts are wei: 10^-18 IEC. Times are block time in seconds.

Mirrors contracts/src/interfaces; `value` turns what eth-abi decodes into these types.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, localcontext
from enum import IntEnum, StrEnum
from functools import lru_cache
from typing import Any

from eth_utils import keccak, to_checksum_address

from rodeo.errors import snake_case

WEI_PER_IEC = 10**18


class TaskState(IntEnum):
    NONE = 0
    OPEN = 1
    ASSIGNED = 2
    SUBMITTED = 3
    UNDECIDED = 4
    """The organization's auditors decide."""
    SETTLED = 5
    CANCELLED = 6
    FAILED = 7


class ServiceState(IntEnum):
    NONE = 0
    ACTIVE = 1
    PAUSED = 2
    RETIRED = 3
    SUSPENDED = 4
    """By the organization, or by its terms after repeated failure; the provider can only retire."""


class Review(IntEnum):
    """Who judges the proofs of a kind."""

    NONE = 0
    """Nobody has said: the kind was never allowed."""
    ORACLE = 1
    AUDITOR = 2


class Verdict(IntEnum):
    """What a judge says of a proof."""

    NONE = 0
    REJECTED = 1
    ACCEPTED = 2
    UNDECIDED = 3
    """Neither side failed: the organization's auditors decide."""


class Silence(IntEnum):
    """Who wins when the auditors let their window pass."""

    NONE = 0
    """Nobody has said."""
    EXECUTOR = 1
    CREATOR = 2


class Cause(IntEnum):
    """Why an attempt failed."""

    REJECTED = 0
    EXECUTION_EXPIRED = 1
    VERDICT_EXPIRED = 2
    AUDIT_EXPIRED = 3


class Revocation(IntEnum):
    """Why a device key was revoked."""

    NONE = 0
    """It is not."""
    SUPERSEDED = 1
    """Another key took over; what it signed before stays good."""
    COMPROMISED = 2
    """Somebody else may have signed with it, also before."""


class Role(StrEnum):
    """Roles of the Organization, named as in its source; OpenZeppelin's default admin administers it."""

    ADMINISTRATOR = "DEFAULT_ADMIN_ROLE"
    OPERATOR = "OPERATOR_ROLE"
    TREASURER = "TREASURER_ROLE"
    ORACLE = "ORACLE_ROLE"
    AUDITOR = "AUDITOR_ROLE"
    MEMBER = "MEMBER_ROLE"

    @property
    def id(self) -> bytes:
        """The 32 bytes that stand for the role on chain."""
        return bytes(32) if self is Role.ADMINISTRATOR else keccak(text=self.value)


class Policy(StrEnum):
    """The matching policies that come with the contracts, by contract name."""

    FIRST_COME = "FirstComeFirstServed"
    LOWEST_PRICE = "LowestPrice"
    HIGHEST_REPUTATION = "HighestReputation"


@dataclass(frozen=True)
class Terms:
    """What a service agrees to when it is registered; all zero: nothing."""

    bond: int
    """Locked until it retires, wei."""
    penalty: int
    """What a rejected or expired attempt takes from the bond for the treasury, wei; at most `bond`."""
    max_failures: int
    """Failures in a row that suspend the service, up to 255; 0 for no limit."""


@dataclass(frozen=True)
class KindRules:
    """What the organization says about a kind of work."""

    allowed: bool
    review: Review
    min_window: int
    """The shortest execution window that a task may have, s."""
    audit_window: int
    """How long auditors may look at what an oracle could not decide, s; 0 where nobody has said."""
    silence: Silence


@dataclass(frozen=True)
class TaskRequest:
    """What registerTask takes. `reward` in wei, windows in seconds, `params` a JSON text."""

    kind: str
    reward: int
    execution_window: int
    verdict_window: int
    max_attempts: int
    params: str


@dataclass(frozen=True)
class Task:
    """A task as the TaskManager keeps it; texts are only in its events."""

    creator: str
    reward: int
    kind: str
    price: int
    """What the executor of the running or last attempt is paid at most, wei; 0 while open."""
    service_id: int
    """Service of the running or last attempt; 0 while open."""
    deadline: int
    """End of the running window; 0 when none runs."""
    execution_window: int
    verdict_window: int
    attempt: int
    max_attempts: int
    state: TaskState
    proof_hash: bytes
    """The proof that waits for its verdict; zeros unless SUBMITTED or UNDECIDED."""


@dataclass(frozen=True)
class Service:
    """A service as the ServiceManager keeps it."""

    provider: str
    price: int
    kind: str
    task_id: int
    """The task it does now; 0 when it does none."""
    place: int
    """Its place among the idle services, lower was there earlier; 0 when it does not wait."""
    state: ServiceState
    completed: int
    rejected: int
    expired: int
    reputation: int
    """Share of accepted attempts in 64ths, (completed + 1) / (all + 2): 32 for a newcomer."""
    bond: int
    """What is left of it, wei."""
    penalty: int
    """What a failed attempt takes from the bond, wei; agreed at registration."""
    max_failures: int
    """Failures in a row that suspend it; 0 for no limit; agreed at registration."""
    failures: int
    """Failures in a row until now; counted only where there are terms."""


@dataclass(frozen=True)
class Device:
    """A key that may sign evidence. Of the keys that are not revoked one at most has its role and name."""

    role: str
    name: str
    """Which one it is on its site: panther1, itrash, dock1."""
    owner: str
    registered_at: int
    revoked_at: int
    """0 while its signatures count."""
    registrar: str
    revocation: Revocation


def to_wei(amount_iec: Decimal) -> int:
    """IEC -> wei. Raises ValueError for what is negative, no number or has more than 18 decimals."""
    if not amount_iec.is_finite() or amount_iec < 0:
        raise ValueError(f"not an amount: {amount_iec}")
    # The default context has 28 digits, fewer than a large balance.
    with localcontext(prec=100):
        wei = amount_iec * WEI_PER_IEC
        if wei != wei.to_integral_value():
            raise ValueError(f"more than 18 decimals: {amount_iec}")
        return int(wei)


def from_wei(wei: int) -> Decimal:
    """Wei -> IEC, without trailing zeros or an exponent when formatted with `f"{amount:f}"`."""
    with localcontext(prec=100):
        whole, rest = divmod(wei, WEI_PER_IEC)
        return Decimal(whole) if rest == 0 else (Decimal(wei) / WEI_PER_IEC).normalize()


def kind_to_bytes32(kind: str) -> bytes:
    """ASCII, padded with zeros on the right. Raises ValueError when it does not fit or is not ASCII."""
    encoded = kind.encode("ascii")
    if not 0 < len(encoded) <= 32:
        raise ValueError(f"a kind has 1 to 32 characters: {kind!r}")
    return encoded.ljust(32, b"\0")


def bytes32_to_kind(word: bytes) -> str:
    """The other way; hex of the whole word when it is no such text, since anybody may write any bytes."""
    text = word.rstrip(b"\0").decode("ascii", errors="replace")
    return text if text.isascii() and text.isprintable() else "0x" + word.hex()


@lru_cache(maxsize=16_384)
def checksummed(address: str | bytes) -> str:
    """EIP-55. Remembered: the same few parties appear in every event, and hashing is slow."""
    return to_checksum_address(address)


_ENUMS: Mapping[str, type[IntEnum]] = {
    "enum TaskState": TaskState,
    "enum ServiceState": ServiceState,
    "enum Cause": Cause,
    "enum Review": Review,
    "enum Revocation": Revocation,
    "enum Silence": Silence,
    "enum Verdict": Verdict,
}

_STRUCTS: Mapping[str, type] = {
    "struct Task": Task,
    "struct Service": Service,
    "struct Device": Device,
    "struct Terms": Terms,
    "struct Kind": KindRules,
}

_TEXTS = frozenset({"kind", "role", "name", "deviceName", "neededRole"})
"""Parameters of 32 bytes that are text."""

_ROLES = {role.id: role.value for role in Role}


def value(parameter: Mapping[str, Any], raw: Any) -> Any:
    """`raw`, decoded by eth-abi for an ABI `parameter`, as the type that this module gives it.

    Enums and structs become theirs, kinds, device roles and device names text, access roles their names.
    Other bytes stay bytes.
    """
    internal_type = parameter.get("internalType", "")
    if internal_type in _ENUMS:
        return _ENUMS[internal_type](raw)
    if internal_type in _STRUCTS:
        return _STRUCTS[internal_type](**values(parameter["components"], raw))
    if parameter["type"] == "address":
        return checksummed(raw)
    if parameter["type"] == "bytes32" and parameter["name"] in _TEXTS:
        return _ROLES.get(bytes(raw)) or bytes32_to_kind(bytes(raw))
    return bytes(raw) if parameter["type"].startswith("bytes") else raw


def values(parameters: list[dict[str, Any]], raws: Any) -> dict[str, Any]:
    """A decoded tuple by the parameters' names in snake case."""
    return {
        snake_case(parameter["name"]): value(parameter, raw)
        for parameter, raw in zip(parameters, raws, strict=True)
    }


def to_json(decoded: Any) -> Any:
    """A decoded value for JSON: bytes as 0x hex, enums as lower-case names."""
    if isinstance(decoded, IntEnum):
        return decoded.name.lower()
    return "0x" + decoded.hex() if isinstance(decoded, bytes) else decoded
