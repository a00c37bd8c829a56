"""Addresses that people type."""

from __future__ import annotations

from eth_utils import is_hex_address, to_checksum_address


def typed_address(text: str) -> str:
    """The checksummed address. In mixed case it has a checksum (EIP-55), which finds typing mistakes.

    Raises ValueError for what is no address, or has another checksum.
    """
    if not is_hex_address(text) or not text.startswith("0x"):
        raise ValueError(f"no address: {text}")
    found = to_checksum_address(text)
    digits = text[2:]
    if text != found and digits not in (digits.lower(), digits.upper()):
        raise ValueError(f"an address with a typing mistake, as its checksum shows: {text}")
    return found
