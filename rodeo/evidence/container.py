"""Strict reading of MCAP files from strangers: every record in file order, nothing allocated on their word.

The `mcap` package's readers trust sizes that the file states (a chunk's, a zstd frame's) and report
malformed records through a dozen exception types; here each is checked against `Limits` first and reported
as one of `ContainerError`. Record layouts: https://mcap.dev/spec.

A file has one reading: what this module accepts, every other tool reads as the same messages. So it refuses
what a tool may skip, ignore or stumble over: records and bytes that the recorder does not write, and indexes
and a summary that do not follow from the messages (`summary.py`).
"""

from __future__ import annotations

import mmap
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, McapRecord, Schema
from mcap.writer import MCAP0_MAGIC

from rodeo.evidence.errors import CorruptProof, ProofTooLarge, TruncatedProof
from rodeo.evidence.summary import ChunkFacts, MessageTimes, SummaryOf
from rodeo.ros2.definitions import schema_text
from rodeo.ros2.errors import UnknownType

Record = TypeVar("Record", bound=McapRecord)

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_CHUNK = struct.Struct("<QQQII")
"""Earliest and latest time, size and checksum of what is packed, length of the compression's name."""
_LENGTH = struct.Struct("<Q")
_ENCODINGS = {"json": None, "cdr": "ros2msg"}
"""Message encoding -> schema encoding; JSON channels have no schema."""
_MOST_RECORDS = 2_000_000
"""Most records that are counted before the first chunk is decompressed; further ones are counted as they are
read."""
_FORGOTTEN_BYTES = 16 * 1024**2
"""Read from the mapped file between two times that it is dropped from memory."""
_ZSTD_WINDOW_BYTES = 8 * 1024**2
"""Decoders may refuse a larger window than this (RFC 8878, 3.1.1.1.2), unless the content is larger."""


@dataclass(frozen=True)
class Limits:
    """What a file may cost its reader. The defaults admit a day of 50 Hz recording; a proof has less
    (`rodeo.checks.counts`)."""

    file_bytes: int = 512 * 1024**2
    uncompressed_bytes: int = 1024**3
    chunk_bytes: int = 16 * 1024**2
    """The recorder closes a chunk of more than one MiB, and a picture has eight at most."""
    json_bytes: int = 1024**2
    """Most bytes of one JSON message. Its objects take up to 24 times as much."""
    messages: int = 5_000_000
    chunks: int = 500_000
    seals: int = 500_000
    seal_bytes: int = 8 * 1024
    """Most bytes of one seal; the recorder's have 1100."""
    channels: int = 256
    declaration_bytes: int = 64 * 1024
    """Most bytes of a schema, of a channel, and of the header; the longest definition has 2200."""
    topic_bytes: int = 256
    """Most bytes of a topic's name, as in ROS 2."""
    earliest_ns: int = 946_684_800 * 10**9
    """2000-01-01, before any site of ours."""
    latest_ns: int = 4_102_444_800 * 10**9
    """2100-01-01."""


class RawMessage(NamedTuple):
    """One message record: header fields, and the bytes that the running hash covers."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes
    length_field: memoryview
    tail: memoryview


class Container:
    """The data section of one MCAP file; `schemas` and `channels` fill while `messages()` runs."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self.path = path
        self.limits = limits
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._topics: set[str] = set()
        self._decompressor = zstandard.ZstdDecompressor()
        self.valid_bytes = 0
        """Up to where the file has been read as complete, valid records."""
        size = path.stat().st_size
        limit("file_bytes", size, limits.file_bytes)
        if size < len(MCAP0_MAGIC):
            raise TruncatedProof("the file is shorter than an MCAP file's first bytes", size=size)

    def messages(self) -> Iterator[RawMessage]:
        """Every message in file order. Raises ContainerError where the file stops being valid.

        A chunk's messages come before its index is looked at, so that all of them are kept of a recording
        that was cut off there.
        """
        with self.path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
            if mapped[: len(MCAP0_MAGIC)] != MCAP0_MAGIC:
                raise CorruptProof("the file does not begin with the MCAP magic bytes", offset=0)
            self.valid_bytes = len(MCAP0_MAGIC)
            self._read_header(mapped)
            self._count_stated_bytes(mapped)
            summary = SummaryOf()
            uncompressed = forgotten = 0
            while True:
                opcode, body, end = self._record(mapped, self.valid_bytes)
                if opcode == Opcode.DATA_END:
                    break
                if opcode != Opcode.CHUNK:
                    # Messages outside chunks, attachments and metadata are read by some tools only.
                    raise CorruptProof(
                        "a record does not belong in a proof", opcode=opcode, offset=self.valid_bytes
                    )
                facts, chunk = self._decompressed(body)
                uncompressed += len(chunk)
                limit("uncompressed_bytes", uncompressed, self.limits.uncompressed_bytes)
                times: MessageTimes = {}
                yield from self._chunk_messages(chunk, times, summary.messages)
                self._check_chunk(mapped, body, end, summary, facts, times)
                limit("chunks", summary.chunks, self.limits.chunks)
                if self.valid_bytes - forgotten > _FORGOTTEN_BYTES:
                    # What was read of a mapped file would stay in memory as long as it is mapped.
                    mapped.madvise(mmap.MADV_DONTNEED)
                    forgotten = self.valid_bytes
            self._check_schemas()
            ending = summary.ending(self.valid_bytes, self.schemas, self.channels)
            self._expect(mapped, ending, "the summary does not follow from the messages")
            if self.valid_bytes != len(mapped):
                raise CorruptProof(
                    "there is data after the file's end",
                    offset=self.valid_bytes,
                    size=len(mapped) - self.valid_bytes,
                )

    def _read_header(self, mapped: mmap.mmap) -> None:
        opcode, body, end = self._record(mapped, self.valid_bytes)
        if opcode != Opcode.HEADER:
            raise CorruptProof("the file does not begin with a header", opcode=opcode)
        limit("declaration_bytes", len(body), self.limits.declaration_bytes)
        header = _parse(Header.read, body)
        if header.profile != "ros2":
            raise CorruptProof("the MCAP profile is not ros2", profile=header.profile[:100])
        self.valid_bytes = end

    def _count_stated_bytes(self, mapped: mmap.mmap) -> None:
        """Before anything is decompressed: what the chunks say that they hold. Each is held to it later."""
        offset, stated = self.valid_bytes, 0
        for _ in range(_MOST_RECORDS):
            if offset + _RECORD.size + _CHUNK.size > len(mapped) or mapped[offset] == Opcode.DATA_END:
                return
            opcode, length = _RECORD.unpack_from(mapped, offset)
            if opcode == Opcode.CHUNK:
                stated += _CHUNK.unpack_from(mapped, offset + _RECORD.size)[2]
                limit("uncompressed_bytes", stated, self.limits.uncompressed_bytes)
            offset += _RECORD.size + length

    def _check_chunk(
        self,
        mapped: mmap.mmap,
        body: bytes,
        end: int,
        summary: SummaryOf,
        facts: ChunkFacts,
        times: MessageTimes,
    ) -> None:
        """A chunk's times and the indexes behind it are those of its messages."""
        if not times:
            raise CorruptProof("a chunk holds no message", offset=self.valid_bytes)
        *span, indexes = summary.add_chunk(facts, times)
        stated = _CHUNK.unpack_from(body)[:2]
        if stated != tuple(span):
            raise CorruptProof(
                "a chunk's times are not those of its messages",
                offset=self.valid_bytes,
                stated=stated,
                found=tuple(span),
            )
        self.valid_bytes = end
        self._expect(mapped, indexes, "a chunk's message index is not that of its messages")

    def _expect(self, mapped: mmap.mmap, expected: bytes, otherwise: str) -> None:
        """The records `expected` stand at `valid_bytes`. Raises CorruptProof with `otherwise`."""
        begin = self.valid_bytes
        found = mapped[begin : begin + len(expected)]
        if found != expected:
            equal = _equal_bytes(found, expected)
            if equal == len(mapped) - begin:
                raise TruncatedProof("the file ends inside its indexes", offset=len(mapped))
            raise CorruptProof(otherwise, offset=begin + equal, record=_record_at(expected, equal))
        self.valid_bytes = begin + len(expected)

    def _record(self, mapped: mmap.mmap, offset: int) -> tuple[int, bytes, int]:
        if offset + _RECORD.size > len(mapped):
            raise TruncatedProof("the file ends where a record should begin", offset=offset)
        opcode, length = _RECORD.unpack_from(mapped, offset)
        end = offset + _RECORD.size + length
        if end > len(mapped):
            raise TruncatedProof("the file ends inside a record", offset=offset, opcode=opcode, length=length)
        limit("chunk_bytes", length, self.limits.chunk_bytes)
        return opcode, mapped[offset + _RECORD.size : end], end

    def _decompressed(self, body: bytes) -> tuple[ChunkFacts, bytes]:
        offset = self.valid_bytes
        try:
            _, _, size, crc, length = _CHUNK.unpack_from(body)
            compression, at = body[_CHUNK.size : _CHUNK.size + length], _CHUNK.size + length
            (packed_size,) = _LENGTH.unpack_from(body, at)
        except struct.error as error:
            raise CorruptProof("a chunk is malformed", offset=offset, cause=str(error)) from error
        packed = body[at + _LENGTH.size :]
        if len(packed) != packed_size:
            raise CorruptProof("a chunk is not as long as stated", offset=offset, stated=packed_size)
        limit("chunk_bytes", size, self.limits.chunk_bytes)
        if compression == b"zstd":
            data = self._decompressed_frame(packed, size)
        elif compression == b"":
            data = packed
        else:
            raise CorruptProof("unknown chunk compression", compression=str(compression[:100]), offset=offset)
        if len(data) != size:
            raise CorruptProof(
                "a chunk's size is not the stated one", found=len(data), stated=size, offset=offset
            )
        if zlib.crc32(data) != crc:
            raise CorruptProof("a chunk's checksum does not match", offset=offset)
        length = _RECORD.size + len(body)
        return ChunkFacts(offset, length, compression.decode(), packed_size, size), data

    def _decompressed_frame(self, packed: bytes, size: int) -> bytes:
        """The content of exactly one zstd frame that states its `size`.

        Tools differ on whether they read a second frame, skip one that is to be skipped, and how large a
        window they grant.
        """
        try:
            # A frame that states its size is decompressed into a buffer of that size, whatever it holds.
            limit("chunk_bytes", zstandard.frame_content_size(packed), self.limits.chunk_bytes)
            frame = zstandard.get_frame_parameters(packed)
            if frame.content_size != size:
                raise CorruptProof(
                    "a chunk's frame is not of the stated size",
                    found=frame.content_size,
                    stated=size,
                    offset=self.valid_bytes,
                )
            if frame.dict_id or frame.window_size > max(size, _ZSTD_WINDOW_BYTES):
                raise CorruptProof(
                    "a chunk's frame cannot be decompressed by every reader",
                    dict_id=frame.dict_id,
                    window_bytes=frame.window_size,
                    offset=self.valid_bytes,
                )
            return self._decompressor.decompress(packed, size, allow_extra_data=False)
        except zstandard.ZstdError as error:
            raise CorruptProof(
                "a chunk does not decompress", offset=self.valid_bytes, cause=str(error)
            ) from error

    def _chunk_messages(self, chunk: bytes, times: MessageTimes, before: int) -> Iterator[RawMessage]:
        """The messages of one chunk after `before` others; `times` fills with what its message indexes should
        say."""
        view = memoryview(chunk)
        left = self.limits.messages - before
        offset, end_of_chunk = 0, len(chunk)
        earliest_ns, latest_ns = self.limits.earliest_ns, self.limits.latest_ns
        while offset < end_of_chunk:
            if chunk[offset] != _MESSAGE_OPCODE or offset + _MESSAGE.size > end_of_chunk:
                offset = self._declaration(chunk, offset)
                continue
            _, length, channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(chunk, offset)
            data, end = offset + _MESSAGE.size, offset + _RECORD.size + length
            if end > end_of_chunk or end < data:
                raise CorruptProof(
                    "a message is not as long as its chunk allows", length=length, offset=self.valid_bytes
                )
            entries = times.get(channel_id)
            if entries is None:
                if channel_id not in self.channels:
                    raise CorruptProof(
                        "a message names a channel that was not declared", channel_id=channel_id
                    )
                entries = times[channel_id] = array("Q")
            left -= 1
            if left < 0:
                limit("messages", self.limits.messages - left, self.limits.messages)
            entries.append(log_ns)
            entries.append(offset)
            if not (earliest_ns <= log_ns <= latest_ns and earliest_ns <= publish_ns <= latest_ns):
                raise ProofTooLarge(
                    "a message's time is out of range", limit="times", log_ns=log_ns, publish_ns=publish_ns
                )
            yield RawMessage(
                channel_id,
                sequence,
                log_ns,
                publish_ns,
                chunk[data:end],
                view[offset + 1 : offset + 9],
                view[offset + 11 : end],
            )
            offset = end

    def _declaration(self, chunk: bytes, offset: int) -> int:
        """Take in the schema or channel at `offset` of a chunk; where it ends. Raises CorruptProof."""
        if offset + _RECORD.size > len(chunk):
            raise CorruptProof("a chunk ends inside a record", offset=self.valid_bytes)
        opcode, length = _RECORD.unpack_from(chunk, offset)
        begin, end = offset + _RECORD.size, offset + _RECORD.size + length
        if end > len(chunk):
            raise CorruptProof("a record is longer than its chunk", length=length, offset=self.valid_bytes)
        limit("declaration_bytes", length, self.limits.declaration_bytes)
        if opcode == Opcode.SCHEMA:
            self._declare_schema(_parse(Schema.read, chunk[begin:end]))
        elif opcode == Opcode.CHANNEL:
            self._declare_channel(_parse(Channel.read, chunk[begin:end]))
        else:
            raise CorruptProof(
                "a record does not belong in a chunk", opcode=opcode, length=length, offset=self.valid_bytes
            )
        return end

    def _declare_schema(self, schema: Schema) -> None:
        if schema.id == 0:
            raise CorruptProof("a schema has the ID 0, which MCAP reserves", name=schema.name[:200])
        if schema.id in self.schemas:
            raise CorruptProof("a schema is declared twice", schema_id=schema.id)
        self.schemas[schema.id] = schema
        limit("channels", len(self.schemas), self.limits.channels)

    def _declare_channel(self, channel: Channel) -> None:
        schema = self.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id != 0:
            raise CorruptProof("a channel names a schema that was not declared", schema_id=channel.schema_id)
        if channel.id in self.channels:
            raise CorruptProof("a channel is declared twice", channel_id=channel.id)
        limit("topic_bytes", len(channel.topic.encode()), self.limits.topic_bytes)
        if channel.topic in self._topics:
            raise CorruptProof("two channels share one topic", topic=channel.topic[:200])
        encoding = schema.encoding if schema else None
        if (channel.message_encoding, encoding) not in _ENCODINGS.items():
            raise CorruptProof(
                "a channel has an encoding that no recording uses",
                topic=channel.topic[:200],
                message_encoding=channel.message_encoding[:100],
                schema_encoding=str(encoding)[:100],
            )
        if channel.metadata:
            # No seal covers it, and rosbags reads quality of service from it.
            raise CorruptProof(
                "a channel has metadata", topic=channel.topic[:200], keys=str(list(channel.metadata))[:200]
            )
        self._topics.add(channel.topic)
        self.channels[channel.id] = channel
        limit("channels", len(self.channels), self.limits.channels)

    def _check_schemas(self) -> None:
        """Every schema is this project's own: a text with two fields exchanged gives bytes another meaning.

        Asked after the last message, so that a text changed after sealing is first a broken seal.
        """
        for schema in self.schemas.values():
            try:
                known = schema_text(schema.name).encode()
            except UnknownType as error:
                raise CorruptProof("a schema is of an unknown type", name=schema.name[:200]) from error
            if (schema.encoding, schema.data) != ("ros2msg", known):
                raise CorruptProof("a schema is not its type's definition", name=schema.name[:200])


def _parse(read: Callable[[ReadDataStream], Record], body: bytes) -> Record:
    """A record of exactly the bytes `body`: no fields behind those known, no key twice."""
    try:
        record = read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError) as error:
        raise CorruptProof("a record is malformed", cause=f"{type(error).__name__}: {error}"[:500]) from error
    builder = RecordBuilder()
    record.write(builder)
    if builder.end()[_RECORD.size :] != body:
        raise CorruptProof("a record holds data after its fields", record=type(record).__name__)
    return record


def _equal_bytes(one: bytes, other: bytes) -> int:
    """How many bytes two strings begin with alike."""
    low, high = 0, min(len(one), len(other))
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if one[low:middle] == other[low:middle] else (low, middle - 1)
    return low


def _record_at(records: bytes, position: int) -> str:
    """Kind of the record of `records` that covers the byte at `position`, for an error."""
    offset = 0
    while offset + _RECORD.size <= len(records):
        opcode, length = _RECORD.unpack_from(records, offset)
        offset += _RECORD.size + length
        if position < offset:
            return Opcode(opcode).name.lower()
    return "end"


def limit(name: str, value: int, allowed: int) -> None:
    """Raises ProofTooLarge."""
    if value > allowed:
        raise ProofTooLarge(f"more {name} than allowed", limit=name, value=value, allowed=allowed)
