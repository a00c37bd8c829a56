"""Motion capture's latency, from a robot that turns to and fro."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from rodeo.bus.session import Bus
from rodeo.errors import ConfigError
from rodeo.host.clock import WallClock
from rodeo.ros2.node import Node
from rodeo.ros2.types import new
from rodeo.site.config import Site
from rodeo_cli import app
from rodeo_testing.waiting import HANG_S
from services.mocap.latency import LatencyUnknown, measured
from services.mocap.times import SiteTime
from tests.support.nodes import router_port as router_port
from tests.support.site import write_site

pytestmark = pytest.mark.long


def turning(at_s: np.ndarray, rad: float = 0.8) -> np.ndarray:
    """Yaw of a robot that turns to and fro, never twice alike."""
    return rad * np.sin(0.9 * at_s) + rad / 2 * np.sin(0.37 * at_s + 1)


def yaws(latency_s: float, seed: int, lasts_s: float = 30.0, rad: float = 0.8) -> tuple[Any, Any]:
    """What motion capture saw, stamped that much later, and what a drifting, noisy odometry told."""
    chance = np.random.default_rng(seed)
    told_s = np.sort(chance.uniform(0, lasts_s, round(50 * lasts_s)))
    seen_s = np.sort(chance.uniform(0, lasts_s, round(50 * lasts_s)))
    told = 2.0 + turning(told_s, rad) + 0.002 * told_s + chance.normal(0, 0.005, len(told_s))
    seen = turning(seen_s, rad) + chance.normal(0, 0.002, len(seen_s))
    wrapped = np.angle(np.exp(1j * told))
    return np.column_stack([seen_s + latency_s, seen]), np.column_stack([told_s, wrapped])


@pytest.mark.parametrize("latency_s", [0.0, 0.012, 0.12, 0.45, -0.08])
def test_the_latency_is_found_within_2_ms_and_its_error_is_known(latency_s: float) -> None:
    for seed in range(10):
        found = measured(*yaws(latency_s, seed))
        assert abs(found.more_s - latency_s) < 0.002
        assert abs(found.more_s - latency_s) < 5 * found.doubt_s + 0.001
        assert found.doubt_s < 0.002


@pytest.mark.parametrize(
    ("rad", "lasts_s", "said"),
    [
        (0.0, 30.0, "let it turn to and fro"),
        (0.8, 4.0, "poses over 4 s"),
    ],
)
def test_a_robot_that_stands_or_was_hardly_seen_tells_no_latency(
    rad: float, lasts_s: float, said: str
) -> None:
    with pytest.raises(LatencyUnknown, match=said):
        measured(*yaws(0.1, 1, lasts_s, rad))


def test_a_robot_that_turns_evenly_tells_no_latency() -> None:
    at_s = np.arange(0, 30, 0.02)
    evenly = np.column_stack([at_s, 0.5 * at_s])
    with pytest.raises(LatencyUnknown, match="turn to and fro"):
        measured(evenly, evenly)


def test_clocks_that_are_seconds_apart_are_no_latency() -> None:
    seen, told = yaws(0.0, 1)
    for off_s in (1.5, 100.0):
        with pytest.raises(LatencyUnknown):
            measured(seen + np.array([off_s, 0]), told)


def test_the_setting_is_subtracted_from_a_drivers_stamps_too() -> None:
    assert SiteTime(120_000_000).taken_ns(10**9, 10**9 + 1) == 880_000_000


@pytest.fixture
def path(tmp_path: Path, router_port: int) -> Iterator[Path]:
    """A site whose robot turns, and whose motion capture is 120 ms late, of which 20 are corrected."""
    extra = (
        f'clock.source = "wall"\nbus.open = true\nbus.router = "tcp/127.0.0.1:{router_port}"\n'
        'mocap = { source = "ros2", address = "vrpn/{body}/pose", latency_s = 0.02 }\n'
    )
    path, done = write_site(tmp_path, extra=extra), threading.Event()
    bus = Bus.open(Site.load(path).bus.router, timeout_s=HANG_S)
    node = Node(bus.session, "lab", "", 0, WallClock())
    pose = node.publisher("mocap/panther1/pose", "geometry_msgs/msg/PoseStamped")
    odom = node.publisher("panther1/odom", "nav_msgs/msg/Odometry")

    def publish() -> None:
        while not done.wait(0.02):
            now_ns = time.time_ns()
            for publisher, late_s in ((odom, 0.0), (pose, 0.1)):
                message = new(
                    "nav_msgs/msg/Odometry" if publisher is odom else "geometry_msgs/msg/PoseStamped"
                )
                stamp = message.header.stamp
                stamp.sec, stamp.nanosec = divmod(now_ns, 10**9)
                turn = message.pose.pose.orientation if publisher is odom else message.pose.orientation
                yaw = float(turning(np.array(now_ns * 1e-9 % 1e6 - late_s)))
                turn.w, turn.z = np.cos(yaw / 2), np.sin(yaw / 2)
                publisher.publish(message, now_ns)

    thread = threading.Thread(target=publish)
    thread.start()
    yield path
    done.set()
    thread.join()
    node.close()
    bus.close()


def test_the_command_says_the_line_for_the_site_file(path: Path) -> None:
    arguments = ["mocap", "latency", "panther1", "--seconds", "12", "--json", "--site", str(path)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    assert told["configured_s"] == 0.02
    assert told["latency_s"] == pytest.approx(0.12, abs=0.01)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("mocap.latency_s = 0.1", "simulated motion capture is never late"),
        ("mocap.latency_s = 1.5", "write at most 1 s"),
        ("mocap.latency_s = -0.1", "write at least 0 s"),
    ],
)
def test_a_site_file_says_no_latency_that_cannot_be(tmp_path: Path, lines: str, said: str) -> None:
    with pytest.raises(ConfigError) as raised:
        Site.load(write_site(tmp_path, extra=lines + "\n"))
    assert said in raised.value.details["fields"]["mocap.latency_s"]
