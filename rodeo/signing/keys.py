"""Keys that sign: a device's, and what is needed of any other. eth-account takes a second to import."""

from __future__ import annotations

from typing import Protocol

from eth_utils import keccak, to_checksum_address

from rodeo.signing import secp256k1


class Signer(Protocol):
    """A private key and its address: a `Key`, or an account of eth-account's."""

    @property
    def key(self) -> bytes:
        """32 bytes."""

    @property
    def address(self) -> str:
        """Checksummed."""


class Key:
    """A private key. Raises ValueError for what is none."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._address = address_of(secp256k1.public_key(key))

    @property
    def key(self) -> bytes:
        return self._key

    @property
    def address(self) -> str:
        return self._address

    def __repr__(self) -> str:
        """The key itself would end in a log."""
        return f"Key({self._address})"


def address_of(public_key: bytes) -> str:
    """The checksummed address of a public key of 64 bytes."""
    return to_checksum_address(keccak(public_key)[-20:])


def personal_digest(text: bytes) -> bytes:
    """What is signed of a personal message (EIP-191, version 0x45)."""
    return keccak(b"\x19Ethereum Signed Message:\n" + str(len(text)).encode() + text)


def sign(digest: bytes, signer: Signer) -> str:
    """The signature as wallets write it: 65 bytes as 0x hex, the last of them 27 or 28."""
    *rs, parity = secp256k1.sign(digest, bytes(signer.key))
    return "0x" + bytes([*rs, 27 + parity]).hex()


def sign_short(digest: bytes, signer: Signer) -> str:
    """The same signature in 64 bytes (EIP-2098), as 0x hex: the highest bit of s stands for the last byte."""
    signature = bytearray(secp256k1.sign(digest, bytes(signer.key)))
    signature[32] |= signature.pop() << 7
    return "0x" + signature.hex()
