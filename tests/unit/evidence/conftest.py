"""Small recordings without a robot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.ros2.types import new, serialize

START_NS = 1_790_000_000 * 10**9
TICK_NS = 20_000_000


class HandClock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.time_ns = START_NS

    def now_ns(self) -> int:
        return self.time_ns

    def now_s(self) -> float:
        return self.time_ns * 1e-9

    def wait_until(self, time_s: float, stop: object = None) -> bool:
        raise NotImplementedError("nobody waits in these tests")


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture(scope="session")
def device() -> LocalAccount:
    return Account.create()


@pytest.fixture(scope="session")
def binding() -> Binding:
    return Binding(
        chain_id=31337,
        task_manager="0x" + "12" * 20,
        organization="0x" + "34" * 20,
        device="panther1",
        task_id=7,
        attempt=1,
        executor="0x" + "ab" * 20,
        nonce="0x" + "cd" * 32,
    )


def odometry(index: int, frame_id: str = "odom") -> bytes:
    message = new("nav_msgs/msg/Odometry", child_frame_id="base_link")
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(START_NS + index * TICK_NS, 10**9)
    message.pose.pose.position.x = 0.01 * index
    return serialize(message)


def joint_state(index: int) -> bytes:
    return serialize(
        new(
            "sensor_msgs/msg/JointState",
            name=["waist", "shoulder"],
            position=np.array([0.1, 0.2]) * index,
            velocity=np.zeros(2),
            effort=np.array([1.0, 2.0]),
        )
    )


def drive(recorder: Recorder, first: int, last: int) -> None:
    """Odometry and joints of ticks `first` to `last` - 1."""
    for index in range(first, last):
        now_ns = START_NS + index * TICK_NS
        recorder.write_ros(
            "panther1/odom", "nav_msgs/msg/Odometry", odometry(index), now_ns, now_ns - 5, index
        )
        recorder.write_ros(
            "panther1/joint_states",
            "sensor_msgs/msg/JointState",
            joint_state(index),
            now_ns,
            now_ns - 5,
            index,
        )


@pytest.fixture
def recorded(tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock) -> Callable[..., Path]:
    """Records `ticks` of 20 ms and gives the sealed file's path."""

    def record(ticks: int = 200, name: str = "proof.mcap", first: int = 0, **changes: object) -> Path:
        recorder = Recorder(tmp_path / name, binding.model_copy(update=changes), device, clock)
        drive(recorder, first, first + ticks)
        return recorder.close().path

    return record
