"""Strict reading of MCAP files from strangers: every record in file order, nothing allocated on their word.

The `mcap` package's readers trust sizes that the file states (a chunk's, a zstd frame's) and report
malformed records through a dozen exception types; here each is checked against `Limits` first and reported
as one of `ContainerError`. Record layouts: https://mcap.dev/spec.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Header, McapRecord, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from rodeo.evidence.errors import CorruptProof, ProofTooLarge, TruncatedProof

Record = TypeVar("Record", bound=McapRecord)

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQII")
"""Earliest and latest time, size and checksum of what is packed, length of the compression's name."""
_LENGTH = struct.Struct("<Q")
_ALLOWED_IN_DATA = {Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.DATA_END}
"""Messages outside chunks, attachments and metadata would be read by some tools and not by others."""


@dataclass(frozen=True)
class Limits:
    """What a proof may cost its reader. The defaults admit a day of 50 Hz recording."""

    file_bytes: int = 512 * 1024**2
    uncompressed_bytes: int = 1024**3
    chunk_bytes: int = 64 * 1024**2
    messages: int = 5_000_000
    channels: int = 256
    schema_bytes: int = 1024**2
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
        self._decompressor = zstandard.ZstdDecompressor()
        self.valid_bytes = 0
        """Up to where the file has been read as complete, valid records."""
        size = path.stat().st_size
        _limit("file_bytes", size, limits.file_bytes)
        if size < len(MCAP0_MAGIC):
            raise TruncatedProof("the file is shorter than an MCAP file's first bytes", size=size)

    def messages(self) -> Iterator[RawMessage]:
        """Every message in file order. Raises ContainerError where the file stops being valid."""
        with self.path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
            if mapped[: len(MCAP0_MAGIC)] != MCAP0_MAGIC:
                raise CorruptProof("the file does not begin as an MCAP file", offset=0)
            self.valid_bytes = len(MCAP0_MAGIC)
            count, uncompressed = 0, 0
            for opcode, body in self._data_section(mapped):
                if opcode == Opcode.HEADER:
                    header = _parse(Header.read, body)
                    if header.profile != "ros2":
                        raise CorruptProof("the MCAP profile is not ros2", profile=header.profile[:100])
                elif opcode == Opcode.CHUNK:
                    chunk = self._decompressed(body)
                    uncompressed += len(chunk)
                    _limit("uncompressed_bytes", uncompressed, self.limits.uncompressed_bytes)
                    for message in self._chunk_messages(chunk):
                        count += 1
                        if count > self.limits.messages:
                            _limit("messages", count, self.limits.messages)
                        yield message
            self._check_end(mapped, count)

    def _data_section(self, mapped: mmap.mmap) -> Iterator[tuple[int, bytes]]:
        while True:
            opcode, body, end = self._record(mapped, self.valid_bytes)
            if opcode not in _ALLOWED_IN_DATA:
                raise CorruptProof(
                    "a record does not belong in a proof", opcode=opcode, offset=self.valid_bytes
                )
            yield opcode, body
            self.valid_bytes = end
            if opcode == Opcode.DATA_END:
                return

    def _record(self, mapped: mmap.mmap, offset: int) -> tuple[int, bytes, int]:
        if offset + _RECORD.size > len(mapped):
            raise TruncatedProof("the file ends where a record should begin", offset=offset)
        opcode, length = _RECORD.unpack_from(mapped, offset)
        end = offset + _RECORD.size + length
        if end > len(mapped):
            raise TruncatedProof("the file ends inside a record", offset=offset, opcode=opcode, length=length)
        _limit("chunk_bytes", length, self.limits.chunk_bytes)
        return opcode, mapped[offset + _RECORD.size : end], end

    def _decompressed(self, body: bytes) -> bytes:
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
        _limit("chunk_bytes", size, self.limits.chunk_bytes)
        if compression == b"zstd":
            try:
                # A frame that states its size is decompressed into a buffer of that size, whatever it holds.
                _limit("chunk_bytes", zstandard.frame_content_size(packed), self.limits.chunk_bytes)
                data = self._decompressor.decompress(packed, size)
            except zstandard.ZstdError as error:
                raise CorruptProof("a chunk does not decompress", offset=offset, cause=str(error)) from error
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
        return data

    def _chunk_messages(self, chunk: bytes) -> Iterator[RawMessage]:
        view = memoryview(chunk)
        offset, end_of_chunk = 0, len(chunk)
        earliest_ns, latest_ns = self.limits.earliest_ns, self.limits.latest_ns
        while offset < end_of_chunk:
            if offset + _RECORD.size > end_of_chunk:
                raise CorruptProof("a chunk ends inside a record", offset=self.valid_bytes)
            opcode, length = _RECORD.unpack_from(chunk, offset)
            end = offset + _RECORD.size + length
            if end > end_of_chunk:
                raise CorruptProof(
                    "a record is longer than its chunk", length=length, offset=self.valid_bytes
                )
            if opcode == Opcode.MESSAGE:
                if end < offset + _MESSAGE.size:
                    raise CorruptProof(
                        "a message record is too short", length=length, offset=self.valid_bytes
                    )
                _, _, channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(chunk, offset)
                if channel_id not in self.channels:
                    raise CorruptProof(
                        "a message names a channel that was not declared", channel_id=channel_id
                    )
                if not (earliest_ns <= log_ns <= latest_ns and earliest_ns <= publish_ns <= latest_ns):
                    raise ProofTooLarge(
                        "a message's time is absurd", limit="times", log_ns=log_ns, publish_ns=publish_ns
                    )
                yield RawMessage(
                    channel_id,
                    sequence,
                    log_ns,
                    publish_ns,
                    chunk[offset + _MESSAGE.size : end],
                    view[offset + 1 : offset + 9],
                    view[offset + 11 : end],
                )
            elif opcode == Opcode.SCHEMA:
                self._declare_schema(_parse(Schema.read, chunk[offset + _RECORD.size : end]))
            elif opcode == Opcode.CHANNEL:
                self._declare_channel(_parse(Channel.read, chunk[offset + _RECORD.size : end]))
            else:
                raise CorruptProof(
                    "a record does not belong in a chunk", opcode=opcode, offset=self.valid_bytes
                )
            offset = end

    def _declare_schema(self, schema: Schema) -> None:
        _limit("schema_bytes", len(schema.data), self.limits.schema_bytes)
        if self.schemas.setdefault(schema.id, schema) != schema:
            raise CorruptProof("a schema is declared twice, differently", schema_id=schema.id)
        _limit("channels", len(self.schemas), self.limits.channels)

    def _declare_channel(self, channel: Channel) -> None:
        if channel.schema_id != 0 and channel.schema_id not in self.schemas:
            raise CorruptProof("a channel names a schema that was not declared", schema_id=channel.schema_id)
        if self.channels.setdefault(channel.id, channel) != channel:
            raise CorruptProof("a channel is declared twice, differently", channel_id=channel.id)
        if any(other.topic == channel.topic and other.id != channel.id for other in self.channels.values()):
            raise CorruptProof("two channels share one topic", topic=channel.topic[:200])
        _limit("channels", len(self.channels), self.limits.channels)

    def _check_end(self, mapped: mmap.mmap, count: int) -> None:
        """Summary and footer: complete, and in agreement with the data that was read."""
        offset = self.valid_bytes
        while True:
            opcode, body, offset = self._record(mapped, offset)
            if opcode == Opcode.STATISTICS:
                stated = _parse(Statistics.read, body).message_count
                if stated != count:
                    raise CorruptProof(
                        "the summary states another number of messages", stated=stated, found=count
                    )
            if opcode == Opcode.FOOTER:
                _parse(Footer.read, body)
                break
        if mapped[offset:] != MCAP0_MAGIC:
            raise TruncatedProof("the file does not end as an MCAP file", offset=offset)
        self.valid_bytes = len(mapped)


def _parse(read: Callable[[ReadDataStream], Record], body: bytes) -> Record:
    try:
        return read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError) as error:
        raise CorruptProof("a record is malformed", cause=f"{type(error).__name__}: {error}"[:500]) from error


def _limit(name: str, value: int, limit: int) -> None:
    if value > limit:
        raise ProofTooLarge(f"more {name} than allowed", limit=name, value=value, allowed=limit)
