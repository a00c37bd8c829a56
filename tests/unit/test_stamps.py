"""Seconds and nanoseconds of ROS stamps."""

import re
from pathlib import Path

import pytest

from rodeo.host import stamps
from rodeo.ros2.types import duration_message, new, time_message

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("time_ns", [0, 1, 999_999_999, 1_900_000_000_123_456_789])
def test_a_stamp_is_the_time_that_it_was_made_of(time_ns: int) -> None:
    for message in (time_message(time_ns), duration_message(time_ns)):
        assert stamps.stamp_ns(message) == time_ns
        assert stamps.stamp_s(message) == pytest.approx(time_ns * 1e-9)


def test_a_duration_before_zero_has_nanoseconds_that_count_up() -> None:
    message = duration_message(-1)
    assert (message.sec, message.nanosec) == (-1, 999_999_999)


def test_a_message_is_stamped_in_its_header() -> None:
    message = new("geometry_msgs/msg/PoseStamped")
    stamps.set_stamp(message, 7_000_000_003)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (7, 3)


_BY_HAND = re.compile(
    r"divmod\([^()]*, *(1_000_000_000|10\*\*9)\)|sec \* (1_000_000_000|10\*\*9)|nanosec \* 1e-9"
)


def test_no_other_file_splits_or_joins_seconds_and_nanoseconds() -> None:
    found = {
        str(path.relative_to(ROOT))
        for folder in ("rodeo", "services", "deploy", "rodeo_cli", "bench", "tests/support")
        for path in (ROOT / folder).rglob("*.py")
        if _BY_HAND.search(path.read_text())
    }
    assert found == {"rodeo/host/stamps.py"}


@pytest.mark.parametrize(
    "line", ["sec, nanosec = divmod(now_ns, 1_000_000_000)", "stamp.sec + stamp.nanosec * 1e-9"]
)
def test_a_stamp_that_is_split_or_joined_by_hand_is_found(line: str) -> None:
    assert _BY_HAND.search(line)
