"""What an MCAP file says about its own messages, derived from the messages.

Tools that seek read the summary and the indexes instead of the data section, so whoever edits those shows
them other messages than are sealed. Everything there follows from the data section: it is computed again,
in the layout of `mcap.writer` and `McapWriter`, and has to be the same bytes. Record layouts: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

_INDEX = struct.Struct("<BQHI")
"""Opcode and length of a message index, its channel, length of its entries."""
_INDEX_FIELDS_BYTES = 6
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
"""Opcode and length of a chunk index, the chunk's earliest and latest time, its offset and length, and the
length of the list of message indexes."""
_MESSAGE_INDEX_OFFSET = struct.Struct("<HQ")
_CHUNK_SIZES = struct.Struct("<QQ")
_PREFIXED_LENGTH = struct.Struct("<QI")
"""Length of all message indexes of the chunk, length of the compression's name."""
_FOOTER = struct.Struct("<BQQQ")
"""What the summary's checksum covers of the footer."""
_FOOTER_BYTES = 20
_RECORD_BYTES = 9
"""Opcode and length, which a record's length does not count."""

MessageTimes: TypeAlias = "dict[int, array[int]]"
"""Channel -> log time (ns) and offset in the chunk, in turn, of each of its messages in one chunk."""


class ChunkFacts(NamedTuple):
    """Where a chunk stands in the file, and how its messages are packed."""

    offset: int
    length: int
    compression: str
    compressed_size: int
    uncompressed_size: int


class SummaryOf:
    """Collects what the data section says, chunk by chunk."""

    def __init__(self) -> None:
        self.messages = 0
        self.chunks = 0
        self._counts: dict[int, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self._chunk_indexes = bytearray()

    def add_chunk(self, facts: ChunkFacts, times: MessageTimes) -> tuple[int, int, bytes]:
        """Earliest and latest log time (ns) of a chunk of at least one message, and its message indexes."""
        logged_ns = [time_ns for entries in times.values() for time_ns in entries[::2]]
        start_ns, end_ns = min(logged_ns), max(logged_ns)
        behind = facts.offset + facts.length
        offset, offsets, indexes = behind, b"", []
        for channel_id, entries in times.items():
            packed = entries.tobytes()
            indexes.append(
                _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX_FIELDS_BYTES + len(packed), channel_id, len(packed))
            )
            indexes.append(packed)
            offsets += _MESSAGE_INDEX_OFFSET.pack(channel_id, offset)
            offset += _INDEX.size + len(packed)
            self._counts[channel_id] = self._counts.get(channel_id, 0) + len(entries) // 2
        self.messages += len(logged_ns)
        self.chunks += 1
        self._start_ns = start_ns if self._start_ns is None else min(self._start_ns, start_ns)
        self._end_ns = max(self._end_ns, end_ns)
        self._add_index(facts, start_ns, end_ns, offsets, offset - behind)
        return start_ns, end_ns, b"".join(indexes)

    def _add_index(
        self, facts: ChunkFacts, start_ns: int, end_ns: int, offsets: bytes, indexes_bytes: int
    ) -> None:
        """The next chunk index. Packed here: there is one per second, and `mcap` takes a call per field."""
        compression = facts.compression.encode()
        behind = (
            offsets
            + _PREFIXED_LENGTH.pack(indexes_bytes, len(compression))
            + compression
            + _CHUNK_SIZES.pack(facts.compressed_size, facts.uncompressed_size)
        )
        length = _CHUNK_INDEX.size - _RECORD_BYTES + len(behind)
        times_and_place = start_ns, end_ns, facts.offset, facts.length
        self._chunk_indexes += (
            _CHUNK_INDEX.pack(Opcode.CHUNK_INDEX, length, *times_and_place, len(offsets)) + behind
        )

    def ending(self, offset: int, schemas: dict[int, Schema], channels: dict[int, Channel]) -> bytes:
        """The rest of the file from the end of the data section, `offset`, on."""
        data_end = _written([DataEnd(data_section_crc=0)])  # the recorder writes no checksum: it seals
        statistics = Statistics(
            message_count=self.messages,
            schema_count=len(schemas),
            channel_count=len(channels),
            attachment_count=0,
            metadata_count=0,
            chunk_count=self.chunks,
            message_start_time=self._start_ns or 0,
            message_end_time=self._end_ns,
            channel_message_counts=self._counts,
        )
        groups = {
            Opcode.SCHEMA: _written(schemas.values()),
            Opcode.CHANNEL: _written(channels.values()),
            Opcode.STATISTICS: _written([statistics]),
            Opcode.CHUNK_INDEX: bytes(self._chunk_indexes),
            Opcode.ATTACHMENT_INDEX: b"",
            Opcode.METADATA_INDEX: b"",
        }
        summary_start = group_start = offset + len(data_end)
        offsets = []
        for opcode, group in groups.items():
            offsets.append(SummaryOffset(opcode, group_start, len(group)))
            group_start += len(group)
        summary = b"".join(groups.values()) + _written(offsets)
        covered = summary + _FOOTER.pack(Opcode.FOOTER, _FOOTER_BYTES, summary_start, group_start)
        footer = _written([Footer(summary_start, group_start, zlib.crc32(covered))])
        return data_end + summary + footer + MCAP0_MAGIC


def _written(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()
