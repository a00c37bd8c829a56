"""Errors of the chain, below RodeoError; what nodes and web3.py raise is translated here.

RodeoError
└── ChainError
    ├── ChainUnavailable    the node does not answer
    ├── RpcFailed           the node answered with an error that is no revert
    ├── ContractReverted    a contract refused; `name` and `args` are its custom error's
    ├── TransactionFailed   mined without success for another reason than a revert (gas)
    ├── TransactionTimeout  not mined in time; it may still be
    ├── NotDeployed         no record of the contracts for this chain
    ├── WrongChain          the node's chain is not the one that the site file names
    └── DeploymentMismatch  the record is of other contracts than the chain has
"""

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
from rodeo.chain.types import to_json, values
from rodeo.currency import IEC, Currency
from rodeo.errors import RodeoError, snake_case


class ChainError(RodeoError):
    """The chain did not do what was asked."""


class ChainUnavailable(ChainError):
    """The node does not answer. Asking again later may help."""


class RpcFailed(ChainError):
    """The node answered with an error that is no revert; `details` has its code and sentence."""


_AMOUNTS = frozenset({"price", "amount", "bond", "penalty", "balance", "needed", "allowance"})
"""Arguments of errors that are wei of the payment token, whichever error it is."""
_AMOUNTS_OF = {
    "InvalidPrice": {"unit", "max"},
    "InvalidAmount": {"max"},
    "WrongAmountReceived": {"expected", "received"},
    "OverBudget": {"left"},
    "BondTooHigh": {"max_bond"},
}
"""The same where another error's argument of that name is something else."""
_NO_AMOUNTS_OF = {"TooFewVotes": {"needed"}, "TooFewCredits": {"needed"}, "TooLate": {"needed"}}
"""Arguments of these names that are something else: a number of votes or credits, a time."""


class ContractReverted(ChainError):
    """A contract refused. Nothing changed.

    `code` is the error's name in snake case (`wrong_state`), `args` its values in the types of
    `rodeo.chain.types`, `details` the same for JSON, where amounts are decimal strings named `..._iec`.
    """

    def __init__(self, name: str, args: dict[str, Any], currency: Currency = IEC) -> None:
        amounts = (_AMOUNTS | _AMOUNTS_OF.get(name, set())) - _NO_AMOUNTS_OF.get(name, set())
        details = {
            f"{key}_iec" if key in amounts else key: currency.text(arg) if key in amounts else to_json(arg)
            for key, arg in args.items()
        }
        super().__init__(f"the contract refused: {name}", **details)
        self.name = name
        self.args_by_name = args

    @property
    def code(self) -> str:
        return snake_case(self.name)


class TransactionFailed(ChainError):
    """Mined, but it changed nothing, and not because a contract refused: most likely it ran out of gas."""


class TransactionTimeout(ChainError):
    """Not mined in time. It may still be."""


class NotDeployed(ChainError):
    """There is no record of the contracts on this chain; `rodeo site prepare` makes it."""


class WrongChain(ChainError):
    """The node is one of another chain than the site file names. Nothing is sent there."""

    restart_cures = False


class DeploymentMismatch(ChainError):
    """The record does not describe this chain: it was reset, or the contracts were built anew."""


_BUILT_IN: dict[bytes, dict[str, Any]] = {
    bytes.fromhex("08c379a0"): {"name": "Error", "inputs": [{"name": "reason", "type": "string"}]},
    bytes.fromhex("4e487b71"): {"name": "Panic", "inputs": [{"name": "panicCode", "type": "uint256"}]},
}
"""What Solidity itself reverts with: `require(condition, "sentence")`, and failed assertions."""


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
    except DecodingError:
        return ContractReverted("UnknownRevert", {"data": data})
    return ContractReverted(error["name"], values(error["inputs"], raws), currency)


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
        raise RpcFailed(
            "the node refused", rpc_code=details.get("code"), reason=details.get("message")
        ) from error
    except Web3Exception as error:
        raise RpcFailed("the node's answer is not valid", reason=str(error)) from error
    except (requests.RequestException, OSError) as error:
        raise ChainUnavailable("the node does not answer", reason=why_unanswered(error)) from error


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
            return "the server there is not an Ethereum node"
    first = str(causes[-1]).partition("\n")[0]
    return first[:_LONGEST_REASON] or type(error).__name__


def _revert_data(error: ContractLogicError) -> bytes:
    data = error.data.get("data") if isinstance(error.data, dict) else error.data
    return to_bytes(hexstr=data) if isinstance(data, str) and data.startswith("0x") else b""
