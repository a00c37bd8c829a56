"""New blocks -> index -> bus, in that order: a subscriber that gets an event can already query its effect."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from typing import Any

from rodeo.bus.messages import DaoEvent
from rodeo.chain.contracts.logs import Log, decode_json_log, event_topics
from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import ChainError, InvalidAnswer, NotNow, RpcFailed
from services.bridge.errors import ChainReorganized
from services.bridge.heads import Header
from services.bridge.index import KEPT_BLOCKS, NOWHERE, Index, Position, TimedLog
from services.bridge.node import Call, Node

log = logging.getLogger(__name__)

MAX_BLOCKS = 2_000
"""Blocks asked for at once."""
MAX_BATCH = 100
"""Blocks that the node announced and that are requested together."""

BEHIND_GRACE_S = 15.0
"""Wall time for which a node elsewhere may answer with an older head before it counts as a reorganization:
the nodes behind one address are not all equally far."""

_PUBLISH_PAGE = 500
_FORK_PAGE = 32


class Follower:
    """Keeps `index` `confirmations` blocks below the head and hands each event to `publish`.

    `publish(event)` returns whether the event was published; if not, it is published later.
    `on_indexed(hashes)` is called with the transactions that the index has applied, `on_undone(block)` when
    everything after `block` was taken off the chain. One thread owns all of it.
    """

    def __init__(
        self,
        node: Node,
        deployment: Deployment,
        index: Index,
        confirmations: int,
        publish: Callable[[DaoEvent], bool],
        on_indexed: Callable[[set[str]], None] = lambda _hashes: None,
        on_undone: Callable[[int], None] = lambda _block: None,
        grace_s: float = 0.0,
    ) -> None:
        self._node = node
        self._deployment = deployment
        self._foreign_token = deployment.address("IECoin").lower() if deployment.is_token_foreign else None
        self._index = index
        self._confirmations = confirmations
        self._publish = publish
        self._on_indexed = on_indexed
        self._on_undone = on_undone
        self._grace_s = grace_s
        self._filter = {
            "address": deployment.event_sources,
            "topics": [event_topics()],
        }
        self._behind_since_s: float | None = None
        self._unpublished = True
        self.head = -1
        """The newest block of the node, as last reported."""

    @property
    def behind(self) -> int:
        """Blocks of the node, as last reported, that are deep enough and not in the index."""
        return max(0, self.head - self._confirmations - self._index.position.block)

    def step(self, headers: list[Header]) -> bool:
        """Apply the next blocks; returns whether to look for more at once. The node announced `headers`.

        Raises ChainUnavailable or RpcFailed, and ChainReorganized when not even the first block is the same.
        """
        again = not self._take(headers) and self._catch_up()
        if self._unpublished:
            self.publish_missed()
        return again

    def publish_missed(self) -> None:
        """Publish what was indexed but not published, before a crash or while the router was away.

        Subscribers drop what they have.
        """
        self._unpublished = True
        while events := self._index.events_after(self._index.published_seq, _PUBLISH_PAGE):
            if not self._put_on_bus(events):
                return
        self._unpublished = False

    # -- blocks that the node told of ----------------------------------------------------------------------

    def _take(self, headers: list[Header]) -> bool:
        """Apply `headers` with one request to the node; whether they follow on the index, and it has them
        all."""
        end = self._index.position
        if self._confirmations or not headers or len(headers) > MAX_BATCH:
            return False
        for header in headers:
            if (_number(header), header["parentHash"]) != (end.block + 1, end.block_hash):
                return False
            end = _position(header)
        try:
            found = self._ask(
                *(("eth_getLogs", [{**self._filter, "blockHash": header["hash"]}]) for header in headers)
            )
        except (RpcFailed, NotNow):
            return False
        self.head = max(self.head, end.block)
        known = {_number(header): header for header in headers}
        self._apply(self._readable(one for logs in found for one in logs), known, headers[-1])
        return True

    # -- all that there are --------------------------------------------------------------------------------

    def _catch_up(self) -> bool:
        latest = self._header("latest")
        self.head = _number(latest)
        position = self._index.position
        target = self.head - self._confirmations
        if target < 0:
            return False
        end = latest if self._confirmations == 0 else self._header(hex(target))
        if target <= position.block:
            return self._compare(end)
        self._behind_since_s = None
        first = max(position.block + 1, self._deployment.block)
        if target < first:
            return False
        # A part that the node answers at once is indexed before the next one is requested.
        last = min(target, first + min(MAX_BLOCKS, self._node.most_blocks) - 1)
        found, *headers = self._ask(
            ("eth_getLogs", [{**self._filter, "fromBlock": hex(first), "toBlock": hex(last)}]),
            ("eth_getBlockByNumber", [hex(first), False]),
            ("eth_getBlockByNumber", [hex(last), False]),
        )
        if None in headers:
            return False  # it disappeared while we asked
        if (
            first == position.block + 1
            and position.block >= 0
            and headers[0]["parentHash"] != position.block_hash
        ):
            self._reorganize("the next block does not follow the indexed one")
            return True
        known = {_number(header): header for header in headers}
        logs = self._readable(found)
        # Nodes of before 2025 do not report the block's time with a log.
        near = sorted(
            {
                one.block
                for one, time_s in logs
                if one.block not in known and (time_s is None or one.block > self.head - KEPT_BLOCKS)
            }
        )
        answers = self._ask(*(("eth_getBlockByNumber", [hex(number), False]) for number in near))
        known |= dict(zip(near, answers, strict=True))
        if None in known.values():
            return True
        for one, _ in logs:
            header = known.get(one.block)
            if header is not None and header["hash"] != one.block_hash:
                log.info("block %d was replaced while the bridge read it", one.block)
                return True  # again
        self._apply(logs, known, headers[1])
        return True

    def _readable(self, found: Iterable[dict[str, Any]]) -> list[tuple[Log, int | None]]:
        """The logs, each with the time of its block where the node reports that. Raises InvalidAnswer."""
        logs: list[tuple[Log, int | None]] = []
        for one in found:
            time = one.get("blockTimestamp")
            try:
                logs.append((decode_json_log(one), None if time is None else int(time, 16)))
            except ValueError as error:
                # A token that was there before may log anything. No event of our own contracts may be lost.
                if one["address"].lower() != self._foreign_token:
                    raise InvalidAnswer(
                        "an event cannot be read", problem=str(error), contract=one["address"]
                    ) from error
                log.info("left out an event of %s: %s", one["address"], error)
        return logs

    def _apply(self, found: list[tuple[Log, int | None]], known: dict[int, Header], end: Header) -> None:
        def time_s(one: Log, told_s: int | None) -> int:
            if (header := known.get(one.block)) is not None:
                return int(header["timestamp"], 16)
            assert told_s is not None  # else its block was asked for
            return told_s

        logs = [TimedLog(one, time_s(one, told_s)) for one, told_s in found]
        logs.sort(key=lambda one: (one.log.block, one.log.log_index))
        applied = self._index.apply(logs, _position(end), head=self.head)
        if self._unpublished or not self._put_on_bus(applied):
            self._unpublished = True
        self._on_indexed({one.log.tx_hash for one in logs})

    # -- reorganizations -----------------------------------------------------------------------------------

    def _compare(self, header: Header) -> bool:
        """The node's head is where the index is, or before it: the same chain or another one?"""
        position = self._index.position
        if _number(header) == position.block and header["hash"] == position.block_hash:
            self._behind_since_s = None
            return False
        kept = {block.block: block.block_hash for block in self._index.recent_blocks()}
        if kept.get(_number(header), header["hash"]) == header["hash"] and _number(header) < position.block:
            now_s = time.monotonic()
            self._behind_since_s = self._behind_since_s or now_s
            if now_s - self._behind_since_s < self._grace_s:
                return False
        self._reorganize("the chain's head is behind the index")
        return True

    def _reorganize(self, why: str) -> None:
        """Roll the index back to the newest block that is still on the chain, and report what was undone."""
        self._behind_since_s = None
        before = self._index.position
        fork = self._newest_common()
        if fork == NOWHERE:
            genesis = self._header("0x0")["hash"]
            if genesis != self._deployment.genesis_hash:
                raise ChainReorganized(
                    "another chain", genesis_hash=genesis, expected=self._deployment.genesis_hash
                )
        log.warning("%s: rolled back from block %d to %d", why, before.block, fork.block)
        notices = self._index.roll_back(fork)
        self._on_undone(fork.block)
        if self._unpublished or not self._put_on_bus(notices):
            self._unpublished = True

    def _newest_common(self) -> Position:
        blocks = self._index.recent_blocks()
        for first in range(0, len(blocks), _FORK_PAGE):
            page = blocks[first : first + _FORK_PAGE]
            found = self._ask(*(("eth_getBlockByNumber", [hex(one.block), False]) for one in page))
            for block, header in zip(page, found, strict=True):
                if header is not None and header["hash"] == block.block_hash:
                    return block
        return NOWHERE

    # ------------------------------------------------------------------------------------------------------

    def _put_on_bus(self, applied: Iterable[DaoEvent]) -> bool:
        """Publish events; returns whether all were published."""
        last = None
        for event in applied:
            if not self._publish(event):
                break
            last = event.seq
        else:
            if last is not None:
                self._index.mark_published(last)
            return True
        if last is not None:
            self._index.mark_published(last)
        return False

    def _header(self, tag: str) -> Header:
        header: Header | None = self._node.call("eth_getBlockByNumber", tag, False)
        if header is None:
            raise RpcFailed("the node lacks a block", block=tag)
        return header

    def _ask(self, *calls: Call) -> list[Any]:
        answers = self._node.batch(calls)
        for answer in answers:
            if isinstance(answer, ChainError):
                raise answer
        return answers


def _number(header: Header) -> int:
    return int(header["number"], 16)


def _position(header: Header) -> Position:
    return Position(_number(header), header["hash"], int(header["timestamp"], 16))
