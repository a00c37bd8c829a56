"""Signed statements by devices: canonical JSON (RFC 8785) under an Ethereum personal signature (EIP-191).

Signs and recovers with libsecp256k1 itself. Every device checks every other one's seals, one a second, and of
eth-account's time half (to recover) and four fifths (to sign) went into conversions.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

import coincurve
import rfc8785
from eth_account.messages import SignableMessage, encode_defunct
from eth_account.signers.local import LocalAccount
from eth_utils import keccak, to_checksum_address
from pydantic import BaseModel, ConfigDict

from rodeo.evidence.errors import BadAttestation


class Attestation(BaseModel):
    """A `payload` that `signer` (0x address) signed, with the 65-byte `signature` (0x hex)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    payload: dict[str, Any]
    signer: str
    signature: str


def canonical_json(payload: dict[str, Any]) -> bytes:
    """The one byte string for `payload`, whoever writes it. Integers beyond 2**53 need strings.

    Raises BadAttestation when JSON has no such value (NaN, huge integers, other types).
    """
    try:
        plain = _plain(payload)
    except _Unusual:
        pass
    else:
        # Ten times as fast, and the same text for what devices state.
        return json.dumps(plain, sort_keys=True, ensure_ascii=False, separators=(",", ":")).encode()
    try:
        return rfc8785.dumps(payload)
    except rfc8785.CanonicalizationError as error:
        raise BadAttestation("the payload has no canonical JSON form", cause=str(error)) from error


class _Unusual(Exception):
    """A value that Python's JSON might write otherwise than RFC 8785."""


def _plain(value: Any) -> Any:
    """`value` so that Python's JSON with sorted keys is its canonical form. Raises _Unusual."""
    kind = type(value)
    if kind is float:
        if value.is_integer() and -_EXACT < value < _EXACT:
            return int(value)
        # With a fraction (below 2^53, that is) and without an exponent: both write the same digits.
        if 1e-4 <= abs(value) < _EXACT:
            return value
    elif kind is str:
        if value.isascii():
            return value
    elif kind is int:
        if -_EXACT < value < _EXACT:
            return value
    elif kind is dict:
        if all(type(key) is str and key.isascii() for key in value):
            return {key: _plain(one) for key, one in value.items()}
    elif kind is list:
        return [_plain(one) for one in value]
    elif value is None or kind is bool:
        return value
    raise _Unusual


_EXACT = 2**53


def _signable(payload: dict[str, Any]) -> SignableMessage:
    return encode_defunct(canonical_json(payload))


def attest(payload: dict[str, Any], account: LocalAccount) -> Attestation:
    """`payload` signed by `account`."""
    key = _private_key(bytes(account.key))
    *rs, parity = key.sign_recoverable(_digest(_signable(payload)), hasher=None)
    return Attestation(
        payload=payload, signer=account.address, signature="0x" + bytes([*rs, 27 + parity]).hex()
    )


@lru_cache(maxsize=64)
def _private_key(secret: bytes) -> coincurve.PrivateKey:
    """Parsed once: a recording is sealed every second."""
    return coincurve.PrivateKey(secret)


def verify_attestation(attestation: Attestation) -> str:
    """The checksummed address that signed. Raises BadAttestation when that is not the named signer."""
    signable = _signable(attestation.payload)
    return recover(signable, attestation.signature, attestation.signer)


def recover(signable: SignableMessage, signature: str, signer: str) -> str:
    """The checksummed address behind `signature`, which must be `signer`. Raises BadAttestation."""
    try:
        *rs, v = bytes.fromhex(signature.removeprefix("0x"))
        key = coincurve.PublicKey.from_signature_and_message(
            bytes([*rs, _PARITY[v]]), _digest(signable), hasher=None
        )
    except Exception as error:  # coincurve raises several unrelated types for malformed signatures
        raise BadAttestation("the signature is malformed", signer=signer, cause=repr(error)) from error
    recovered = _address(keccak(key.format(compressed=False)[1:])[-20:])
    if recovered.lower() != signer.lower():
        raise BadAttestation(
            "the signature does not match the named signer", signer=signer, recovered=recovered
        )
    return recovered


_PARITY = {0: 0, 1: 1, 27: 0, 28: 1}
"""By the last byte of a signature (v), which of two keys signed."""


def _digest(signable: SignableMessage) -> bytes:
    """What is signed of a message (EIP-191)."""
    return keccak(b"\x19" + signable.version + signable.header + signable.body)


@lru_cache(maxsize=1024)
def _address(tail: bytes) -> str:
    """Checksummed (EIP-55); there are few signers, and each signs often."""
    return to_checksum_address(tail)
