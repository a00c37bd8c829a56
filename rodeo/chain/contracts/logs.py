"""The contracts' logs: which event, and where on the chain."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

from eth_abi.codec import ABIDecoder
from eth_abi.decoding import StringDecoder
from eth_abi.exceptions import DecodingError
from eth_abi.registry import BaseEquals, registry
from eth_utils.abi import collapse_if_tuple, event_abi_to_log_topic
from web3.types import LogReceipt

from rodeo.chain import artifacts
from rodeo.chain.contracts import events
from rodeo.chain.contracts.types import Event, checksummed, field_name, value


def _lenient() -> ABIDecoder:
    """Reads strings of any bytes, as `_decode` does."""
    known = registry.copy()
    known.unregister_decoder("string")
    known.register_decoder(BaseEquals("string"), StringDecoder("replace"), label="string")
    return ABIDecoder(known)


_DECODER = _lenient()


class UnlikeOurs(ValueError):
    """A contract's event with the name of one of ours and another layout, such as those of some tokens."""


@dataclass(frozen=True)
class Log:
    """An event and its place on the chain; (block, log_index) orders them."""

    event: Event
    contract: str
    """Address that logged it."""
    block: int
    block_hash: str
    log_index: int
    """Within the block."""
    tx_hash: str


@dataclass(frozen=True)
class _Declaration:
    record: type[Event]
    inputs: tuple[Mapping[str, Any], ...]
    names: tuple[str, ...]

    def decode(self, topics: Sequence[bytes], data: bytes) -> Event:
        """Raises UnlikeOurs for another event of the same signature, and ValueError for too little data."""
        expected = sum(1 for one in self.inputs if one["indexed"])
        if len(topics) != expected:
            raise UnlikeOurs(f"{self.record.__name__} has {len(topics)} indexed values, not {expected}")
        if len(data) < 32 * (len(self.inputs) - expected):
            raise ValueError(f"{self.record.__name__} has {len(data)} bytes of data")
        indexed = iter(topics)
        unindexed = iter(_decode([p for p in self.inputs if not p["indexed"]], data))
        raws = [_decode([p], next(indexed))[0] if p["indexed"] else next(unindexed) for p in self.inputs]
        return self.record(
            **{name: value(p, raw) for name, p, raw in zip(self.names, self.inputs, raws, strict=True)}
        )


@cache
def _declarations() -> dict[bytes, _Declaration]:
    return {
        event_abi_to_log_topic(entry): _Declaration(  # type: ignore[arg-type]
            record, tuple(entry["inputs"]), tuple(map(field_name, entry["inputs"]))
        )
        for name in artifacts.TOLD
        for entry in artifacts.load(name).abi
        if entry["type"] == "event" and (record := getattr(events, entry["name"], None)) is not None
    }


def woken(logs: Iterable[Log]) -> set[tuple[int, int]]:
    """(block, log index) of each ProviderWokeUp that a call of `wakeUp` has logged, which offers the
    provider's services again. The others belong to the acceptance of a proof, which TaskSettled follows."""
    found: set[tuple[int, int]] = set()
    last: Log | None = None
    for log in logs:
        if isinstance(log.event, events.ProviderWokeUp):
            last = log
            found.add((log.block, log.log_index))
        elif isinstance(log.event, events.TaskSettled) and last is not None and last.tx_hash == log.tx_hash:
            found.discard((last.block, last.log_index))
        elif not isinstance(log.event, _OF_ACCEPTANCE):
            last = None
    return found


_OF_ACCEPTANCE = (events.ProviderProven, events.PenaltyReturned, events.BondReturned)
"""What is logged between the two."""


def _decode(parameters: Sequence[Mapping[str, Any]], data: bytes) -> list[Any]:
    """What `eth_abi.decode` returns, five times as fast for what events hold, and for any text.

    A string on chain is any bytes. eth-abi refuses what is not UTF-8, but no event may be lost for that.
    Raises DecodingError for types that are left to it.
    """
    found: list[Any] = []
    for position, parameter in enumerate(parameters):
        word = data[32 * position : 32 * position + 32]
        kind = parameter["type"]
        if kind == "string":
            start = int.from_bytes(word)
            length = int.from_bytes(data[start : start + 32])
            found.append(data[start + 32 : start + 32 + length].decode(errors="replace"))
        elif kind == "address":
            found.append(word[12:])
        elif kind == "bool":
            found.append(word[31] != 0)
        elif kind == "bytes32":
            found.append(word)
        elif kind.startswith("uint") and kind[4:].isdecimal():
            found.append(int.from_bytes(word))
        else:
            return list(_DECODER.decode([collapse_if_tuple(dict(p)) for p in parameters], data))
    return found


def event_topics() -> list[str]:
    """First topics of all events that have a record: a filter for eth_getLogs."""
    return ["0x" + topic.hex() for topic in _declarations()]


def decode_log(log: LogReceipt) -> Log:
    """The record of a raw log whose first topic is one of `event_topics()`. Raises KeyError for any other,
    and like `decode_event`."""
    return Log(
        event=_declarations()[bytes(log["topics"][0])].decode(log["topics"][1:], bytes(log["data"])),
        contract=checksummed(log["address"]),
        block=log["blockNumber"],
        block_hash=log["blockHash"].to_0x_hex(),
        log_index=log["logIndex"],
        tx_hash=log["transactionHash"].to_0x_hex(),
    )


def decode_logs(logs: Iterable[LogReceipt]) -> Iterator[Log]:
    """The same for many, without events that are UnlikeOurs."""
    for log in logs:
        with suppress(UnlikeOurs):
            yield decode_log(log)


def decode_event(log: Mapping[str, Any]) -> Event:
    """The event of a log as JSON-RPC has it, in hex. Raises KeyError for one that has no record, UnlikeOurs,
    and ValueError where its data cannot be read."""
    topics = [bytes.fromhex(topic[2:]) for topic in log["topics"]]
    if not topics:
        raise KeyError("an anonymous event")
    declaration = _declarations()[topics[0]]
    try:
        return declaration.decode(topics[1:], bytes.fromhex(log["data"][2:]))
    except (DecodingError, LookupError, OverflowError) as error:
        raise ValueError(f"{declaration.record.__name__}: {error!r}") from error


def decode_json_log(log: Mapping[str, Any]) -> Log:
    """The same with its place. Raises like `decode_event`."""
    return Log(
        event=decode_event(log),
        contract=checksummed(log["address"]),
        block=int(log["blockNumber"], 16),
        block_hash=log["blockHash"],
        log_index=int(log["logIndex"], 16),
        tx_hash=log["transactionHash"],
    )
