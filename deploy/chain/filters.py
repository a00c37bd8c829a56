"""Logs of the local chain, and the filters that callers poll."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from eth.abc import BlockAPI

from deploy.chain.blocks import NEWEST, Blocks
from deploy.chain.codec import (
    data,
    log_json,
    parse_address,
    parse_data,
    parse_object,
    parse_quantity,
    quantity,
)
from deploy.chain.errors import InvalidParams, RpcError
from deploy.chain.local_chain import LocalChain
from deploy.chain.store import StoredLog
from rodeo.text.strict_json import Json

MAX_FILTERS = 1_000
"""Filters kept for callers; beyond it the one not asked for the longest time goes."""


@dataclass(frozen=True)
class LogCriteria:
    """Selection of eth_getLogs and eth_newFilter. A topic position is None (any) or a set (one of them)."""

    addresses: tuple[bytes, ...]
    topics: tuple[frozenset[bytes] | None, ...]

    @classmethod
    def parse(cls, query: Json) -> LogCriteria:
        addresses = query.get("address") or []
        topics = query.get("topics") or []
        if not isinstance(topics, list) or len(topics) > 4:
            raise InvalidParams("topics: not a list of at most 4")
        return cls(
            addresses=tuple(map(parse_address, addresses if isinstance(addresses, list) else [addresses])),
            topics=tuple(cls._parse_topic(topic) for topic in topics),
        )

    @staticmethod
    def _parse_topic(topic: Any) -> frozenset[bytes] | None:
        if topic is None or topic == []:
            return None
        alternatives = topic if isinstance(topic, list) else [topic]
        if None in alternatives:
            return None
        return frozenset(parse_data(one, "topic", size=32) for one in alternatives)

    def matches(self, log: StoredLog) -> bool:
        """Whether the topics fit; addresses are already selected by the store."""
        if len(self.topics) > len(log.topics):
            return False
        return all(
            wanted is None or found in wanted for wanted, found in zip(self.topics, log.topics, strict=False)
        )


@dataclass
class _Filter:
    """A filter that a caller polls with eth_getFilterChanges."""

    changes: Callable[[int, int], list[Any]]
    """Items of the inclusive range of blocks."""
    next_block: int
    first_block: int
    criteria: LogCriteria | None = None
    last_block: int | None = None


@dataclass
class Filters:
    """Logs of any range, and the filters of all callers."""

    local_chain: LocalChain
    blocks: Blocks
    _filters: OrderedDict[int, _Filter] = field(default_factory=OrderedDict)
    _made: int = 0

    def get_logs(self, query: Any) -> list[Json]:
        fields = parse_object(query, "filter")
        criteria = LogCriteria.parse(fields)
        if fields.get("blockHash") is not None:
            if fields.get("fromBlock") is not None or fields.get("toBlock") is not None:
                raise InvalidParams("cannot specify both blockHash and fromBlock/toBlock")
            header = self.local_chain.header_by_hash(parse_data(fields["blockHash"], "blockHash", size=32))
            if header is None:
                raise RpcError("unknown block")
            first = last = header.block_number
        else:
            first, last = self.blocks.range_of(fields)
        return self._logs(criteria, first, last)

    def new_filter(self, query: Any) -> str:
        fields = parse_object(query, "filter")
        criteria = LogCriteria.parse(fields)
        first, last = self.blocks.range_of(fields)
        return self._add_filter(
            _Filter(
                changes=lambda first, last: self._logs(criteria, first, last),
                next_block=self.local_chain.head.block_number + 1,
                first_block=first,
                criteria=criteria,
                last_block=None if fields.get("toBlock") in (None, *NEWEST, "pending") else last,
            )
        )

    def new_block_filter(self) -> str:
        return self._add_changes(lambda block: [data(block.hash)])

    def new_pending_transaction_filter(self) -> str:
        return self._add_changes(lambda block: [data(transaction.hash) for transaction in block.transactions])

    def filter_changes(self, filter_id: Any) -> list[Any]:
        found = self._filter(filter_id)
        first, last = found.next_block, self.local_chain.head.block_number
        found.next_block = last + 1
        return found.changes(
            max(first, found.first_block), last if found.last_block is None else min(last, found.last_block)
        )

    def filter_logs(self, filter_id: Any) -> list[Json]:
        found = self._filter(filter_id)
        if found.criteria is None:
            raise RpcError("filter not found")
        last = self.local_chain.head.block_number if found.last_block is None else found.last_block
        return self._logs(found.criteria, found.first_block, last)

    def uninstall_filter(self, filter_id: Any) -> bool:
        return self._filters.pop(parse_quantity(filter_id, "filter id"), None) is not None

    def _logs(self, criteria: LogCriteria, first: int, last: int) -> list[Json]:
        found = self.local_chain.logs(first, last, criteria.addresses)
        return [log_json(log) for log in found if criteria.matches(log)]

    def _add_changes(self, of_block: Callable[[BlockAPI], list[str]]) -> str:
        def changes(first: int, last: int) -> list[str]:
            blocks = (self.blocks.block(quantity(number)) for number in range(first, last + 1))
            return [item for block in blocks if block is not None for item in of_block(block)]

        next_block = self.local_chain.head.block_number + 1
        return self._add_filter(_Filter(changes=changes, next_block=next_block, first_block=next_block))

    def _add_filter(self, new: _Filter) -> str:
        self._made += 1
        self._filters[self._made] = new
        while len(self._filters) > MAX_FILTERS:
            self._filters.popitem(last=False)
        return quantity(self._made)

    def _filter(self, filter_id: Any) -> _Filter:
        number = parse_quantity(filter_id, "filter id")
        if number not in self._filters:
            raise RpcError("filter not found")
        self._filters.move_to_end(number)
        return self._filters[number]
