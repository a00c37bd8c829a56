"""The file that the recorder writes is the one that the `mcap` package would write."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from rodeo.evidence.writer import McapWriter

START_NS = 1_800_000_000 * 10**9


def test_its_bytes_are_those_of_the_mcap_package() -> None:
    chance = np.random.default_rng(5)
    ours, theirs = BytesIO(), BytesIO()
    one, other = McapWriter(ours, "ros2", "rodeo"), Writer(theirs)
    other.start(profile="ros2", library="rodeo")
    schema = b"float64 x"
    assert one.register_schema("a/msg/A", "ros2msg", schema) == other.register_schema(
        "a/msg/A", "ros2msg", schema
    )
    for number in range(3):
        registered = f"/topic{number}", "cdr" if number else "json", 1 if number else 0
        assert one.register_channel(*registered) == other.register_channel(*registered)
    for k in range(3000):
        channel, data = int(chance.integers(1, 4)), chance.bytes(int(chance.integers(0, 3000)))
        # Now and then a message is logged before the one in front of it.
        log_ns = START_NS + 20_000_000 * k - int(chance.integers(0, 50_000_000))
        one.add_message(channel, k, log_ns, log_ns - 5, data)
        other.add_message(channel, log_ns, data, log_ns - 5, k)
        if k % 700 == 0:
            one.flush()
            other.flush()
            assert ours.getvalue() == theirs.getvalue()
    late = "/late", "cdr", 1
    assert one.register_channel(*late) == other.register_channel(*late)
    one.finish()
    other.finish()
    assert ours.getvalue() == theirs.getvalue()
    assert len(ours.getvalue()) > 2**22, "several chunks were closed because they were large"
    assert len(list(make_reader(BytesIO(ours.getvalue())).iter_messages())) == 3000


@pytest.mark.parametrize("data", [b"", bytes(70_000)], ids=["empty", "large"])
def test_a_messages_record_is_what_stands_in_its_chunk(data: bytes) -> None:
    stream = BytesIO()
    writer = McapWriter(stream, "ros2", "rodeo")
    record = writer.add_message(writer.register_channel("/a", "json", 0), 7, START_NS, START_NS + 1, data)
    writer.finish()
    (_, _, message) = next(iter(make_reader(BytesIO(stream.getvalue())).iter_messages()))
    assert message.data == data and record.endswith(data) and len(record) == 31 + len(data)
