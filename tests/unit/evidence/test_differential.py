"""A proof has one reading: what ours accepts, `mcap` and `rosbags` read as the same messages.

A forger edits what no seal covers (indexes, summary, packing, metadata), repairs every checksum and length,
and may seal what he likes. Below are forms that were accepted once, each shown to deceive another tool, and
thousands of seeded ones, which are read without looking at the seals: the container alone decides.
"""

from __future__ import annotations

import random
import struct
import zlib
from array import array
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from eth_account import Account
from eth_account.signers.local import LocalAccount
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import McapReader, NonSeekingReader, SeekingReader
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from rosbags.highlevel import AnyReader

from rodeo.evidence.container import Container, Limits
from rodeo.evidence.errors import CorruptProof, EvidenceError
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.evidence.summary import ChunkFacts, MessageTimes, SummaryOf
from rodeo.ros2.definitions import schema_text
from rodeo.ros2.types import STORE
from tests.support.sweep import sweep
from tests.unit.evidence.conftest import HandClock, drive

MUTATIONS_OF_EACH_FORM = 170
DEVICE: LocalAccount = Account.from_key("0x" + "17" * 32)
"""Always the same, so that the mutations are, too."""

Reading = dict[str, tuple[str, str, list[tuple[int, bytes]]]]
"""Topic -> its type, the type's definition, and log time (ns) and payload of its messages."""


# -- what each tool reads ------------------------------------------------------------------------------


def sorted_reading(found: dict[tuple[str, str, str], list[tuple[int, bytes]]]) -> Reading:
    assert len({topic for topic, _, _ in found}) == len(found), "one topic, two types"
    return {topic: (kind, text, sorted(messages)) for (topic, kind, text), messages in found.items()}


def ours(path: Path) -> Reading:
    columns = open_proof(path).topics.values()
    return {
        one.topic: (
            one.ros_type,
            schema_text(one.ros_type) if one.ros_type else "",
            sorted(zip(one.log_ns, one.data, strict=True)),
        )
        for one in columns
    }


def unsealed(path: Path) -> Reading:
    """What ours reads where somebody sealed it."""
    container = Container(path, Limits())
    found: dict[tuple[str, str, str], list[tuple[int, bytes]]] = defaultdict(list)
    for message in container.messages():
        channel = container.channels[message.channel_id]
        schema = container.schemas.get(channel.schema_id)
        kind, text = (schema.name, schema.data.decode()) if schema else ("", "")
        found[channel.topic, kind, text].append((message.log_ns, message.data))
    return sorted_reading(found)


def by_mcap(reader: type[McapReader], *, log_time_order: bool, validate: bool) -> Callable[[Path], Reading]:
    def read(path: Path) -> Reading:
        found: dict[tuple[str, str, str], list[tuple[int, bytes]]] = defaultdict(list)
        with path.open("rb") as file:
            opened = reader(file, validate_crcs=validate)  # type: ignore[call-arg]
            for schema, channel, message in opened.iter_messages(log_time_order=log_time_order):
                kind, text = (schema.name, schema.data.decode()) if schema else ("", "")
                found[channel.topic, kind, text].append((message.log_time, message.data))
        return sorted_reading(found)

    return read


def by_rosbags(path: Path) -> Reading:
    found: dict[tuple[str, str, str], list[tuple[int, bytes]]] = defaultdict(list)
    with AnyReader([path], default_typestore=STORE) as reader:
        for connection, time_ns, data in reader.messages():
            kind = "" if connection.msgtype == "__schemaless__" else connection.msgtype
            found[connection.topic, kind, connection.msgdef.data].append((time_ns, bytes(data)))
    return sorted_reading(found)


TOOLS: dict[str, Callable[[Path], Reading]] = {
    "mcap, by index, by time": by_mcap(SeekingReader, log_time_order=True, validate=False),
    "mcap, by index, in file order": by_mcap(SeekingReader, log_time_order=False, validate=True),
    "mcap, streamed, by time": by_mcap(NonSeekingReader, log_time_order=True, validate=True),
    "mcap, streamed, in file order": by_mcap(NonSeekingReader, log_time_order=False, validate=False),
    "rosbags": by_rosbags,
}


def deceived(path: Path, expected: Reading) -> list[str]:
    """The tools that read something else, or nothing."""
    tools = []
    for name, read in TOOLS.items():
        try:
            same = read(path) == expected
        except Exception:  # noqa: BLE001 - each tool has a dozen ways to say that it cannot read a file
            same = False
        if not same:
            tools.append(name)
    return tools


# -- a file taken apart and put together -----------------------------------------------------------------

Raw = tuple[int, bytes]
"""Opcode and body of a record."""
Pack = Callable[[bytes], tuple[str, bytes]]
"""The compression's name, and a chunk's records compressed."""


def split(data: bytes) -> list[Raw]:
    records, offset = [], 0
    while offset < len(data):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        records.append((opcode, data[offset + 9 : offset + 9 + length]))
        offset += 9 + length
    return records


def join(records: list[Raw]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(body)) + body for opcode, body in records)


def read_record(kind: Any, body: bytes) -> Any:
    return kind.read(ReadDataStream(BytesIO(body)))


def body_of(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


def zstd(records: bytes) -> tuple[str, bytes]:
    return "zstd", zstandard.compress(records)


@dataclass(frozen=True)
class Apart:
    """A recording as its parts; `together` writes it with every length, index and checksum in order."""

    header: bytes
    chunks: tuple[tuple[Raw, ...], ...]
    """The records inside each chunk."""

    @classmethod
    def of(cls, path: Path) -> Apart:
        records = split(path.read_bytes()[len(MCAP0_MAGIC) : -len(MCAP0_MAGIC)])
        chunks = []
        for opcode, body in records:
            if opcode == Opcode.CHUNK:
                (name_length,) = struct.unpack_from("<I", body, 28)
                chunks.append(tuple(split(zstandard.decompress(body[28 + 4 + name_length + 8 :]))))
        return cls(records[0][1], tuple(chunks))

    def together(self, pack: Pack = zstd) -> bytes:
        data = MCAP0_MAGIC + join([(Opcode.HEADER, self.header)])
        summary = SummaryOf()
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for chunk in self.chunks:
            times: MessageTimes = defaultdict(lambda: array("Q"))
            offset = 0
            for opcode, body in chunk:
                if opcode == Opcode.SCHEMA:
                    schema = read_record(Schema, body)
                    schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = read_record(Channel, body)
                    channels[channel.id] = channel
                elif opcode == Opcode.MESSAGE:
                    channel_id, _, log_ns = struct.unpack_from("<HIQ", body)
                    times[channel_id].extend((log_ns, offset))
                offset += 9 + len(body)
            records = join(list(chunk))
            compression, packed = pack(records)
            name = compression.encode()
            length = 9 + 28 + 4 + len(name) + 8 + len(packed)
            facts = ChunkFacts(len(data), length, compression, len(packed), len(records))
            start_ns, end_ns, indexes = summary.add_chunk(facts, times)
            body = (
                struct.pack("<QQQII", start_ns, end_ns, len(records), zlib.crc32(records), len(name)) + name
            )
            body += struct.pack("<Q", len(packed)) + packed
            data += join([(Opcode.CHUNK, body)]) + indexes
        return data + summary.ending(len(data), schemas, channels)

    def edited(self, edit: Callable[[list[Raw]], list[Raw]], chunk: int | None = None) -> Apart:
        """With `edit` of the records of one chunk, or of each."""
        return replace(
            self,
            chunks=tuple(
                tuple(edit(list(records))) if chunk in (None, index) else records
                for index, records in enumerate(self.chunks)
            ),
        )


def resummarized(data: bytes, edit: Callable[[list[Raw]], list[Raw]]) -> bytes:
    """`data` with `edit` of the records of its summary, and offsets, footer and checksum to match."""
    start, offset_start, _ = struct.unpack("<QQI", data[-28:-8])
    records = edit(split(data[start:offset_start]))
    summary, position = join(records), start
    groups: list[list[int]] = []
    for opcode, body in records:
        if not groups or groups[-1][0] != opcode:
            groups.append([opcode, position, 0])
        groups[-1][2] += 9 + len(body)
        position += 9 + len(body)
    offsets = join([(Opcode.SUMMARY_OFFSET, struct.pack("<BQQ", *group)) for group in groups])
    return data[:start] + summary + offsets + footer(summary + offsets, start, start + len(summary))


def footer(summary: bytes, start: int, offset_start: int) -> bytes:
    covered = summary + struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
    body = struct.pack("<QQI", start, offset_start, zlib.crc32(covered))
    return join([(Opcode.FOOTER, body)]) + MCAP0_MAGIC


def each(opcode: Opcode, kind: Any, edit: Callable[[Any], Any]) -> Callable[[list[Raw]], list[Raw]]:
    """Edits the records of one kind."""
    return lambda records: [
        (found, body_of(edit(read_record(kind, body)))) if found == opcode else (found, body)
        for found, body in records
    ]


# -- one recording -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, binding: Binding) -> Callable[[], Path]:
    """Records four chunks of two ROS topics and the JSON channels."""

    def record() -> Path:
        recorder = Recorder(tmp_path_factory.mktemp("proof") / "proof.mcap", binding, DEVICE, HandClock())
        for first in (0, 5, 10):
            drive(recorder, first, first + 5)
            recorder.write_json("rodeo/event", {"event": "passed", "first": first})
        return recorder.close().path

    return record


@pytest.fixture(scope="module")
def honest(recording: Callable[[], Path]) -> Path:
    return recording()


@pytest.fixture(scope="module")
def apart(honest: Path) -> Apart:
    return Apart.of(honest)


def test_all_tools_read_an_honest_recording_alike(honest: Path) -> None:
    reading = ours(honest)
    assert deceived(honest, reading) == []
    assert len(reading["/panther1/odom"][2]) == len(reading["/panther1/joint_states"][2]) == 15


def test_a_file_taken_apart_goes_together_again(honest: Path, apart: Apart) -> None:
    assert apart.together() == honest.read_bytes()
    assert resummarized(honest.read_bytes(), lambda records: records)[-28:-20] == honest.read_bytes()[-28:-20]


# -- forms that were accepted once ---------------------------------------------------------------------


@dataclass(frozen=True)
class Forger:
    """Writes a file and tells whether it deceives."""

    honest: Path
    folder: Path

    def refused(self, data: bytes) -> CorruptProof:
        """`data` is refused by ours although it deceives another tool."""
        path = self.folder / "forged.mcap"
        path.write_bytes(data)
        assert deceived(path, ours(self.honest)), "nobody reads this otherwise"
        with pytest.raises(CorruptProof) as caught:
            open_proof(path)
        return caught.value


@pytest.fixture
def forger(honest: Path, tmp_path: Path) -> Forger:
    return Forger(honest, tmp_path)


def exchange_topics(records: list[Raw]) -> list[Raw]:
    names = {"rodeo/event": "rodeo/seal", "rodeo/seal": "rodeo/event"}
    return each(Opcode.CHANNEL, Channel, lambda c: replace(c, topic=names.get(c.topic, c.topic)))(records)


def test_channels_exchanged_in_the_summary_are_refused(forger: Forger) -> None:
    error = forger.refused(resummarized(forger.honest.read_bytes(), exchange_topics))
    assert error.details["record"] == "channel"


def test_a_chunk_index_that_points_behind_the_data_is_refused(forger: Forger, recording: Any) -> None:
    data = forger.honest.read_bytes()
    chunk = next(body for opcode, body in split(recording().read_bytes()[8:-8]) if opcode == Opcode.CHUNK)
    start = struct.unpack("<Q", data[-28:-20])[0]
    hidden = join([(Opcode.CHUNK, chunk)])

    def point(index: ChunkIndex) -> ChunkIndex:
        return replace(index, chunk_start_offset=start, chunk_length=len(hidden))

    summary = resummarized(data, each(Opcode.CHUNK_INDEX, ChunkIndex, point))[start:-37]
    shown = join([record for record in split(summary) if record[0] != Opcode.SUMMARY_OFFSET])
    begin = start + len(hidden)
    error = forger.refused(data[:start] + hidden + shown + footer(shown, begin, 0))
    assert error.details["offset"] == start


def test_an_index_of_half_of_the_file_is_refused(forger: Forger) -> None:
    def halve(records: list[Raw]) -> list[Raw]:
        indexes = [record for record in records if record[0] == Opcode.CHUNK_INDEX]
        return [record for record in records if record not in indexes[len(indexes) // 2 :]]

    error = forger.refused(resummarized(forger.honest.read_bytes(), halve))
    assert error.details["record"] in ("statistics", "chunk_index", "summary_offset")


def test_a_schema_with_two_fields_exchanged_and_sealed_is_refused(
    forger: Forger, recording: Callable[[], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def exchanged(name: str) -> str:
        text = schema_text(name)
        return text.replace("float64 x\nfloat64 y\nfloat64 z", "float64 z\nfloat64 y\nfloat64 x")

    monkeypatch.setattr("rodeo.evidence.recorder.schema_text", exchanged)
    assert forger.refused(recording().read_bytes()).details["name"] == "nav_msgs/msg/Odometry"


@pytest.mark.parametrize("metadata", [{"offered_qos_profiles": "- history: ["}, {"topic": "/other"}])
def test_channel_metadata_is_refused(forger: Forger, apart: Apart, metadata: dict[str, str]) -> None:
    edit = each(Opcode.CHANNEL, Channel, lambda channel: replace(channel, metadata=metadata))
    path = forger.folder / "forged.mcap"
    path.write_bytes(apart.edited(edit).together())
    with pytest.raises(CorruptProof) as caught:
        open_proof(path)
    assert str(next(iter(metadata))) in caught.value.details["keys"]


def test_a_broken_quality_of_service_is_refused(forger: Forger, apart: Apart) -> None:
    edit = each(
        Opcode.CHANNEL, Channel, lambda c: replace(c, metadata={"offered_qos_profiles": "- history: ["})
    )
    forger.refused(apart.edited(edit).together())


SKIPPABLE = b"\x50\x2a\x4d\x18\x04\x00\x00\x00skip"


@pytest.mark.parametrize(
    "pack",
    [
        lambda data: ("zstd", zstandard.compress(data) + zstandard.compress(b"another")),
        lambda data: ("zstd", zstandard.compress(data) + b"rest"),
        lambda data: ("zstd", SKIPPABLE + zstandard.compress(data)),
        lambda data: ("zstd", zstandard.ZstdCompressor(write_content_size=False).compress(data)),
    ],
    ids=["second frame", "bytes behind", "skippable frame", "without size"],
)
def test_a_chunk_is_one_frame_that_states_its_size(forger: Forger, apart: Apart, pack: Pack) -> None:
    path = forger.folder / "forged.mcap"
    path.write_bytes(apart.together(pack))
    with pytest.raises(CorruptProof):
        open_proof(path)


def test_a_second_frame_deceives(forger: Forger, apart: Apart) -> None:
    forger.refused(
        apart.together(lambda data: ("zstd", zstandard.compress(data) + zstandard.compress(b"another")))
    )


def test_bytes_behind_the_end_are_refused(forger: Forger) -> None:
    forger.refused(forger.honest.read_bytes() + b"more")


def test_a_message_index_that_leaves_out_a_message_is_refused(forger: Forger) -> None:
    records = split(forger.honest.read_bytes()[8:-8])
    at = next(index for index, (opcode, _) in enumerate(records) if opcode == Opcode.MESSAGE_INDEX)
    body = records[at][1]
    records[at] = (Opcode.MESSAGE_INDEX, body[:6] + body[22:38] + body[22:])
    forger.folder.joinpath("forged.mcap").write_bytes(MCAP0_MAGIC + join(records) + MCAP0_MAGIC)
    with pytest.raises(CorruptProof, match="message index"):
        open_proof(forger.folder / "forged.mcap")


# -- thousands of others -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Source:
    """What a mutation is made of."""

    chance: random.Random
    data: bytes
    apart: Apart
    other: Apart
    """Another recording of the same task."""

    def flipped(self, data: bytes) -> bytes:
        """With one to three bytes changed."""
        changed = bytearray(data)
        for _ in range(self.chance.choice((1, 1, 3))):
            if changed:
                changed[self.chance.randrange(len(changed))] ^= 1 << self.chance.randrange(8)
        return bytes(changed)

    def shuffled(self, records: list[Raw]) -> list[Raw]:
        """With a record dropped, doubled, moved, exchanged with another, or changed."""
        one, two = (self.chance.randrange(len(records)) for _ in range(2))
        records = list(records)
        opcode, body = records[one]
        match self.chance.randrange(6):
            case 0:
                del records[one]
            case 1:
                records.insert(two, records[one])
            case 2:
                records.insert(two, records.pop(one))
            case 3:
                records[one], records[two] = records[two], records[one]
            case 4:
                records[one] = opcode, self.flipped(body)
            case 5:
                records[one] = opcode, body + self.chance.randbytes(self.chance.choice((1, 4, 16)))
        return records

    def strange(self) -> Raw:
        """A record that no recording holds at this place."""
        text = struct.pack("<I", 4) + b"name"
        return self.chance.choice(
            [
                (Opcode.ATTACHMENT, struct.pack("<QQ", 0, 0) + text + text + struct.pack("<QI", 0, 0)),
                (Opcode.METADATA, text + struct.pack("<I", 0)),
                (Opcode.MESSAGE, struct.pack("<HIQQ", 1, 9, 10**18, 10**18) + b"{}"),
                (Opcode.DATA_END, bytes(4)),
                (Opcode.FOOTER, bytes(20)),
                (Opcode.HEADER, self.apart.header),
                (self.chance.randrange(0x10, 0x100), self.chance.randbytes(12)),
                *self.other.chunks[0][:3],
            ]
        )


def repaired(records: list[Raw]) -> bytes:
    """A file of these records whose footer fits them, where it has one."""
    data, start = MCAP0_MAGIC, 0
    for opcode, body in records:
        if opcode == Opcode.FOOTER and len(body) == 20 and start:
            offset_start = struct.unpack_from("<Q", body, 8)[0]
            return data + footer(data[start:], start, offset_start)
        data += join([(opcode, body)])
        start = len(data) if opcode == Opcode.DATA_END else start
    return data + MCAP0_MAGIC


def flip_bytes(source: Source) -> bytes:
    return source.flipped(source.data)


def insert_or_cut_bytes(source: Source) -> bytes:
    at = source.chance.randrange(len(source.data))
    extra = source.chance.randbytes(source.chance.randrange(1, 20))
    cut = source.data[at + source.chance.randrange(1, 40) :]
    return source.chance.choice(
        [
            source.data[:at],
            source.data[:at] + extra + source.data[at:],
            source.data[:at] + cut,
            source.data + extra,
            source.data + source.data[at:],
        ]
    )


def change_records(source: Source) -> bytes:
    return repaired(source.shuffled(split(source.data[8:-8])))


def insert_a_record(source: Source) -> bytes:
    records = split(source.data[8:-8])
    records.insert(source.chance.randrange(len(records)), source.strange())
    return repaired(records)


def change_the_header(source: Source) -> bytes:
    profile, library = source.chance.choice(["ros2", "ros1", "", "ros2 "]), source.chance.randbytes(3).hex()
    header = b"".join(struct.pack("<I", len(text)) + text.encode() for text in (profile, library))
    return replace(source.apart, header=header + bytes(source.chance.randrange(3))).together()


def change_a_message_index(source: Source) -> bytes:
    records = split(source.data[8:-8])
    at = source.chance.choice([i for i, (opcode, _) in enumerate(records) if opcode == Opcode.MESSAGE_INDEX])
    body = records[at][1]
    entries = [body[begin : begin + 16] for begin in range(6, len(body), 16)]
    one, two = (source.chance.randrange(len(entries)) for _ in range(2))
    match source.chance.randrange(4):
        case 0:
            entries[one], entries[two] = entries[two], entries[one]
        case 1:
            entries[one] = entries[two]
        case 2:
            entries[one] = source.flipped(entries[one])
        case 3:
            body = struct.pack("<H", source.chance.randrange(6)) + body[2:]
    records[at] = Opcode.MESSAGE_INDEX, body[:6] + b"".join(entries)
    return repaired(records)


def change_summary_records(source: Source) -> bytes:
    return resummarized(source.data, source.shuffled)


def insert_a_summary_record(source: Source) -> bytes:
    def insert(records: list[Raw]) -> list[Raw]:
        at = source.chance.randrange(len(records) + 1)
        return [*records[:at], source.strange(), *records[at:]]

    return resummarized(source.data, insert)


def change_summary_fields(source: Source) -> bytes:
    """A field of a record gets another record's, a neighbour's or an absurd value; two exchange theirs."""
    kinds = {
        Opcode.SCHEMA: Schema,
        Opcode.CHANNEL: Channel,
        Opcode.CHUNK_INDEX: ChunkIndex,
        Opcode.STATISTICS: Statistics,
    }

    def edit(records: list[Raw]) -> list[Raw]:
        opcode = source.chance.choice(list(kinds))
        places = [index for index, (found, _) in enumerate(records) if found == opcode]
        one, two = (source.chance.choice(places) for _ in range(2))
        first, second = (read_record(kinds[opcode], records[at][1]) for at in (one, two))
        field = source.chance.choice(list(vars(first)))
        mine, theirs = getattr(first, field), getattr(second, field)
        if isinstance(mine, int) and (one == two or source.chance.random() < 0.5):
            mine, theirs = max(0, source.chance.choice([0, mine + 1, mine - 1, 2**15])), mine
        elif isinstance(mine, dict) and mine:
            key = source.chance.choice(list(mine))
            mine = mine | {key: mine[key] + source.chance.choice((-9, -1, 1, 16))}
            mine, theirs = theirs, mine
        setattr(first, field, theirs)
        setattr(second, field, mine)
        records[one] = opcode, body_of(first)
        records[two] = opcode, body_of(second)
        return records

    return resummarized(source.data, edit)


def change_the_footer(source: Source) -> bytes:
    start, offset_start, crc = struct.unpack("<QQI", source.data[-28:-8])
    choices = [0, 8, start - 13, start, offset_start, start + 1, len(source.data), len(source.data) - 37]
    start, offset_start = (source.chance.choice([*choices, source.chance.randrange(1 << 16)]) for _ in "ab")
    crc = source.chance.choice([0, crc])
    if source.chance.random() < 0.5:
        covered = source.data[min(start, len(source.data)) : -37]
        return source.data[:-37] + footer(covered, start, offset_start)
    body = struct.pack("<QQI", start, offset_start, crc)
    return source.data[:-37] + join([(Opcode.FOOTER, body)]) + MCAP0_MAGIC


def change_records_in_a_chunk(source: Source) -> bytes:
    return source.apart.edited(source.shuffled, source.chance.randrange(len(source.apart.chunks))).together()


def insert_a_record_in_a_chunk(source: Source) -> bytes:
    def insert(records: list[Raw]) -> list[Raw]:
        at = source.chance.randrange(len(records) + 1)
        return [*records[:at], source.strange(), *records[at:]]

    return source.apart.edited(insert, source.chance.randrange(len(source.apart.chunks))).together()


def change_declarations(source: Source) -> bytes:
    """Other topics, encodings, metadata, schema texts and numbers than the recorder writes."""
    text = source.chance.choice(["ros2msg", "ros2idl", "jsonschema", "json", "cdr", "ros1", "", "a", "/a"])
    topic = source.chance.choice(["/panther1/odom", "rodeo/event", "/other"])

    def edit_channel(channel: Channel) -> Channel:
        if channel.topic != topic:
            return channel
        number = source.chance.randrange(4)
        return replace(
            channel,
            **source.chance.choice(
                [
                    {"metadata": {text: text}},
                    {"message_encoding": text},
                    {"topic": text},
                    {"schema_id": number},
                ]
            ),
        )

    def edit_schema(schema: Schema) -> Schema:
        lines = schema.data.split(b"\n")
        one, two = (source.chance.randrange(len(lines)) for _ in range(2))
        lines[one], lines[two] = lines[two], lines[one]
        return replace(
            schema,
            **source.chance.choice(
                [{"data": b"\n".join(lines)}, {"encoding": text}, {"name": text}, {"id": 0}]
            ),
        )

    edits = [each(Opcode.CHANNEL, Channel, edit_channel), each(Opcode.SCHEMA, Schema, edit_schema)]
    return source.apart.edited(source.chance.choice(edits)).together()


def pack_otherwise(source: Source) -> bytes:
    """Chunks that are compressed otherwise, begin elsewhere, or hold bytes behind their frame."""
    records = [record for chunk in source.apart.chunks for record in chunk]
    messages = [index for index, (opcode, _) in enumerate(records) if opcode == Opcode.MESSAGE]
    ends = sorted({*source.chance.sample(messages[:-1], source.chance.randrange(4)), messages[-1]})
    chunks = [tuple(records[a + 1 : b + 1]) for a, b in zip([-1, *ends], ends, strict=False)]
    level, extra = source.chance.randrange(1, 12), source.chance.randbytes(source.chance.randrange(1, 9))
    compress = zstandard.ZstdCompressor(
        level=level,
        write_checksum=source.chance.random() < 0.5,
        write_content_size=source.chance.random() < 0.8,
    ).compress
    packs: list[Pack] = [
        lambda data: ("zstd", compress(data)),
        lambda data: ("", data),
        lambda data: ("zstd", compress(data) + extra),
        lambda data: ("zstd", compress(data) + zstandard.compress(extra)),
        lambda data: ("zstd", compress(data[:100]) + compress(data[100:])),
        lambda data: ("zstd", SKIPPABLE + compress(data)),
        lambda data: ("zstd", compress(data) + SKIPPABLE),
        lambda data: ("zstd", compress(data + extra)),
        lambda data: ("lz4", lz4.frame.compress(data)),
        lambda data: ("", data + extra),
    ]
    return replace(source.apart, chunks=tuple(chunks)).together(source.chance.choice(packs))


def join_two_files(source: Source) -> bytes:
    """Records or summary of another recording in place of, or beside, this one's."""
    ours, theirs = split(source.data[8:-8]), split(source.other.together()[8:-8])
    at = source.chance.randrange(len(ours))
    begin = source.chance.randrange(len(theirs))
    end = begin + source.chance.randrange(1, 6)
    instead = source.chance.randrange(2) * (end - begin)
    return repaired([*ours[:at], *theirs[begin:end], *ours[at + instead :]])


FORMS = [
    flip_bytes,
    insert_or_cut_bytes,
    change_records,
    insert_a_record,
    change_the_header,
    change_a_message_index,
    change_summary_records,
    insert_a_summary_record,
    change_summary_fields,
    change_the_footer,
    change_records_in_a_chunk,
    insert_a_record_in_a_chunk,
    change_declarations,
    pack_otherwise,
    join_two_files,
]


@pytest.mark.parametrize("form", sweep(FORMS, 3), ids=lambda form: form.__name__)
def test_what_is_accepted_is_read_alike(
    honest: Path, apart: Apart, recording: Callable[[], Path], tmp_path: Path, form: Callable[[Source], bytes]
) -> None:
    chance = random.Random(form.__name__)
    source = Source(chance, honest.read_bytes(), apart, Apart.of(recording()))
    path, seen, refused = tmp_path / "mutated.mcap", {source.data}, 0
    while len(seen) <= MUTATIONS_OF_EACH_FORM:
        try:
            data = form(source)
        except (McapError, struct.error, UnicodeDecodeError):
            continue  # what was changed gives no record to put in order
        if data in seen:
            continue
        seen.add(data)
        path.write_bytes(data)
        try:
            reading = unsealed(path)
        except EvidenceError:
            refused += 1
            continue
        tools = deceived(path, reading)
        assert not tools, f"mutation {len(seen) - 1} is read otherwise by {tools}"
    assert refused
