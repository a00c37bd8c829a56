"""What nodes, web3.py and reverted contracts say, as errors of `rodeo.chain.errors`."""

from __future__ import annotations

import os
import socket
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import requests
import urllib3
from eth_abi import decode
from eth_abi.exceptions import DecodingError
from eth_utils import to_bytes
from eth_utils.abi import abi_to_signature, collapse_if_tuple, function_signature_to_4byte_selector
from web3.exceptions import ContractLogicError, Web3Exception, Web3RPCError

from rodeo.chain import artifacts
from rodeo.chain.errors import ChainUnavailable, ContractReverted, InvalidAnswer, RpcFailed
from rodeo.chain.types import values
from rodeo.currency import IEC, Currency

_BUILT_IN: dict[bytes, dict[str, Any]] = {
    bytes.fromhex("08c379a0"): {"name": "Error", "inputs": [{"name": "reason", "type": "string"}]},
    bytes.fromhex("4e487b71"): {"name": "Panic", "inputs": [{"name": "panicCode", "type": "uint256"}]},
}
"""What Solidity itself reverts with: `require(condition, "sentence")`, and failed assertions."""


_REVERTED = 3
"""JSON-RPC error code of a revert, as geth set it."""

NO_NODE = "the server there is not an Ethereum node"

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


def decode_revert(data: bytes, currency: Currency = IEC) -> ContractReverted:
    """The named error in revert data, whose amounts are of `currency`. `UnknownRevert(data)` for one that
    none of the contracts declares."""
    error = _errors_by_selector().get(data[:4])
    if error is None:
        return ContractReverted("UnknownRevert", {"data": data})
    try:
        raws = decode([collapse_if_tuple(parameter) for parameter in error["inputs"]], data[4:])
        named = values(error["inputs"], raws)
    except (DecodingError, ValueError, OverflowError):
        # Also a string that is no UTF-8, and an enum's value that it does not have.
        return ContractReverted("UnknownRevert", {"data": data})
    return ContractReverted(error["name"], named, currency)


def is_revert(code: Any, message: str) -> bool:
    """Whether a JSON-RPC error says that a contract refused."""
    return code == _REVERTED or "revert" in message.lower()


def revert_data(text: Any) -> bytes:
    """What a node gives as the data of a revert; empty where that is no hex."""
    try:
        return to_bytes(hexstr=text) if isinstance(text, str) and text.startswith("0x") else b""
    except ValueError:
        return b""


@contextmanager
def translated(currency: Currency = IEC) -> Iterator[None]:
    """Let what web3.py raises leave as ChainError, with amounts of `currency`."""
    try:
        yield
    except ContractLogicError as error:
        raise decode_revert(_revert_data(error), currency) from error
    except Web3RPCError as error:
        reply = error.rpc_response.get("error") if error.rpc_response else None
        details = reply if isinstance(reply, dict) else {"message": str(error)}
        if is_revert(details.get("code"), str(details.get("message"))):
            raise decode_revert(revert_data(details.get("data")), currency) from error
        raise RpcFailed(
            "the node refused", rpc_code=details.get("code"), reason=details.get("message")
        ) from error
    except Web3Exception as error:
        raise RpcFailed("the node's answer is not valid", reason=str(error)) from error
    except (requests.RequestException, OSError) as error:
        raise ChainUnavailable("the node does not answer", reason=why_unanswered(error)) from error
    except (ValueError, TypeError, OverflowError) as error:
        # web3.py converts what it was answered without asking whether that can be done.
        raise InvalidAnswer(
            "the node's answer cannot be used", problem=repr(error)[:_LONGEST_REASON]
        ) from error


def why_unanswered(error: BaseException) -> str:
    """Why there was no answer, in a few words: what lies at the bottom of the HTTP libraries' exceptions."""
    causes = [error]
    for cause in causes:
        inner = (*cause.args, getattr(cause, "reason", None), cause.__cause__, cause.__context__)
        causes += [one for one in inner if isinstance(one, BaseException) and one not in causes]
    for cause in reversed(causes):
        if isinstance(cause, socket.gaierror):
            return "unknown host name"
        if isinstance(cause, ssl.SSLError):
            return "TLS failed: " + (cause.reason or "the TLS connection failed").lower().replace("_", " ")
        if isinstance(cause, TimeoutError | urllib3.exceptions.TimeoutError | requests.Timeout):
            return "no answer in time"
        if isinstance(cause, OSError) and cause.errno is not None:
            return os.strerror(cause.errno).lower()
        if isinstance(cause, ValueError) and not isinstance(cause, OSError | urllib3.exceptions.HTTPError):
            return NO_NODE
    first = str(causes[-1]).partition("\n")[0]
    return first[:_LONGEST_REASON] or type(error).__name__


def _revert_data(error: ContractLogicError) -> bytes:
    return revert_data(error.data.get("data") if isinstance(error.data, dict) else error.data)
