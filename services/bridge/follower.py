"""New blocks -> index -> bus, in that order: whoever hears of an event can already ask for its effect."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from web3.types import BlockData

from rodeo.chain import ChainClient
from rodeo.chain.errors import translated
from rodeo.messages import DaoEvent
from services.bridge.errors import ChainReorganized
from services.bridge.index import Index, Position, TimedLog

log = logging.getLogger(__name__)

MAX_BLOCKS = 2_000
"""Blocks asked for at once; nodes limit the range or the size of an answer."""

ACTIVE_POLL_S = 0.02
IDLE_POLL_S = 0.2
_ACTIVE_S = 2.0
"""Wall time after the last new block for which the node is asked often."""

_PUBLISH_PAGE = 500


class Follower:
    """Keeps `index` at the head of the chain and hands each event to `publish` once it can be queried.

    `step` belongs to one thread; `wake` and `wait_indexed` may be called from any.
    """

    def __init__(
        self, client: ChainClient, index: Index, confirmations: int, publish: Callable[[DaoEvent], None]
    ) -> None:
        self._client = client
        self._index = index
        self._confirmations = confirmations
        self._publish = publish
        self._wake = threading.Event()
        self._advanced = threading.Condition()
        self._active_until_s = 0.0

    def step(self) -> bool:
        """Take in the next blocks, at most MAX_BLOCKS; whether there were any.

        Raises ChainUnavailable or RpcFailed, and ChainReorganized when what was indexed is gone.
        """
        with translated():
            head = self._client.w3.eth.block_number - self._confirmations
        position = self._index.position
        first = max(position.block + 1, self._client.deployment.block)
        if head < position.block:
            raise ChainReorganized("the chain is shorter than the index", head=head, indexed=position.block)
        if head < first:
            return False
        self._require_same_chain(position)
        last = min(head, first + MAX_BLOCKS - 1)
        found = self._client.logs(first, last)
        blocks = {number: self._block(number) for number in {last, *(one.block for one in found)}}
        for one in found:
            if blocks[one.block]["hash"].to_0x_hex() != one.block_hash:
                raise ChainReorganized("a block was replaced while it was read", block=one.block)
        applied = self._index.apply(
            [TimedLog(one, blocks[one.block]["timestamp"]) for one in found],
            Position(last, blocks[last]["hash"].to_0x_hex(), blocks[last]["timestamp"]),
        )
        self._put_on_bus(applied)
        with self._advanced:
            self._advanced.notify_all()
        self._active_until_s = time.monotonic() + _ACTIVE_S
        return True

    def publish_missed(self) -> None:
        """Publish what was indexed but not published before a crash. Subscribers drop what they have."""
        while events := self._index.events_after(self._index.published_seq, _PUBLISH_PAGE):
            self._put_on_bus(events)

    def wait(self, stop: threading.Event) -> None:
        """Until it is time for the next `step`; much sooner when there is something to expect."""
        active = time.monotonic() < self._active_until_s
        self._wake.wait(ACTIVE_POLL_S if active else IDLE_POLL_S)
        self._wake.clear()

    def wake(self) -> None:
        """There is a new block, somebody knows."""
        self._wake.set()

    def wait_indexed(self, block: int, timeout_s: float) -> bool:
        """Block until the index has `block`; False when `timeout_s` (wall) passed before."""
        self.wake()
        with self._advanced:
            return self._advanced.wait_for(lambda: self._index.position.block >= block, timeout_s)

    def _put_on_bus(self, events: list[DaoEvent]) -> None:
        for event in events:
            self._publish(event)
        if events:
            self._index.mark_published(events[-1].seq)

    def _require_same_chain(self, position: Position) -> None:
        if position.block < 0:
            return
        found = self._block(position.block)["hash"].to_0x_hex()
        if found != position.block_hash:
            raise ChainReorganized(
                "an indexed block is not on the chain any more",
                block=position.block,
                indexed=position.block_hash,
                found=found,
            )

    def _block(self, number: int) -> BlockData:
        with translated():
            return self._client.w3.eth.get_block(number)
