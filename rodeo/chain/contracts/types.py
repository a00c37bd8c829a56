"""How the contracts' values look in Python. Amounts are wei: the payment token's smallest unit, which
`rodeo.money.currency` converts. Times are block time in seconds.

abi.py and events.py, which are generated, have the types; `value` turns what eth-abi decodes into them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import IntEnum, StrEnum
from functools import cache, lru_cache
from typing import Any

from eth_utils import keccak, to_checksum_address

from rodeo.errors import snake_case

ZERO_ADDRESS = "0x" + "00" * 20
"""Nobody's, where a contract wants an address."""

MAX_RULES = 8
"""Rules of one kind that are current at the same time (IOrganization.sol)."""


class ContractEnum(IntEnum):
    """Base of the contracts' enums in abi.py."""


class Struct:
    """Base of the contracts' structs in abi.py."""


@dataclass(frozen=True)
class Event:
    """Base of all events in events.py."""

    @property
    def name(self) -> str:
        return type(self).__name__

    def args(self) -> dict[str, Any]:
        """The values by name, for JSON: bytes as 0x hex, enums as lower-case names."""
        return {field.name: to_json(getattr(self, field.name)) for field in fields(self)}


class Role(StrEnum):
    """Roles of the Organization, named as in its source; OpenZeppelin's default admin administers it."""

    ADMINISTRATOR = "DEFAULT_ADMIN_ROLE"
    OPERATOR = "OPERATOR_ROLE"
    TREASURER = "TREASURER_ROLE"
    ORACLE = "ORACLE_ROLE"
    AUDITOR = "AUDITOR_ROLE"
    MEMBER = "MEMBER_ROLE"
    GUARDIAN = "GUARDIAN_ROLE"
    ALLOCATOR = "ALLOCATOR_ROLE"

    @property
    def id(self) -> bytes:
        """The 32 bytes that stand for the role on chain."""
        return bytes(32) if self is Role.ADMINISTRATOR else keccak(text=self.value)


class TimelockRole(StrEnum):
    """Roles of the timelock, where that is the organization's administrator."""

    PROPOSER = "PROPOSER_ROLE"
    CANCELLER = "CANCELLER_ROLE"

    @property
    def id(self) -> bytes:
        """The 32 bytes that stand for the role on chain."""
        return keccak(text=self.value)


class Policy(StrEnum):
    """The matching policies that come with the contracts, by contract name."""

    FIRST_COME = "FirstComeFirstServed"
    LOWEST_PRICE = "LowestPrice"
    HIGHEST_REPUTATION = "HighestReputation"


def hex_bytes(value: str | None) -> bytes:
    """The bytes that 0x hex names; a word of zeros for None."""
    return bytes(32) if value is None else bytes.fromhex(value.removeprefix("0x"))


def halves(signature: str) -> tuple[bytes, bytes]:
    """r, and s with its parity (EIP-2098)."""
    raw = hex_bytes(signature)
    return raw[:32], raw[32:]


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


TEXTS = frozenset({"kind", "role", "name", "deviceName", "neededRole"})
"""Parameters of 32 bytes that are text."""

RENAMED = {"Kind": "KindRules"}
"""Structs of the contracts that have another name here."""

_ROLES = {role.id: role.value for role in (*Role, *TimelockRole)}


@cache
def _class(internal_type: str) -> Any:
    """The enum or struct of abi.py that an ABI parameter names; None where it names neither."""
    sort, _, name = internal_type.partition(" ")
    bases: dict[str, type] = {"enum": ContractEnum, "struct": Struct}
    known: list[type] = bases[sort].__subclasses__() if sort in bases else []
    return {one.__name__: one for one in known}.get(RENAMED.get(name, name))


def field_name(parameter: Mapping[str, Any]) -> str:
    """What an ABI parameter is called in Python."""
    name = snake_case(parameter["name"]).rstrip("_")
    return "sender" if name == "from" else name


def value(parameter: Mapping[str, Any], raw: Any) -> Any:
    """`raw`, decoded by eth-abi for an ABI `parameter`, as the type that abi.py gives it.

    Enums and structs become their Python types. Kinds, device roles, device names and access roles become
    text. Other bytes stay bytes.
    """
    if parameter["type"].endswith("[]"):
        internal = parameter.get("internalType", "").removesuffix("[]")
        inner = {**parameter, "type": parameter["type"][:-2], "internalType": internal}
        return [value(inner, one) for one in raw]
    known = _class(parameter.get("internalType", ""))
    if known is not None:
        return known(**values(parameter["components"], raw)) if issubclass(known, Struct) else known(raw)
    if parameter["type"] == "address":
        return checksummed(raw)
    if parameter["type"] == "bytes32" and parameter["name"] in TEXTS:
        return _ROLES.get(bytes(raw)) or bytes32_to_kind(bytes(raw))
    return bytes(raw) if parameter["type"].startswith("bytes") else raw


def values(parameters: list[dict[str, Any]], raws: Any) -> dict[str, Any]:
    """A decoded tuple by the parameters' names."""
    return {
        field_name(parameter): value(parameter, raw) for parameter, raw in zip(parameters, raws, strict=True)
    }


def raw_values(parameters: list[dict[str, Any]], given: Sequence[Any]) -> tuple[Any, ...]:
    """The other way: what eth-abi encodes for `parameters`."""
    return tuple(_raw(parameter, one) for parameter, one in zip(parameters, given, strict=True))


def _raw(parameter: Mapping[str, Any], given: Any) -> Any:
    if isinstance(given, Struct):
        parts = parameter["components"]
        return raw_values(parts, [getattr(given, field_name(part)) for part in parts])
    if isinstance(given, list):
        return [_raw(parameter, one) for one in given]
    if isinstance(given, Role | TimelockRole):
        return given.id
    return kind_to_bytes32(given) if parameter["type"] == "bytes32" and isinstance(given, str) else given


def to_json(decoded: Any) -> Any:
    """A decoded value for JSON: bytes as 0x hex, enums as lower-case names, structs as objects."""
    if isinstance(decoded, Struct):
        return {name: to_json(one) for name, one in vars(decoded).items()}
    if isinstance(decoded, IntEnum):
        return decoded.name.lower()
    if isinstance(decoded, list | tuple):
        return [to_json(one) for one in decoded]
    return "0x" + decoded.hex() if isinstance(decoded, bytes) else decoded
