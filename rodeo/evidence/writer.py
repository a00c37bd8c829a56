"""Writes MCAP files of one shape: chunks packed with zstd, with message indexes, and a summary.

`mcap.writer` writes the same bytes, but calls Python a dozen times for each message, of which there are
hundreds a second. What does not come once a message is written by `mcap`'s records and by `SummaryOf`, which
readers hold against it. Record layouts: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from typing import BinaryIO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, McapRecord, Schema
from mcap.writer import MCAP0_MAGIC

from rodeo.evidence.summary import ChunkFacts, MessageTimes, SummaryOf

COMPRESSION = "zstd"
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_FIELDS_BYTES = _MESSAGE.size - 9
"""Bytes of a message beside its data; a record's opcode and length do not count."""
_CHUNK_BYTES = 1024 * 1024
"""A chunk that is larger is closed, as `mcap.writer` does."""


class McapWriter:
    """Appends to `stream`, which is at its beginning. One thread at a time."""

    def __init__(self, stream: BinaryIO, profile: str, library: str) -> None:
        self._stream = stream
        self._summary = SummaryOf()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._offset = 0
        self._parts: list[bytes] = []
        """Records of the chunk in progress."""
        self._size = 0
        self._times: MessageTimes = {}
        self._put(MCAP0_MAGIC)
        self._put(_written(Header(profile, library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """The number of a new schema."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas[schema.id] = schema
        self._add(_written(schema))
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema_id: int) -> int:
        """The number of a new channel; `schema_id` 0 is none."""
        number = len(self._channels) + 1
        channel = Channel(id=number, topic=topic, message_encoding=encoding, schema_id=schema_id, metadata={})
        self._channels[number] = channel
        self._add(_written(channel))
        return number

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> bytes:
        """The message's record, as it will be in the file."""
        record = message_record(channel_id, sequence, log_ns, publish_ns, data)
        times = self._times.get(channel_id)
        if times is None:
            times = self._times[channel_id] = array("Q")
        times.append(log_ns)
        times.append(self._size)
        self._add(record)
        return record

    def flush(self) -> None:
        """Close the chunk in progress, if it has a message, and hand everything to the operating system."""
        self._close_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write what follows the messages."""
        self._close_chunk()
        self._put(self._summary.ending(self._offset, self._schemas, self._channels))
        self._stream.flush()

    def _add(self, record: bytes) -> None:
        self._parts.append(record)
        self._size += len(record)
        if self._size > _CHUNK_BYTES:
            self._close_chunk()

    def _close_chunk(self) -> None:
        if not self._times:
            return
        data, times = b"".join(self._parts), self._times
        self._parts, self._times, self._size = [], {}, 0
        packed = zstandard.compress(data)
        logged_ns = [time_ns for entries in times.values() for time_ns in entries[::2]]
        chunk = _written(
            Chunk(
                compression=COMPRESSION,
                data=packed,
                message_start_time=min(logged_ns),
                message_end_time=max(logged_ns),
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        facts = ChunkFacts(self._offset, len(chunk), COMPRESSION, len(packed), len(data))
        *_, indexes = self._summary.add_chunk(facts, times)
        self._put(chunk)
        self._put(indexes)

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._offset += len(data)


def message_record(channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> bytes:
    length = _FIELDS_BYTES + len(data)
    return _MESSAGE.pack(_MESSAGE_OPCODE, length, channel_id, sequence, log_ns, publish_ns) + data


def _written(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
