"""ECDSA on the curve secp256k1, by libsecp256k1. What signs, verifies or recovers a key calls this module.

Private keys and digests have 32 bytes, public keys 64 (x and y). A recoverable signature has 65: r, s, and 0
or 1 for which of two public keys fits. Nonces follow RFC 6979, so a key signs one digest in one way only, and
s is low. eth_keys, and with it eth-account and py-evm, calls it through `rodeo.signing.ecc_backend`.
"""

from __future__ import annotations

from btclib_secp256k1 import dsa, keys, recovery

_POINT = b"\x04"
"""Begins a public key that is not compressed."""


def sign(digest: bytes, key: bytes) -> bytes:
    """A recoverable signature. Raises ValueError for what is no private key or no digest."""
    # Without the library's check, which recovers the key again and makes signing three times as slow.
    signature, parity = recovery.sign(digest, key, verify=False)
    return signature + bytes([parity])


def sign_der(digest: bytes, key: bytes) -> bytes:
    """A signature in DER. Raises ValueError for what is no private key or no digest."""
    return dsa.sign(digest, key, verify=False)


def recover(digest: bytes, signature: bytes) -> bytes:
    """The public key behind a recoverable signature. Raises ValueError for what is none."""
    if len(signature) != 65:
        raise ValueError(f"a recoverable signature has 65 bytes, not {len(signature)}")
    return recovery.recover(digest, signature[:64], signature[64], compressed=False)[1:]


def verify(digest: bytes, signature: bytes, public_key: bytes) -> bool:
    """Whether r and s (64 bytes) are a signature by `public_key`; a high s counts as well."""
    return dsa.verify(digest, _POINT + public_key, signature, normalize=True, compact=True)


def compact(der: bytes) -> bytes:
    """r and s, 64 bytes, of a signature in DER. Raises ValueError for what is none."""
    return dsa.to_compact(der)


def public_key(key: bytes) -> bytes:
    """The public key of a private one. Raises ValueError for what is none."""
    return keys.pubkey_from_prvkey(key, compressed=False)[1:]


def compress(public_key: bytes) -> bytes:
    """33 bytes. Raises ValueError for what is no point of the curve."""
    return keys.reserialize(_POINT + public_key, compressed=True)


def decompress(compressed: bytes) -> bytes:
    """The other way. Raises ValueError for what is no public key."""
    return keys.reserialize(compressed, compressed=False)[1:]
