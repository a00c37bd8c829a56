"""ROS bags as evidence without a seal: what nobody signed while it was recorded.

ROS 1 `.bag` files and ROS 2 bags (folders, or a single `.mcap` or `.db3` of one) become a `Proof` without
binding and signer. What a recording of ours holds on a JSON channel is in a bag a std_msgs/String on
`/rodeo/event` or `/rodeo/attestation`.

MCAP files are read in file order, without their indexes and summary, which writers leave out at will. What is
no message of a type that a check asks for is passed over, whatever it is. Other bags are read by rosbags.
Foreign libraries raise what they like: all of it leaves here as one EvidenceError.
"""

from __future__ import annotations

import re
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.writer import MCAP0_MAGIC
from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rodeo.evidence.container import Limits
from rodeo.evidence.errors import CorruptProof, EvidenceError, ProofNotFound, ProofTooLarge, TruncatedProof
from rodeo.evidence.proof import Proof, TopicMessages
from rodeo.ros2.types import STORE
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL, SEAL_CHANNEL

_JSON = {"/" + channel: channel for channel in (EVENT_CHANNEL, ATTESTATION_CHANNEL)}
_STRING = "std_msgs/msg/String"
_RECORD = struct.Struct("<BQ")
_READ: dict[int, Callable[[ReadDataStream, int], McapRecord]] = {
    Opcode.SCHEMA: lambda stream, _length: Schema.read(stream),
    Opcode.CHANNEL: lambda stream, _length: Channel.read(stream),
    Opcode.MESSAGE: Message.read,
    Opcode.CHUNK: lambda stream, _length: Chunk.read(stream),
}
"""Records that are looked at; the others are passed over."""
_DIGITS = re.compile(r"(\d+)")
_Convert = Callable[[bytes], bytes]


class _Said(NamedTuple):
    """One message of a type that is known here."""

    time_ns: int
    topic: str
    ros_type: str
    cdr: bytes


def is_bag(path: Path) -> bool:
    """Whether `path` looks like a ROS bag rather than like a recording of ours."""
    return path.is_dir() or path.suffix in (".bag", ".db3")


def is_never_sealed(path: Path) -> bool:
    """Whether an MCAP file that is no proof is a recording by another tool rather than a spoilt proof, whose
    first message is a seal."""
    channels: dict[int, str] = {}
    try:
        with _foreign(path):
            for record in _records(path, Limits()):
                if isinstance(record, Channel):
                    channels[record.id] = record.topic
                if isinstance(record, Message):
                    break
    except EvidenceError:
        return False
    return bool(channels) and SEAL_CHANNEL not in channels.values()


def open_bag(path: Path, limits: Limits | None = None) -> Proof:
    """All messages of a ROS 1 or ROS 2 bag. Raises ProofNotFound, CorruptProof, TruncatedProof or
    ProofTooLarge."""
    limits = limits or Limits()
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    if not all(file.exists() for file in files) or not files:
        raise ProofNotFound("there is no bag", path=str(path))
    size = sum(file.stat().st_size for file in files)
    if size > limits.file_bytes:
        raise ProofTooLarge("the bag is too large", limit="file_bytes", value=size, allowed=limits.file_bytes)
    with _foreign(path):
        topics, order = _read(path, files, limits)
    digest = sha256()
    for file in files:
        digest.update(file.read_bytes())
    return Proof(path, "0x" + digest.hexdigest(), size, None, None, 0, 0, (), topics, order)


@contextmanager
def _foreign(path: Path) -> Iterator[None]:
    """Whatever a library raises for a file becomes CorruptProof."""
    try:
        yield
    except EvidenceError:
        raise
    except Exception as error:
        cause = f"{type(error).__name__}: {error}"[:500]
        raise CorruptProof("the bag cannot be read", path=str(path), cause=cause) from error


def _read(path: Path, files: list[Path], limits: Limits) -> tuple[dict[str, TopicMessages], array[int]]:
    topics: dict[str, TopicMessages] = {}
    indices: dict[str, int] = {}
    order = array("H")
    for said in _messages(path, files, limits):
        json = said.topic in _JSON and said.ros_type == _STRING
        name = _JSON[said.topic] if json else said.topic
        if name not in topics:
            if len(topics) >= limits.channels:
                raise ProofTooLarge("the bag has too many topics", limit="channels", value=len(topics))
            indices[name] = len(topics)
            topics[name] = TopicMessages(name, "" if json else said.ros_type)
        column = topics[name]
        column.log_ns.append(said.time_ns)
        column.publish_ns.append(said.time_ns)
        column.sequence.append(len(column) & 0xFFFFFFFF)
        text = STORE.deserialize_cdr(said.cdr, _STRING).data.encode() if json else said.cdr  # type: ignore[attr-defined]
        column.data.append(text)
        order.append(indices[name])
    if not order:
        raise CorruptProof("the bag holds no message of a known type", path=str(path))
    return topics, order


def _messages(path: Path, files: list[Path], limits: Limits) -> Iterator[_Said]:
    """Those of known types in the order of their times, as many as `limits` let in."""
    by_number = sorted(files, key=lambda file: [int(one) if one.isdecimal() else one for one in
                                                _DIGITS.split(str(file))])  # fmt: skip
    mcaps = [file for file in by_number if file.suffix == ".mcap"]
    found: list[_Said] = []
    total = 0
    for said in (one for file in mcaps for one in _of_mcap(file, limits)) if mcaps else _of_bag(path, files):
        total += len(said.cdr)
        if total > limits.uncompressed_bytes or len(found) >= limits.messages:
            raise ProofTooLarge("the bag holds too much", limit="messages", value=len(found))
        found.append(said)
    found.sort(key=lambda one: one.time_ns)
    return iter(found)


# -- by rosbags ------------------------------------------------------------------------------------------


def _of_bag(path: Path, files: list[Path]) -> Iterator[_Said]:
    databases = [file for file in files if file.suffix == ".db3"]
    # Without metadata, as a crash leaves it, rosbags reads a database alone.
    alone = path.is_dir() and not (path / "metadata.yaml").exists()
    for one in databases if alone else [path]:
        with AnyReader([one], default_typestore=STORE) as reader:
            converters: dict[str, _Convert] = {}
            for connection, time_ns, raw in reader.messages():
                kind = connection.msgtype
                if kind not in STORE.fielddefs:
                    continue  # nothing that a check would ask for
                if kind not in converters:
                    converters[kind] = _converter(reader.typestore, kind, reader.is2)
                yield _Said(time_ns, connection.topic, kind, converters[kind](raw))


# -- by the records of an MCAP file ----------------------------------------------------------------------


def _of_mcap(path: Path, limits: Limits) -> Iterator[_Said]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, str, _Convert] | None] = {}
    for record in _records(path, limits):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.id not in channels:
                channels[record.id] = _channel(record, schemas.get(record.schema_id))
        elif isinstance(record, Message) and (channel := channels.get(record.channel_id)) is not None:
            topic, kind, convert = channel
            yield _Said(record.log_time, topic, kind, convert(record.data))


def _channel(channel: Channel, schema: Schema | None) -> tuple[str, str, _Convert] | None:
    """Topic, type and way to the CDR of ours; None for what no check would ask for."""
    if schema is None or channel.message_encoding not in ("cdr", "ros1"):
        return None
    package, _, name = schema.name.replace("/msg/", "/").partition("/")
    kind = f"{package}/msg/{name}"
    if kind not in STORE.fielddefs:
        return None
    theirs = get_typestore(Stores.EMPTY)
    parse = get_types_from_idl if "idl" in schema.encoding else partial(get_types_from_msg, name=kind)
    with suppress(Exception):  # the parser raises what it likes for a text that is none
        theirs.register(parse(schema.data.decode()))
    # A text that is missing, or of something else: it is what the name says.
    is_told = bool(schema.data.strip()) and kind in theirs.fielddefs
    theirs = theirs if is_told else STORE
    return channel.topic, kind, _converter(theirs, kind, channel.message_encoding == "cdr")


def _records(path: Path, limits: Limits) -> Iterator[McapRecord]:
    """Schemas, channels and messages, those in chunks included, up to the end of the data section."""
    left = iter(range(limits.messages))
    with path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise CorruptProof("the bag cannot be read: it does not begin as an MCAP file", path=str(path))
        uncompressed = 0
        for record in _stream(file, path, limits, left):
            if not isinstance(record, Chunk):
                yield record
                continue
            uncompressed += record.uncompressed_size
            if uncompressed > limits.uncompressed_bytes:
                raise ProofTooLarge("the bag holds too much", limit="uncompressed_bytes", value=uncompressed)
            yield from _stream(BytesIO(_unpacked(record)), path, limits, left, in_chunk=True)


def _stream(
    file: IO[bytes], path: Path, limits: Limits, left: Iterator[int], in_chunk: bool = False
) -> Iterator[McapRecord]:
    """`left` has an element for each record that may still come, also for those that are passed over."""
    while head := file.read(_RECORD.size):
        if next(left, None) is None:
            raise ProofTooLarge("the bag has too many records", limit="messages", value=limits.messages)
        if len(head) < _RECORD.size:
            break
        opcode, length = _RECORD.unpack(head)
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        if opcode not in _READ:
            file.seek(length, 1)
            continue
        if length > limits.uncompressed_bytes:
            raise ProofTooLarge("a record is too long", limit="uncompressed_bytes", value=length)
        body = file.read(length)
        if len(body) < length:
            break
        yield _READ[opcode](ReadDataStream(BytesIO(body)), length)
    else:
        if in_chunk:
            return
    raise TruncatedProof(
        "the bag ends within its data, as after a crash: `mcap recover` makes a whole one of it",
        path=str(path),
    )


def _unpacked(chunk: Chunk) -> bytes:
    """No more than the chunk says that it holds. Raises CorruptProof."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        stream: Any = zstandard.ZstdDecompressor().stream_reader(BytesIO(chunk.data), read_across_frames=True)
    elif chunk.compression == "lz4":
        stream = lz4.frame.open(BytesIO(chunk.data))
    elif not chunk.compression:
        stream = BytesIO(chunk.data)
    else:
        raise CorruptProof("the bag cannot be read: unknown compression", compression=chunk.compression[:100])
    data = bytes(stream.read(size + 1))
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise CorruptProof("the bag cannot be read: a chunk is not what its checksum says", bytes=len(data))
    return data


def _converter(theirs: Typestore, ros_type: str, is2: bool) -> _Convert:
    """From the bag's form of a type to the CDR of ours. A message that is none of its type stays as it is:
    whoever reads its topic refuses it, and nothing else is lost for that."""
    cache: dict[str, object] = {}
    is_same = theirs is STORE or is_same_wireformat(theirs, STORE, ros_type, ros_type)
    if is_same and is2:
        return bytes

    def convert(raw: bytes) -> bytes:
        with suppress(Exception):
            if is_same:
                return bytes(STORE.ros1_to_cdr(raw, ros_type))
            return bytes(
                migrate_bytes(theirs, STORE, ros_type, ros_type, cache, raw, src_is2=is2, dst_is2=True)
            )
        return bytes(raw)

    return convert
