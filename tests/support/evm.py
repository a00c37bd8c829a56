"""Contracts of a few opcodes, for tests of the node itself."""

from __future__ import annotations

LOGGER = bytes.fromhex("60403560005260203560003560206000a200")
"""Emits LOG2: topics are the first two words of the calldata, data the third."""

REVERTER = bytes.fromhex("3660006000373660" + "00fd")
"""Reverts with its calldata as revert data."""

BURNER = bytes.fromhex("5b600056")
"""Jumps in place until the gas is gone."""

DESCENDER = bytes.fromhex("5f5f5f5f5f305af100")
"""Calls itself with all gas that is left, as deep as the rules allow."""


THRIFTY = bytes.fromhex("620186a05a10600a57005b5f5ffd")
"""Reverts where fewer than 100,000 gas are left, and uses next to none."""


def creation(runtime: bytes) -> bytes:
    """Init code that installs `runtime`: PUSH1 length, DUP1, PUSH1 11, PUSH1 0, CODECOPY, PUSH1 0, RETURN."""
    return bytes([0x60, len(runtime), 0x80, 0x60, 11, 0x60, 0, 0x39, 0x60, 0, 0xF3]) + runtime


def error_string(reason: str) -> bytes:
    """Revert data of `require(false, reason)`."""
    text = reason.encode()
    padded = text + bytes(-len(text) % 32)
    return bytes.fromhex("08c379a0") + (32).to_bytes(32, "big") + len(text).to_bytes(32, "big") + padded
