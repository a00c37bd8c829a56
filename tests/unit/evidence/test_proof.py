"""What a proof must not survive."""

from __future__ import annotations

import io
import json
import random
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from eth_account import Account
from eth_account.signers.local import LocalAccount
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer

from rodeo.evidence.container import Container, Limits
from rodeo.evidence.errors import (
    BrokenSeal,
    ContainerError,
    CorruptProof,
    EvidenceError,
    LayoutChanged,
    ProofNotFound,
    ProofTooLarge,
    SealError,
    TruncatedProof,
    UnsealedProof,
)
from rodeo.evidence.proof import TopicMessages, open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.ros2.types import new, serialize
from tests.unit.evidence.conftest import START_NS, HandClock, drive, odometry

Record = tuple[Schema | None, Channel, Message]


def records(path: Path) -> list[Record]:
    """Every message of a file, in file order."""
    with path.open("rb") as file:
        return list(make_reader(file).iter_messages(log_time_order=False))


def rewrite(path: Path, messages: Iterable[Record]) -> Path:
    """A valid MCAP file with these messages, as anybody can write one."""
    target = path.with_name("forged.mcap")
    with target.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="forger")
        channels: dict[str, int] = {}
        for schema, channel, message in messages:
            if channel.topic not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            writer.add_message(
                channels[channel.topic],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()
    return target


def changed(message: Record, **fields: object) -> Record:
    return message[0], message[1], replace(message[2], **fields)


def test_rewriting_without_change_keeps_the_seal(recorded: Callable[..., Path]) -> None:
    path = recorded()
    assert open_proof(rewrite(path, records(path))).messages == open_proof(path).messages


def edit_a_byte(messages: list[Record]) -> None:
    data = bytearray(messages[40][2].data)
    data[-1] ^= 1
    messages[40] = changed(messages[40], data=bytes(data))


def shift_a_log_time(messages: list[Record]) -> None:
    messages[40] = changed(messages[40], log_time=messages[40][2].log_time + 1)


def shift_a_publish_time(messages: list[Record]) -> None:
    messages[40] = changed(messages[40], publish_time=messages[40][2].publish_time + 1)


def renumber(messages: list[Record]) -> None:
    messages[40] = changed(messages[40], sequence=7777)


def drop_one(messages: list[Record]) -> None:
    del messages[40]


def add_one(messages: list[Record]) -> None:
    messages.insert(40, messages[41])


def swap_two(messages: list[Record]) -> None:
    messages[40], messages[42] = messages[42], messages[40]


def rename_a_topic(messages: list[Record]) -> None:
    messages[:] = [
        (s, replace(c, topic="/panther2/odom") if c.topic == "/panther1/odom" else c, m)
        for s, c, m in messages
    ]


def change_a_schema(messages: list[Record]) -> None:
    messages[:] = [
        (s and replace(s, data=s.data.replace(b"float64 x", b"float64 y")), c, m) for s, c, m in messages
    ]


def drop_a_seal(messages: list[Record]) -> None:
    seals = [i for i, (_, c, _) in enumerate(messages) if c.topic == "rodeo/seal"]
    del messages[seals[2]]


def drop_everything_between_two_seals(messages: list[Record]) -> None:
    seals = [i for i, (_, c, _) in enumerate(messages) if c.topic == "rodeo/seal"]
    del messages[seals[1] + 1 : seals[2] + 1]


def append_after_the_final_seal(messages: list[Record]) -> None:
    messages.append(messages[40])


@pytest.mark.parametrize(
    "forge",
    [
        edit_a_byte,
        shift_a_log_time,
        shift_a_publish_time,
        renumber,
        drop_one,
        add_one,
        swap_two,
        rename_a_topic,
        change_a_schema,
        drop_a_seal,
        drop_everything_between_two_seals,
        append_after_the_final_seal,
    ],
)
def test_every_change_breaks_the_seal(
    recorded: Callable[..., Path], forge: Callable[[list[Record]], None]
) -> None:
    path = recorded()
    messages = records(path)
    forge(messages)
    with pytest.raises(BrokenSeal):
        open_proof(rewrite(path, messages))


def test_halves_of_two_recordings_do_not_join(recorded: Callable[..., Path]) -> None:
    first, second = records(recorded()), records(recorded(name="other.mcap", first=1))
    middle = len(first) // 2
    path = recorded(name="third.mcap")
    with pytest.raises(BrokenSeal):
        open_proof(rewrite(path, first[:middle] + second[middle:]))


def test_a_recording_without_its_end_is_not_sealed(recorded: Callable[..., Path]) -> None:
    path = recorded()
    with pytest.raises(UnsealedProof):
        open_proof(rewrite(path, records(path)[:-1]))


def test_a_recording_without_its_beginning_is_not_sealed(recorded: Callable[..., Path]) -> None:
    path = recorded()
    with pytest.raises(SealError):
        open_proof(rewrite(path, records(path)[1:]))


def test_seals_of_two_keys_do_not_mix(
    tmp_path: Path, recorded: Callable[..., Path], binding: Binding, clock: HandClock
) -> None:
    other = Recorder(tmp_path / "other.mcap", binding, Account.create(), clock)
    drive(other, 0, 200)
    theirs = records(other.close().path)
    path = recorded()
    ours = records(path)
    with pytest.raises(BrokenSeal):
        open_proof(rewrite(path, [*ours[:-1], theirs[-1]]))


def test_a_final_seal_with_another_signature_is_refused(recorded: Callable[..., Path]) -> None:
    path = recorded()
    messages = records(path)
    seal = json.loads(messages[-1][2].data)
    for signature in ("0x" + "11" * 65, seal["signature"][:-2], "", None):
        forged = changed(messages[-1], data=json.dumps(seal | {"signature": signature}).encode())
        with pytest.raises(BrokenSeal):
            open_proof(rewrite(path, [*messages[:-1], forged]))


def test_the_binding_and_signer_are_those_of_the_seal(
    recorded: Callable[..., Path], binding: Binding, device: LocalAccount
) -> None:
    proof = open_proof(recorded(task_id=9))
    assert proof.binding == binding.model_copy(update={"task_id": 9})
    assert proof.signer == device.address


@pytest.mark.parametrize("size", [0, 4, 8, 20, 100, 1000])
def test_a_truncated_file_says_so(recorded: Callable[..., Path], size: int) -> None:
    path = recorded()
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(TruncatedProof):
        open_proof(path)


def test_a_file_without_its_last_byte_is_truncated(recorded: Callable[..., Path]) -> None:
    path = recorded()
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(TruncatedProof):
        open_proof(path)


def test_garbage_is_refused_with_a_typed_error(tmp_path: Path) -> None:
    path = tmp_path / "garbage.mcap"
    path.write_bytes(random.Random(1).randbytes(5000))
    with pytest.raises(CorruptProof):
        open_proof(path)


def test_flipped_bytes_never_escape_as_another_exception(recorded: Callable[..., Path]) -> None:
    path = recorded(60)
    data = path.read_bytes()
    chance = random.Random(2)
    library = data.index(b"rodeo")  # whoever wrote the file: free text
    for _ in range(300):
        broken = bytearray(data)
        for _ in range(chance.choice((1, 8))):
            broken[chance.randrange(library + 5, len(broken))] ^= chance.randrange(1, 256)
        path.write_bytes(bytes(broken))
        with pytest.raises(EvidenceError):
            open_proof(path)


def test_a_missing_file_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(ProofNotFound):
        open_proof(tmp_path / "nothing.mcap")


def chunk(uncompressed: int, data: bytes, compression: bytes = b"zstd", crc: int = 0) -> bytes:
    body = struct.pack("<QQQII", START_NS, START_NS, uncompressed, crc, len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    return b"\x06" + struct.pack("<Q", len(body)) + body


def container(*parts: bytes) -> bytes:
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=CompressionType.NONE)
    writer.start(profile="ros2", library="forger")
    return buffer.getvalue() + b"".join(parts)


def test_a_bomb_that_states_its_size_is_not_decompressed(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(100 * 1024**2))
    assert len(bomb) < 20_000
    path = tmp_path / "bomb.mcap"
    path.write_bytes(container(chunk(100 * 1024**2, bomb)))
    with pytest.raises(ProofTooLarge) as caught:
        open_proof(path)
    assert caught.value.details["limit"] == "chunk_bytes"


def test_a_bomb_that_lies_about_its_size_is_not_decompressed(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(100 * 1024**2))
    path = tmp_path / "bomb.mcap"
    path.write_bytes(container(chunk(1000, bomb)))
    with pytest.raises(ProofTooLarge):
        open_proof(path)
    silent = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(100 * 1024**2))
    path.write_bytes(container(chunk(1000, silent)))
    with pytest.raises(CorruptProof):
        open_proof(path)


def test_many_small_chunks_count_together(tmp_path: Path) -> None:
    data = bytes(1024**2)
    part = chunk(len(data), zstandard.compress(data), crc=zlib.crc32(data))
    path = tmp_path / "many.mcap"
    path.write_bytes(container(*[part] * 100))
    with pytest.raises(ContainerError):
        list(Container(path, Limits(uncompressed_bytes=10 * 1024**2)).messages())


def test_what_chunks_state_is_counted_before_any_is_decompressed(
    recorded: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(Container, "_decompressed")
    with pytest.raises(ProofTooLarge) as caught:
        open_proof(recorded(), Limits(uncompressed_bytes=50_000))
    assert caught.value.details["limit"] == "uncompressed_bytes"


def test_no_more_messages_than_allowed_are_read_of_one_chunk(recorded: Callable[..., Path]) -> None:
    read = []
    with pytest.raises(ProofTooLarge):
        for message in Container(recorded(), Limits(messages=3)).messages():
            read.append(message)
    assert len(read) == 3


@pytest.mark.parametrize(("odd", "times"), [("length", 1.5), ("name", 0.5)])
def test_a_table_takes_the_memory_of_its_messages_at_most_once_more(odd: str, times: float) -> None:
    """However few messages are odd, and however often some are left out of it."""
    names = [f"joint{number}" for number in range(200)]
    plain, other = (
        serialize(new("sensor_msgs/msg/JointState", name=[first, *names[1:]], position=np.zeros(200)))
        for first in ("joint0", "other0")
    )
    column = TopicMessages("/joint_states", "sensor_msgs/msg/JointState")
    for number in range(16_000):
        strange = other if odd == "name" else plain + bytes(4)
        column.data.append(strange if number in (7, 2_000, 15_990) else plain)
        column.log_ns.append(number)
    tracemalloc.start()
    try:
        table = column.table()
        left = table.only(np.arange(len(table)) != 5).only(np.arange(len(table) - 1) != 5)
        assert left.named("position", ["joint3", "joint199"]).shape == (15_995, 2)
        assert tracemalloc.get_traced_memory()[1] < times * column.data.size_bytes
    finally:
        tracemalloc.stop()


def test_a_json_message_is_not_larger_than_it_may_be(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    """What is recorded honestly and is larger is left out, with a note."""
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    recorder.write_json("rodeo/event", {"name": "TaskRegistered", "params": "x" * Limits().json_bytes})
    path = recorder.close().path
    (note,) = (one for one in open_proof(path).events() if one["event"] == "unreadable")
    assert note["name"] == "TaskRegistered"
    with pytest.raises(ProofTooLarge) as caught:
        open_proof(path, Limits(json_bytes=100))
    assert caught.value.details["limit"] == "json_bytes"


@pytest.mark.parametrize(
    ("limits", "limit"),
    [
        (Limits(messages=100), "messages"),
        (Limits(chunks=2), "chunks"),
        (Limits(file_bytes=1000), "file_bytes"),
        (Limits(channels=2), "channels"),
        (Limits(declaration_bytes=100), "declaration_bytes"),
        (Limits(latest_ns=START_NS), "times"),
        (Limits(uncompressed_bytes=50_000), "uncompressed_bytes"),
        (Limits(seals=2), "seals"),
        (Limits(seal_bytes=500), "seal_bytes"),
        (Limits(topic_bytes=12), "topic_bytes"),
    ],
)
def test_each_limit_is_named_when_exceeded(recorded: Callable[..., Path], limits: Limits, limit: str) -> None:
    with pytest.raises(ProofTooLarge) as caught:
        open_proof(recorded(), limits)
    assert caught.value.details["limit"] == limit


def test_a_table_has_a_column_per_number(recorded: Callable[..., Path]) -> None:
    table = open_proof(recorded(30)).table("/panther1/odom", "nav_msgs/msg/Odometry")
    assert table["pose.pose.position.x"] == pytest.approx([0.01 * index for index in range(30)])
    assert table.stamp_s[1] - table.stamp_s[0] == pytest.approx(0.02)
    assert table.strings["header.frame_id"] == "odom"
    joints = open_proof(recorded(30, "b.mcap")).table("/panther1/joint_states", "sensor_msgs/msg/JointState")
    assert joints.named("position", ["shoulder", "waist"])[3] == pytest.approx([0.6, 0.3])


@pytest.mark.parametrize(
    ("topic", "ros_type"),
    [("/no/such", "nav_msgs/msg/Odometry"), ("/panther1/odom", "sensor_msgs/msg/JointState")],
)
def test_a_table_of_a_missing_topic_or_another_type_is_refused(
    recorded: Callable[..., Path], topic: str, ros_type: str
) -> None:
    with pytest.raises(LayoutChanged):
        open_proof(recorded(5)).table(topic, ros_type)


@pytest.mark.parametrize("strange", [odometry(3, "map_"), odometry(3, "maps"), odometry(3)[:100], b""])
def test_a_message_that_does_not_fit_the_others_is_named(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock, strange: bytes
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    drive(recorder, 0, 3)
    recorder.write_ros("panther1/odom", "nav_msgs/msg/Odometry", strange, START_NS, START_NS)
    proof = open_proof(recorder.close().path)
    with pytest.raises(LayoutChanged) as caught:
        proof.table("/panther1/odom", "nav_msgs/msg/Odometry")
    assert caught.value.details["index"] == 3


def test_a_message_may_be_padded_to_a_multiple_of_four(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    text = serialize(new("std_msgs/msg/String", data="name"))
    padding = bytes(-len(text) % 4)
    assert padding
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    recorder.write_ros("name", "std_msgs/msg/String", text + padding, START_NS, START_NS)
    table = open_proof(recorder.close().path).table("/name", "std_msgs/msg/String")
    assert table.strings["data"] == "name"


@pytest.mark.parametrize(
    ("cdr", "reason"),
    [
        (serialize(new("std_msgs/msg/String", data="name")) + b"\0\0\0more", "longer than its type"),
        (serialize(new("std_msgs/msg/String", data="name")) + b"mor", "longer than its type"),
        (b"\0\1\0\0\4\0\0\0name", "does not end with a zero"),
        (b"\0\1\0\0\0\0\0\0", "does not end with a zero"),
        (b"\0\1\0\0\3\0\0\0\xff\xfe\0", "not UTF-8"),
    ],
)
def test_a_message_that_others_read_otherwise_is_refused(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock, cdr: bytes, reason: str
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    recorder.write_ros("name", "std_msgs/msg/String", cdr, START_NS, START_NS)
    proof = open_proof(recorder.close().path)
    with pytest.raises(LayoutChanged, match=reason):
        proof.table("/name", "std_msgs/msg/String")


@pytest.mark.parametrize(
    "data",
    [
        b'{"event": "one", "event": "two"}',
        b'{"payload": {"seq": 1, "seq": 2}}',
        b'{"weight_n": NaN}',
        b'{"weight_n": -Infinity}',
        b'{"weight_n": 1e999}',
        b'{"weight_n": ' + b"9" * 5000 + b"}",
        b'{"event": "\\ud800"}',
        b'{"\\udc00": "half of a character as a name"}',
        b'{"event": "\xff"}',
        b'{"event": ' + b"[" * 201 + b"]" * 201 + b"}",
        b'{"event": ' + b"[" * 100_000,
        '{"event": "one"}'.encode("utf-16"),
        b"[1]",
        b'{"event": "one"} more',
    ],
)
def test_json_that_parsers_read_differently_is_refused(
    tmp_path: Path,
    binding: Binding,
    device: LocalAccount,
    clock: HandClock,
    monkeypatch: pytest.MonkeyPatch,
    data: bytes,
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    monkeypatch.setattr("rodeo.evidence.recorder.write_json", lambda _payload: data)
    recorder.write_json("rodeo/event", {})
    monkeypatch.undo()
    proof = open_proof(recorder.close().path)
    with pytest.raises(CorruptProof):
        proof.events()
