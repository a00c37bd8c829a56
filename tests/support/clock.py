"""The simulation's `/clock`, as a test sets it."""

from __future__ import annotations

import struct

from rodeo.bus.session import Bus
from rodeo.host.stamps import sec_nanosec
from rodeo.site import topics


def publish_clock(bus: Bus, domain_id: int, time_s: float) -> None:
    """Put rosgraph_msgs/msg/Clock on the robot plane: CDR, little endian, sec and nanosec."""
    seconds, nanoseconds = sec_nanosec(int(time_s * 1e9))
    payload = b"\x00\x01\x00\x00" + struct.pack("<iI", seconds, nanoseconds)
    bus.session.put(
        f"{domain_id}/{topics.CLOCK.name()}/rosgraph_msgs::msg::dds_::Clock_/RIHS01_test", payload
    )
