"""What is signed of typed data (EIP-712): its digest. Only what RODEO's messages are made of, so no arrays.

eth-account does the same for any type, and imports for a second; a test compares both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from eth_utils import keccak

Types = Mapping[str, Iterable[Mapping[str, str]]]
"""Struct -> its fields, each with `name` and `type`."""

_DOMAIN = {
    "name": "string",
    "version": "string",
    "chainId": "uint256",
    "verifyingContract": "address",
    "salt": "bytes32",
}


def digest(typed: Mapping[str, Any]) -> bytes:
    """What is signed of `typed`, which is as `eth_signTypedData_v4` takes it. Raises ValueError."""
    try:
        return digest_of(typed["domain"], typed["types"], typed["primaryType"], typed["message"])
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"not typed data: {error!r}") from error


def digest_of(domain: Mapping[str, Any], types: Types, primary: str, message: Mapping[str, Any]) -> bytes:
    """The same of its parts."""
    return keccak(b"\x19\x01" + separator(domain) + _hash(primary, types, message))


def separator(domain: Mapping[str, Any]) -> bytes:
    """Hash of a domain. Raises ValueError for a field that domains do not have."""
    if unknown := domain.keys() - _DOMAIN.keys():
        raise ValueError(f"a domain has no field {sorted(unknown)}")
    fields = [{"name": name, "type": kind} for name, kind in _DOMAIN.items() if name in domain]
    return _hash("EIP712Domain", {"EIP712Domain": fields}, domain)


def _hash(struct: str, types: Types, message: Mapping[str, Any]) -> bytes:
    fields = {field["name"]: field["type"] for field in types[struct]}
    if fields.keys() != message.keys():
        raise ValueError(f"{struct} has the fields {sorted(fields)}, not {sorted(message)}")
    words = [keccak(text=_definition(struct, types))]
    words += [_word(kind, types, message[name], name) for name, kind in fields.items()]
    return keccak(b"".join(words))


def _definition(struct: str, types: Types) -> str:
    """The struct as Solidity writes it, followed by those that it is made of, by name."""
    found: set[str] = set()

    def collect(name: str) -> None:
        if name in types and name not in found:
            found.add(name)
            for field in types[name]:
                collect(field["type"])

    collect(struct)
    return "".join(f"{name}({_fields(types, name)})" for name in (struct, *sorted(found - {struct})))


def _fields(types: Types, struct: str) -> str:
    return ",".join(f"{field['type']} {field['name']}" for field in types[struct])


def _word(kind: str, types: Types, value: Any, name: str) -> bytes:
    """32 bytes. Raises ValueError."""
    if kind in types:
        return _hash(kind, types, value)
    if kind == "string" and isinstance(value, str):
        return keccak(text=value)
    if kind == "bool" and isinstance(value, bool):
        return int(value).to_bytes(32)
    if kind == "address":
        return _octets(value, 20, name).rjust(32, b"\0")
    if kind.startswith("bytes") and kind != "bytes":
        return _octets(value, int(kind.removeprefix("bytes")), name).ljust(32, b"\0")
    if kind.startswith("uint") and not isinstance(value, bool) and isinstance(value, int | str):
        number = int(value)
        if not 0 <= number < 1 << int(kind.removeprefix("uint")):
            raise ValueError(f"{name} is no {kind}: {value}")
        return number.to_bytes(32)
    raise ValueError(f"{name} is no {kind}: {value!r}")


def _octets(value: Any, count: int, name: str) -> bytes:
    octets = value if isinstance(value, bytes) else bytes.fromhex(str(value).removeprefix("0x"))
    if len(octets) != count:
        raise ValueError(f"{name} has {len(octets)} bytes, not {count}")
    return octets
