"""ROS stamps: seconds and nanoseconds, as builtin_interfaces' Time and Duration have them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import numpy as np

SECOND_NS = 1_000_000_000

FASTEST_CLOCK = 50.0
"""Speed of a simulated clock, times real time, if the site file sets none."""

Time = TypeVar("Time", int, "np.ndarray")


def sec_nanosec(time_ns: Time) -> tuple[Time, Time]:
    """(s, ns below a second) of a time or a duration, or of an array of them."""
    return divmod(time_ns, SECOND_NS)


def stamp_ns(stamp: Any) -> int:
    """A Time or Duration in ns."""
    return int(stamp.sec) * SECOND_NS + int(stamp.nanosec)


def stamp_s(stamp: Any) -> float:
    """A Time or Duration in s."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def set_stamp(message: Any, time_ns: int) -> None:
    """Stamp a message that begins with a std_msgs/Header."""
    message.header.stamp.sec, message.header.stamp.nanosec = sec_nanosec(time_ns)
