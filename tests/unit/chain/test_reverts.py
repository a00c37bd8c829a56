"""Revert data that is not one of ours still becomes a named error."""

from __future__ import annotations

import pytest
from eth_abi import encode

from rodeo.chain.node.translation import decode_revert
from tests.support.evm import error_string


def test_a_sentence_is_an_error_with_its_reason() -> None:
    error = decode_revert(error_string("no"))
    assert (error.code, error.details) == ("error", {"reason": "no"})


def test_a_failed_assertion_is_a_panic_with_its_code() -> None:
    error = decode_revert(bytes.fromhex("4e487b71") + encode(["uint256"], [0x11]))
    assert (error.code, error.details) == ("panic", {"panic_code": 0x11})


@pytest.mark.parametrize(
    "data",
    [b"", b"\x01", bytes.fromhex("deadbeef"), bytes.fromhex("08c379a0ff")],
    ids=["empty", "short", "unknown", "truncated"],
)
def test_what_nobody_declares_keeps_its_bytes(data: bytes) -> None:
    error = decode_revert(data)
    assert (error.code, error.details) == ("unknown_revert", {"data": "0x" + data.hex()})
