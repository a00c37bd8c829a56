"""What recording costs the robot, and what reading a recording back costs.

`recorder_core_percent_at_200hz`: CPU time of all threads of the recorder, seals included, per recorded second
at 200 messages/s (100 odometry, 100 joint states), in percent of one core.
`recorder_messages_per_s`: as many as it takes when nothing else limits it.
`open_proof_s`: hash, structure, seals and messages of a recording of 192 s at 200 messages/s.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from eth_account import Account

from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.host.clock import WallClock
from rodeo.ros2.types import new, serialize
from rodeo.site import topics
from rodeo_testing.assignments import BINDING

SECONDS = 192
RATE_HZ = 100
START_NS = 1_900_000_000 * 10**9


def run() -> dict[str, float]:
    odometry = serialize(new("nav_msgs/msg/Odometry", child_frame_id="base_link"))
    joints = serialize(
        new(
            "sensor_msgs/msg/JointState",
            name=[f"joint{number}" for number in range(12)],
            position=np.random.default_rng(1).normal(size=12),
            velocity=np.zeros(12),
            effort=np.zeros(12),
        )
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "proof.mcap")
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        recorder = Recorder(path, BINDING, Account.create(), WallClock())
        for index in range(SECONDS * RATE_HZ):
            now_ns = START_NS + index * (10**9 // RATE_HZ)
            for topic, message in ((topics.ODOM, odometry), (topics.JOINT_STATES, joints)):
                recorder.write_ros(topic.name(ns="panther1"), topic.type, message, now_ns, now_ns, index)
        recorder.close()
        cpu_s, wall_s = time.process_time() - cpu_s, time.perf_counter() - wall_s
        size_bytes = path.stat().st_size
        open_s = time.perf_counter()
        open_proof(path)
        open_s = time.perf_counter() - open_s
    return {
        "recorder_core_percent_at_200hz": 100 * cpu_s / SECONDS,
        "recorder_messages_per_s": 2 * SECONDS * RATE_HZ / wall_s,
        "recording_mb_per_minute_at_200hz": size_bytes / 1e6 / SECONDS * 60,
        "open_proof_s": open_s,
    }
