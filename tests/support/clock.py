"""The site's time, as a test sets it: the simulation's `/clock`, or that of the router's machine."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Any

import zenoh

from rodeo.bus.messages import Status
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


def serve_time(
    bus: Bus, org: str, now_s: Callable[[], float] = time.time, before: Callable[[], object] = lambda: None
) -> zenoh.Queryable[None]:
    """Tell the site's time as the process `router` does; `before` is called before each answer."""

    def status(_request: Any) -> dict[str, Any]:
        before()
        said = Status(
            process="router",
            pid=1,
            ready=True,
            reason="",
            activity="",
            progress=None,
            since_s=0.0,
            time_s=now_s(),
        )
        return said.model_dump()

    return bus.serve(topics.STATUS.name(org=org, process="router"), status)
