"""Commands for commissioning motion capture."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Annotated, Any

import typer

from rodeo.errors import ConfigError
from rodeo.host.clock import WallClock
from rodeo.host.stamps import stamp_s
from rodeo.ros2 import readings
from rodeo.ros2.readings import Unknown
from rodeo.site import topics
from rodeo_cli.common import (
    DEFAULT_SITE,
    ROBOTS,
    JsonOption,
    SiteOption,
    connected,
    print_facts,
    reports_errors,
)

mocap = typer.Typer(help="Commission motion capture.", no_args_is_help=True)

_SLICE_S = 0.2


@mocap.callback()
def _group() -> None:
    """So that `latency` stays a word of its own."""


@mocap.command()
@reports_errors
def latency(
    robot: Annotated[
        str,
        typer.Argument(
            help="A robot that turns to and fro meanwhile, by its name.",
            metavar="NAME",
            autocompletion=ROBOTS,
        ),
    ],
    seconds: Annotated[float, typer.Option(help="How long to listen.", min=10.0, max=600.0)] = 30.0,
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """Measure motion capture's latency by a robot's turns, and print the line for the site file."""
    # Imported here: numpy and the messages take their time.
    import numpy as np

    from rodeo.ros2.node import Node
    from services.mocap.latency import measured

    with connected(site) as (loaded, bus):
        if not loaded.lab.mocap:
            raise ConfigError("the site has no motion capture: lab.mocap = false")
        seen: list[tuple[float, float]] = []
        told: list[tuple[float, float]] = []
        node = Node(bus.session, "latency", "", loaded.bus.domain_id, WallClock())
        pose, odom = topics.MOCAP_POSE, topics.ODOM
        namespace = loaded.robot(robot).namespace
        node.subscription(pose.name(body=robot), pose.type, _keeps(seen, lambda message: message.pose))
        node.subscription(odom.name(ns=namespace), odom.type, _keeps(told, lambda message: message.pose.pose))
        until_s = time.monotonic() + seconds
        try:
            while (left_s := until_s - time.monotonic()) > 0:
                WallClock().wait_until(time.time() + min(left_s, _SLICE_S))
        finally:
            node.close()
    found = measured(np.array(seen).reshape(-1, 2), np.array(told).reshape(-1, 2))
    now_s = loaded.mocap.latency_s
    wanted_s = round(now_s + found.more_s, 3)
    document = {"latency_s": wanted_s, "doubt_s": round(found.doubt_s, 4), "configured_s": now_s}
    line = f"latency_s = {wanted_s:g}" if wanted_s >= 0 else "none: its stamps are early, look at the clocks"
    print_facts(
        document,
        as_json,
        [
            ("write in [mocap]", line),
            ("now", f"{now_s:g} s are subtracted, and it is {found.more_s:+.3f} s late still"),
            ("standard error", f"{found.doubt_s:.3f} s, from {len(seen)} poses"),
        ],
    )


def _keeps(yaws: list[tuple[float, float]], part: Callable[[Any], Any]) -> Callable[[Any, Any], None]:
    """A callback that keeps stamp and yaw of each message."""

    def keep(message: Any, _info: Any) -> None:
        try:
            turn = readings.pose(part(message)).orientation
        except Unknown:
            return
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
        yaws.append((stamp_s(message.header.stamp), yaw))

    return keep
