"""Whether a transaction could be sent now and its outcome read: what *ready* means for the bridge."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from typing import Any

from eth_utils import function_signature_to_4byte_selector

from rodeo.chain.contracts.logs import event_topics
from rodeo.chain.node.errors import ChainError, ChainUnavailable
from services.bridge.chain import Chain
from services.bridge.index import Position
from services.bridge.node import Call
from services.bridge.outcomes import Outcomes, is_trouble

log = logging.getLogger(__name__)

PERIOD_S = 2.0
"""Wall time between two rounds of questions while the node answers well."""

RETRY_S = 0.5
"""The same while it does not."""

MOST_WALLETS = 20
"""Wallets whose nonces are read in one round; the others follow in the next ones."""

MAX_BLOCK_AHEAD_S = 5.0
"""How far a block of an external chain may be ahead: a node's clock may be off a little, and an executor that
records by another time than the blocks' is not paid (the oracle's `recorded_in_assignment`)."""

_MAY_REFUSE = ("eth_maxPriorityFeePerGas", "eth_estimateGas")
"""Not every node advises a tip, or estimates for an account that owns nothing."""

_TASK_COUNT = "0x" + function_signature_to_4byte_selector("taskCount()").hex()
_WORD = 66
"""Characters of a view's return value with one result."""


def why_late(
    position: Position, max_block_age_s: float | None, now_s: float, elsewhere: bool = False
) -> str | None:
    """Why an up-to-date index does not show the present; None where it does. `elsewhere`: the chain has a
    clock of its own."""
    ahead_s = position.block_time_s - now_s
    if elsewhere and ahead_s > MAX_BLOCK_AHEAD_S:
        return f"clock {ahead_s:.0f} s behind the chain's newest block"
    if max_block_age_s is None or now_s - position.block_time_s <= max_block_age_s:
        return None
    return f"the node is behind: its newest block is older than {max_block_age_s:g} s"


class Probe:
    """Makes the requests that sending and reading an outcome need, and checks the answers. While they
    succeed, a thread of its own asks, so that blocks are published without waiting for it."""

    def __init__(self, chain: Chain, addresses: Mapping[str, str], outcomes: Outcomes) -> None:
        """`addresses`: name -> address of the wallets that sign here."""
        self._chain = chain
        self._addresses = dict(addresses)
        self._outcomes = outcomes
        self._turn = 0
        self._due_s = 0.0
        self._bad = 0
        self._problem: str | None = "the node was not asked yet"
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="probe", daemon=True)
        deployment = chain.deployment
        self._task_manager = deployment.address("TaskManager")
        self._filter = {"address": deployment.event_sources, "topics": [event_topics()]}

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def problem(self) -> str | None:
        """Why no transaction could be sent now, or its outcome not be read; None where both can."""
        if self._problem is not None and time.monotonic() >= self._due_s:
            self._look_now()
        return self._problem

    def watch(self) -> None:
        """Ask again when that is due, and after an unusable answer."""
        is_due = time.monotonic() >= self._due_s or self._chain.node.bad != self._bad
        if self._problem is None and is_due:
            self._look_now()

    def _run(self) -> None:
        while not self._closed.wait(RETRY_S):
            self.watch()

    def _look_now(self) -> None:
        with self._lock:
            now_s = time.monotonic()
            try:
                self._problem = self._look()
            except ChainUnavailable as error:
                self._problem = _badly(error)
            except Exception as error:
                log.exception("cannot tell whether the node answers well")
                self._problem = f"cannot tell whether the node answers well: {error!r}"
            self._bad = self._chain.node.bad
            self._due_s = now_s + (PERIOD_S if self._problem is None else RETRY_S)

    def _look(self) -> str | None:
        """Raises ChainUnavailable."""
        names = sorted(self._addresses)
        first = self._turn % max(1, len(names))
        names = (names[first:] + names[:first])[:MOST_WALLETS]
        self._turn += len(names)
        known = self._chain.index.newest_transaction()
        sender = self._addresses[names[0]] if names else self._task_manager
        calls: list[Call] = [
            ("eth_chainId", []),
            ("eth_getBlockByNumber", ["latest", False]),
            ("eth_maxPriorityFeePerGas", []),
            ("eth_estimateGas", [{"from": sender, "to": sender}, "pending"]),
            ("eth_call", [{"to": self._task_manager, "data": _TASK_COUNT}, "latest"]),
            # Not of the last block read: a node that went back to a shorter chain lacks it.
            ("eth_getLogs", [{**self._filter, "fromBlock": "latest", "toBlock": "latest"}]),
            *([("eth_getTransactionReceipt", [known])] if known else []),
        ]
        nonces: list[Call] = [
            ("eth_getTransactionCount", [self._addresses[name], "pending"]) for name in names
        ]
        answers = self._chain.ask(*calls, *nonces)
        found, counts = answers[: len(calls)], answers[len(calls) :]
        for (method, _), answer in zip(calls, found, strict=True):
            if isinstance(answer, ChainError) and (is_trouble(answer) or method not in _MAY_REFUSE):
                return _badly(answer)
        return (
            self._wrong_chain(found[0])
            or ("the node has no newest block" if found[1] is None else None)
            or _no_contract(found[4])
            or _no_nonces(dict(zip(names, counts, strict=True)))
            or (None if self._outcomes.can_send() else _badly(self._outcomes.sending_trouble))
        )

    def _wrong_chain(self, answer: Any) -> str | None:
        expected = self._chain.deployment.chain_id
        if isinstance(answer, str) and int(answer, 16) == expected:
            return None
        return f"the node is on chain {answer}, not {expected}"


def _no_contract(answer: Any) -> str | None:
    if isinstance(answer, str) and len(answer) == _WORD:
        return None
    return f"the node does not carry out calls of the contracts: {answer}"


def _no_nonces(counts: Mapping[str, Any]) -> str | None:
    """One wallet whose nonce cannot be read holds up nobody else."""
    errors = {name: count for name, count in counts.items() if isinstance(count, ChainError)}
    for name, error in errors.items():
        log.info("%s cannot send: the node does not tell its nonce: %s", name, error)
    return _badly(next(iter(errors.values()))) if counts and len(errors) == len(counts) else None


def _badly(error: ChainError | None) -> str:
    return f"the node does not answer as it should: {error}"
