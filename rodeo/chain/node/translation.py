"""Errors of nodes, web3.py and reverted contracts, translated to those of `rodeo.chain.node.errors`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import requests
from eth_abi import decode
from eth_abi.exceptions import DecodingError
from eth_utils.abi import abi_to_signature, collapse_if_tuple, function_signature_to_4byte_selector
from web3.exceptions import Web3Exception

from rodeo.chain import artifacts
from rodeo.chain.contracts.types import values
from rodeo.chain.node.answers import Refusal
from rodeo.chain.node.errors import ChainError, ChainUnavailable, ContractReverted, InvalidAnswer, RpcFailed
from rodeo.chain.node.rpc import Refused
from rodeo.chain.node.unanswered import why_unanswered
from rodeo.money.currency import IEC, Currency

_BUILT_IN: dict[bytes, dict[str, Any]] = {
    bytes.fromhex("08c379a0"): {"name": "Error", "inputs": [{"name": "reason", "type": "string"}]},
    bytes.fromhex("4e487b71"): {"name": "Panic", "inputs": [{"name": "panicCode", "type": "uint256"}]},
}
"""Reverts of Solidity itself: `require(condition, "sentence")`, and failed assertions."""


_LONGEST_REASON = 120
"""Characters of another library's sentence."""


@cache
def _errors_by_selector() -> dict[bytes, dict[str, Any]]:
    declared = (
        entry
        for name in (*artifacts.TOLD, artifacts.REGISTRY)
        for entry in artifacts.load(name).abi
        if entry["type"] == "error"
    )
    by_selector = {function_signature_to_4byte_selector(abi_to_signature(e)): e for e in declared}  # type: ignore[arg-type]
    return _BUILT_IN | by_selector


def decode_revert(data: bytes, currency: Currency = IEC, words: str = "") -> ContractReverted:
    """The named error in revert data, whose amounts are of `currency`. `UnknownRevert(data, said)` for one
    that none of the contracts declares, with the node's `words`."""
    unknown = ContractReverted("UnknownRevert", {"data": data} | ({"said": words} if words else {}))
    error = _errors_by_selector().get(data[:4])
    if error is None:
        return unknown
    try:
        raws = decode([collapse_if_tuple(parameter) for parameter in error["inputs"]], data[4:])
        named = values(error["inputs"], raws)
    except (DecodingError, ValueError, OverflowError):
        # Also a string that is no UTF-8, and an enum's value that it does not have.
        return unknown
    return ContractReverted(error["name"], named, currency)


def said(refusal: Refusal, currency: Currency = IEC) -> ChainError:
    """The error that a node's refusal is, with its words."""
    if not refusal.is_revert:
        return RpcFailed(
            "the node refused", rpc_code=refusal.code, reason=refusal.message, kind=refusal.kind.value
        )
    return decode_revert(bytes.fromhex((refusal.data or "0x")[2:]), currency, refusal.message)


@contextmanager
def translated(currency: Currency = IEC) -> Iterator[None]:
    """Let what web3.py and eth-abi raise leave as ChainError, with amounts of `currency`."""
    try:
        yield
    except Refused as error:
        raise said(error.refusal, currency) from error
    except (Web3Exception, DecodingError) as error:
        raise RpcFailed("the node's answer is not valid", reason=str(error)) from error
    except (requests.RequestException, OSError) as error:
        raise ChainUnavailable("the node does not answer", reason=why_unanswered(error)) from error
    except (ValueError, TypeError, OverflowError) as error:
        # web3.py converts what it was answered without asking whether that can be done.
        raise InvalidAnswer(
            "the node's answer cannot be used", problem=repr(error)[:_LONGEST_REASON]
        ) from error
