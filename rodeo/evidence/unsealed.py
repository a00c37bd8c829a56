"""ROS bags as evidence without a seal: what nobody signed while it was recorded.

ROS 1 `.bag` files and ROS 2 bags (folders, or a single `.mcap` or `.db3` of one) become a `Proof` without
binding and signer. What a recording of ours holds on a JSON channel is in a bag a std_msgs/String on
`/rodeo/event` or `/rodeo/attestation`.
"""

from __future__ import annotations

import os
import struct
from array import array
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import IO

from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC
from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys.store import Typestore

from rodeo.evidence.container import Limits
from rodeo.evidence.errors import CorruptProof, ProofNotFound, ProofTooLarge
from rodeo.evidence.proof import Proof, TopicMessages
from rodeo.ros2.types import STORE
from rodeo.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL, SEAL_CHANNEL

_JSON = {"/" + channel: channel for channel in (EVENT_CHANNEL, ATTESTATION_CHANNEL)}
_STRING = "std_msgs/msg/String"
_FOOTER = struct.Struct("<QQI")
_MOST_SUMMARY_BYTES = 16 * 1024**2
"""Its reader makes an object of every record in it, which takes ten times as much, and its time."""
_Convert = Callable[[bytes], bytes]


def is_bag(path: Path) -> bool:
    """Whether `path` looks like a ROS bag rather than like a recording of ours."""
    return path.is_dir() or path.suffix in (".bag", ".db3")


def is_never_sealed(path: Path) -> bool:
    """Whether an MCAP file that is no proof is a recording by another tool rather than a spoilt proof."""
    try:
        with path.open("rb") as file:
            if _summary_bytes(file) > _MOST_SUMMARY_BYTES:
                return False
            file.seek(0)
            summary = make_reader(file).get_summary()
    except Exception:  # noqa: BLE001 - the reader raises a dozen unrelated types for what is malformed
        return False
    topics = [channel.topic for channel in summary.channels.values()] if summary else []
    return bool(topics) and SEAL_CHANNEL not in topics


def _summary_bytes(file: IO[bytes]) -> int:
    """How much is in an MCAP file behind its data section, by its footer."""
    end = file.seek(-_FOOTER.size - len(MCAP0_MAGIC), os.SEEK_END)
    start, _, _ = _FOOTER.unpack(file.read(_FOOTER.size))
    return end - int(start) if start else 0


def open_bag(path: Path, limits: Limits | None = None) -> Proof:
    """All messages of a ROS 1 or ROS 2 bag. Raises ProofNotFound, CorruptProof or ProofTooLarge."""
    limits = limits or Limits()
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    if not all(file.exists() for file in files) or not files:
        raise ProofNotFound("there is no bag", path=str(path))
    size = sum(file.stat().st_size for file in files)
    if size > limits.file_bytes:
        raise ProofTooLarge("the bag is too large", limit="file_bytes", value=size, allowed=limits.file_bytes)
    try:
        topics, order = _read(path, limits)
    except (AnyReaderError, OSError, ValueError, KeyError, AssertionError) as error:
        raise CorruptProof("the bag cannot be read", path=str(path), cause=str(error)[:500]) from error
    digest = sha256()
    for file in files:
        digest.update(file.read_bytes())
    return Proof(path, "0x" + digest.hexdigest(), size, None, None, 0, 0, (), topics, order)


def _read(path: Path, limits: Limits) -> tuple[dict[str, TopicMessages], array[int]]:
    ours = STORE
    topics: dict[str, TopicMessages] = {}
    indices: dict[str, int] = {}
    order = array("H")
    converters: dict[str, _Convert] = {}
    total = 0
    with AnyReader([path], default_typestore=ours) as reader:
        for connection, time_ns, raw in reader.messages():
            topic, ros_type = connection.topic, connection.msgtype
            if ros_type not in ours.fielddefs:
                continue  # nothing that a check would ask for
            total += len(raw)
            if total > limits.uncompressed_bytes or len(order) >= limits.messages:
                raise ProofTooLarge("the bag holds too much", limit="messages", value=len(order))
            if ros_type not in converters:
                converters[ros_type] = _converter(reader, ours, ros_type)
            cdr = converters[ros_type](raw)
            json = topic in _JSON and ros_type == _STRING
            name = _JSON[topic] if json else topic
            if name not in topics:
                if len(topics) >= limits.channels:
                    raise ProofTooLarge("the bag has too many topics", limit="channels", value=len(topics))
                indices[name] = len(topics)
                topics[name] = TopicMessages(name, "" if json else ros_type)
            column = topics[name]
            column.log_ns.append(time_ns)
            column.publish_ns.append(time_ns)
            column.sequence.append(len(column) & 0xFFFFFFFF)
            text = ours.deserialize_cdr(cdr, _STRING).data.encode() if json else cdr  # type: ignore[attr-defined]
            column.data.append(text)
            order.append(indices[name])
    if not order:
        raise CorruptProof("the bag holds no message of a known type", path=str(path))
    return topics, order


def _converter(reader: AnyReader, ours: Typestore, ros_type: str) -> _Convert:
    """From the bag's form of a type to the CDR of ours."""
    if not is_same_wireformat(reader.typestore, ours, ros_type, ros_type):
        cache: dict[str, object] = {}
        return lambda raw: bytes(
            migrate_bytes(
                reader.typestore, ours, ros_type, ros_type, cache, raw, src_is2=reader.is2, dst_is2=True
            )
        )
    if reader.is2:
        return bytes
    return lambda raw: bytes(ours.ros1_to_cdr(raw, ros_type))
