"""The recorder's door for ROS 2 messages: nonsense is counted, and costs what is sensible nothing."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from rodeo.recording.door import MessageDoor, Refusal, Refusals
from rodeo.ros2 import types
from rodeo.ros2.base import MessageInfo
from rodeo.site import topics
from rodeo.site.topics import Plane, Topic

START_NS = 1_800_000_000 * 10**9
PERIOD_NS = 20_000_000
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
BODY, OTHER = b"b" * 16, b"o" * 16


class Entrance:
    """One topic's door, with its publisher and the clocks of site and wall."""

    def __init__(self, topic: Topic = topics.JOINT_STATES, slack_s: float = 15.0) -> None:
        self.wall_s = 0.0
        self.now_ns = START_NS
        self.sequence = 0
        self._topic = topic
        self.door = MessageDoor(topic, slack_s, lambda: self.wall_s)

    def cdr(self, stamp_ns: int | None = None, frame: str = "", **fields: Any) -> bytes:
        sec, nanosec = divmod(self.now_ns if stamp_ns is None else stamp_ns, 10**9)
        header = types.new(
            "std_msgs/msg/Header",
            stamp=types.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec),
            frame_id=frame,
        )
        if self._topic.type == "sensor_msgs/msg/JointState":
            fields = {"name": ["waist"], "position": [0.1], "velocity": [0.0], "effort": [0.0]} | fields
            fields = {name: value if name == "name" else np.array(value) for name, value in fields.items()}
        elif self._topic.type == "geometry_msgs/msg/PoseStamped":
            orientation = types.new("geometry_msgs/msg/Quaternion", **(UPRIGHT | fields))
            fields = {"pose": types.new("geometry_msgs/msg/Pose", orientation=orientation)}
        return types.serialize(types.new(self._topic.type, header=header, **fields))

    def say(self, cdr: bytes, sequence: int | None = None, gid: bytes = BODY) -> Refusal | None:
        info = MessageInfo(cdr, self.now_ns, self.sequence if sequence is None else sequence, gid)
        return self.door.refusal(info, self.now_ns)

    def next(self, **fields: Any) -> Refusal | None:
        """The publisher's next message, on time."""
        self.sequence += 1
        self.now_ns += PERIOD_NS
        self.wall_s += PERIOD_NS * 1e-9
        return self.say(self.cdr(**fields))


@pytest.fixture
def entrance() -> Entrance:
    entrance = Entrance()
    assert [entrance.next() for _ in range(3)] == [None] * 3
    return entrance


def test_a_sensible_publisher_is_written_throughout() -> None:
    entrance = Entrance()
    assert [entrance.next() for _ in range(500)] == [None] * 500


def test_honest_loss_and_jitter_are_let_in(entrance: Entrance) -> None:
    for lost, jitter_ns in ((3, 4_000_000), (40, -4_000_000), (400, 0), (0, 4_000_000)):
        entrance.sequence += lost
        entrance.now_ns += lost * PERIOD_NS
        assert entrance.next(stamp_ns=entrance.now_ns + PERIOD_NS + jitter_ns) is None


@pytest.mark.parametrize("data", [b"", b"\x00\x01\x00\x00", b"\xff" * 60, b"\x00\x01\x00\x00" + b"\xff" * 60])
def test_bytes_that_are_no_message_are_malformed(data: bytes) -> None:
    entrance = Entrance()
    assert entrance.say(data) in (Refusal.MALFORMED, Refusal.ABSURD_TIME)
    entrance.next()
    assert entrance.say(data, 9) in (Refusal.MALFORMED, Refusal.ABSURD_TIME)
    assert entrance.next() is None


def test_a_message_with_other_joints_is_malformed(entrance: Entrance) -> None:
    assert entrance.next(name=["elbow"]) is Refusal.MALFORMED
    assert entrance.next(position=[0.1, 0.2]) is Refusal.MALFORMED
    assert entrance.next() is None


def test_a_message_with_something_behind_it_is_malformed_also_as_the_first(entrance: Entrance) -> None:
    assert entrance.say(entrance.cdr(entrance.now_ns + 1) + b"\0\0\0\0", 10) is Refusal.MALFORMED
    first = Entrance()
    assert first.say(first.cdr() + b"\0\0\0\0", 1) is Refusal.MALFORMED


def test_a_message_in_another_frame_is_misaddressed(entrance: Entrance) -> None:
    assert entrance.next(frame="elsewhere") is Refusal.MISADDRESSED
    assert entrance.next() is None


def test_a_pose_that_is_not_in_the_map_is_misaddressed_also_as_the_first() -> None:
    entrance = Entrance(topics.POSE)
    assert entrance.next(frame="odom") is Refusal.MISADDRESSED
    assert entrance.next(frame="map") is None


@pytest.mark.parametrize("w", [0.0, 0.5, 2.0, float("nan"), float("inf")])
def test_an_orientation_that_is_no_rotation_is_left_out(w: float) -> None:
    entrance = Entrance(topics.POSE)
    assert entrance.next(frame="map", w=w) is Refusal.NOT_A_NUMBER
    assert entrance.next(frame="map") is None
    assert entrance.next(frame="map", w=w) is Refusal.NOT_A_NUMBER
    assert entrance.next(frame="map", w=0.6, z=-0.8) is None


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_not_a_number_is_left_out(value: float) -> None:
    entrance = Entrance(topics.BATTERY_STATE)
    assert entrance.next(voltage=25.0, percentage=value) is Refusal.NOT_A_NUMBER
    assert entrance.next(voltage=25.0, percentage=0.5) is None


def test_infinities_that_cancel_are_left_out_and_numbers_of_any_size_are_written() -> None:
    entrance = Entrance(topics.BATTERY_STATE)
    assert entrance.next(voltage=float("inf"), percentage=float("-inf")) is Refusal.NOT_A_NUMBER
    assert entrance.next(voltage=3e38, percentage=3e38) is None


def test_joints_need_not_measure_everything(entrance: Entrance) -> None:
    """Wheels often have no position, and their publisher may be the arm's."""
    assert entrance.next(position=[float("nan")], effort=[float("nan")]) is None
    assert entrance.next() is None


def test_a_battery_need_not_measure_everything() -> None:
    entrance = Entrance(topics.BATTERY_STATE)
    assert entrance.next(voltage=25.0, percentage=0.5, current=float("nan")) is None
    assert entrance.next(voltage=float("nan"), percentage=0.5) is Refusal.NOT_A_NUMBER


def test_a_message_that_is_published_twice_is_written_once(entrance: Entrance) -> None:
    again = entrance.cdr()
    assert entrance.say(again) is Refusal.DOUBLED
    assert entrance.say(again, entrance.sequence + 1) is Refusal.DOUBLED
    assert entrance.next() is None


def test_a_number_that_was_there_is_doubled(entrance: Entrance) -> None:
    assert entrance.say(entrance.cdr(entrance.now_ns + 5_000_000), entrance.sequence) is Refusal.DOUBLED


@pytest.mark.parametrize("sequence", [2**32 - 1, 2**31, 2**32, 2**63 - 1, -1])
def test_an_absurd_sequence_number_is_left_out(entrance: Entrance, sequence: int) -> None:
    stamp_ns = entrance.now_ns + PERIOD_NS // 2
    assert entrance.say(entrance.cdr(stamp_ns), sequence) is Refusal.ABSURD_NUMBER
    assert entrance.next() is None


@pytest.mark.parametrize("stamp_s", [0, 1, 2**31 - 1, 1_800_000_000 - 16, 1_800_000_000 + 17])
def test_a_stamp_of_another_time_is_left_out(entrance: Entrance, stamp_s: int) -> None:
    assert entrance.next(stamp_ns=stamp_s * 10**9) is Refusal.ABSURD_TIME
    assert entrance.next() is None


def test_nanoseconds_that_are_more_than_a_second_are_left_out(entrance: Entrance) -> None:
    cdr = bytearray(entrance.cdr(entrance.now_ns))
    cdr[8:12] = (2**32 - 1).to_bytes(4, "little")
    assert entrance.say(bytes(cdr), entrance.sequence + 1) is Refusal.ABSURD_TIME


@pytest.mark.parametrize("source_s", [-1, 0, 4_102_444_800, 2**63 // 10**9])
def test_a_publishers_time_that_no_clock_shows_is_left_out(entrance: Entrance, source_s: int) -> None:
    info = MessageInfo(entrance.cdr(entrance.now_ns + 1), source_s * 10**9, entrance.sequence + 1, BODY)
    assert entrance.door.refusal(info, entrance.now_ns) is Refusal.ABSURD_TIME
    assert entrance.next() is None


def test_a_publisher_may_stamp_with_the_walls_time(entrance: Entrance) -> None:
    entrance.now_ns += PERIOD_NS
    info = MessageInfo(entrance.cdr(), time.time_ns(), entrance.sequence + 1, BODY)
    assert entrance.door.refusal(info, entrance.now_ns) is None


def test_a_flood_by_another_publisher_silences_nobody(entrance: Entrance) -> None:
    for _ in range(100):
        flood = [
            entrance.say(entrance.cdr(entrance.now_ns + step), step, OTHER) for step in range(1, 10_000, 100)
        ]
        assert set(flood) == {Refusal.STRANGER}
        assert entrance.next() is None


def test_a_publisher_that_was_restarted_counts_anew_and_is_followed(entrance: Entrance) -> None:
    assert entrance.say(entrance.cdr(entrance.now_ns + 1), 1, OTHER) is Refusal.STRANGER
    entrance.now_ns += 4 * 10**9
    entrance.wall_s += 4.0
    assert entrance.say(entrance.cdr(), 1, OTHER) is None
    assert entrance.next() is Refusal.STRANGER


def test_a_stamp_ahead_of_the_clock_silences_its_topic_for_seconds_only(entrance: Entrance) -> None:
    assert entrance.say(entrance.cdr(entrance.now_ns + 14 * 10**9), entrance.sequence + 1) is None
    refused = [entrance.next() for _ in range(160)]
    assert refused[0] is Refusal.DOUBLED and refused[-1] is None


def test_a_publisher_that_goes_wild_has_a_budget(entrance: Entrance) -> None:
    let_in = 0
    for _ in range(5000):
        entrance.sequence += 1
        entrance.now_ns += 200_000
        let_in += entrance.say(entrance.cdr()) is None
    assert 1400 <= let_in <= 1600  # 500 for a second, and what two seconds saved up


def test_every_recorded_topic_has_a_door() -> None:
    for topic in topics.TOPICS:
        if topic.recorded and topic.plane is Plane.ROBOT:
            MessageDoor(topic, 1.0)


def test_refusals_are_counted_by_what_and_why() -> None:
    refusals = Refusals()
    for _ in range(2):
        refusals.count("message", Refusal.DOUBLED)
    refusals.count("statement", Refusal.STRANGER)
    assert refusals.summary() == {"message:doubled": 2, "statement:stranger": 1}
