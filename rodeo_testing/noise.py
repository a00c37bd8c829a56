"""Noise that honest sensors, buses and things add to a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rodeo.evidence.attestation import Attestation
from rodeo.lab.world import arm_model
from rodeo.ros2.types import msg, time_message
from rodeo.site import topics
from rodeo_testing.recordings import Sample, Sides, Take, Witnesses, stamped_ns

_Header = msg("std_msgs/msg/Header")
_Point, _Quaternion, _Pose = (msg(f"geometry_msgs/msg/{name}") for name in ("Point", "Quaternion", "Pose"))


@dataclass(frozen=True)
class Noise:
    """Each number is a standard deviation unless it says otherwise."""

    pose_m: float = 0.002
    pose_rad: float = 0.005
    encoder_rad: float = 0.010
    """Standard deviation of the constant offset of each joint of the arm."""
    joint_rad: float = 0.0005
    finger_m: float = 0.0001
    odom_m: float = 0.002
    stamp_s: float = 0.004
    lost_share: float = 0.05
    """Share of the messages of each topic that is lost, one by one."""
    lost_in_runs_share: float = 0.02
    run_messages: float = 20.0
    """Mean length of a run."""
    clock_s: float = 0.2
    """Most that the clock of the motion capture is off."""
    witness_lost_share: float = 0.05
    """Share of other devices' statements, and of the recording's heads on their way to them, that is lost.
    What motion capture said the recorder asks of the journal, when it sees the gap and once more at the
    end: either answer may be lost, too. What the bin said comes at the end. Of a charge what is lost stays
    lost, but for its opening."""
    physics_share: float = 0.3
    """Most that friction and mass are off."""
    size_m: float = 0.005
    """Most that an item is wider or narrower."""

    def times(self, share: float) -> Noise:
        return Noise(**{
            name: value if name == "run_messages" else value * share for name, value in vars(self).items()
        })  # fmt: skip


HEAVY = Noise()


def noisy(
    film: Take, noise: Noise, chance: np.random.Generator, clock_s: float | None = None
) -> tuple[Take, Witnesses]:
    """The film as such sensors and such a bus would have delivered it, and who signed it.

    `clock_s` is how far the clock of the motion capture is ahead, if it is not drawn.
    """
    joints = len(arm_model().joints)
    offset_rad = chance.normal(0, noise.encoder_rad, joints) if noise.encoder_rad else np.zeros(joints)
    drift = chance.normal(0, 0.01, 2)
    drawn_s = chance.uniform(-1, 1) * noise.clock_s
    lost = _Lost(noise, chance)
    samples = []
    for sample in film.samples:
        # What devices sign is lost below. The bin's picture is no message: the robot asks for it until it
        # comes.
        if not sample.ros_type or sample.ros_type == topics.BIN_IMAGE.type:
            samples.append(sample)
            continue
        if lost(sample.topic):
            continue
        stamp_ns = stamped_ns(sample.message) + round(chance.normal(0, noise.stamp_s) * 1e9)
        message = _measured(sample, film.start_s, noise, chance, offset_rad, drift)
        header = _Header(stamp=time_message(stamp_ns), frame_id=message.header.frame_id)
        samples.append(replace(sample, message=replace(message, header=header)))

    return Take(samples), losses(noise, chance, drawn_s if clock_s is None else clock_s)


def losses(noise: Noise, chance: np.random.Generator, clock_s: float) -> Witnesses:
    """Honest witnesses of one recording, of whose statements and of whose hearing something is lost."""
    late: list[Attestation] = []

    def misses() -> bool:
        return bool(chance.random() < noise.witness_lost_share)

    def heard(attestation: Attestation) -> Attestation | None:
        kind = attestation.payload["type"]
        # What the robot signs itself, and records, is on no bus.
        if kind == "robot.presentation" or not misses():
            return attestation
        if kind.startswith("bin.") or not (misses() and misses()):
            late.append(attestation)
        return None

    def on_record(attestation: Attestation) -> Attestation | None:
        # A dock begins once the opening is signed by both and is on its own record.
        opening = attestation.payload.get("reason") == "opening"
        return attestation if opening or not misses() else None

    return Witnesses(
        edit=heard,
        asked_for=late,
        hears=lambda _time_s: not misses(),
        mocap_clock_s=clock_s,
        charge=Sides(keep=on_record),
    )


class _Lost:
    def __init__(self, noise: Noise, chance: np.random.Generator) -> None:
        self._noise, self._chance = noise, chance
        self._left: dict[str, int] = {}

    def __call__(self, topic: str) -> bool:
        noise, chance = self._noise, self._chance
        left = self._left.get(topic, 0)
        if left == 0 and chance.random() < noise.lost_in_runs_share / noise.run_messages:
            left = int(chance.geometric(1 / noise.run_messages))
        self._left[topic] = max(left - 1, 0)
        return left > 0 or chance.random() < noise.lost_share


def _measured(
    sample: Sample,
    start_s: float,
    noise: Noise,
    chance: np.random.Generator,
    offset_rad: np.ndarray,
    drift: np.ndarray,
) -> Any:
    message = sample.message
    if sample.topic.startswith("mocap/"):
        dx, dy, dz = chance.normal(0, noise.pose_m, 3)
        at, turn = message.pose.position, message.pose.orientation
        x, y, z, w = turn.x, turn.y, turn.z, turn.w
        a, b, c = chance.normal(0, noise.pose_rad / 2, 3)
        q = np.array(
            [
                w - a * x - b * y - c * z,
                x + a * w + b * z - c * y,
                y + b * w + c * x - a * z,
                z + c * w + a * y - b * x,
            ]
        )
        q /= np.linalg.norm(q)
        position = _Point(at.x + dx, at.y + dy, at.z + dz)
        pose = _Pose(position=position, orientation=_Quaternion(x=q[1], y=q[2], z=q[3], w=q[0]))
        return replace(message, pose=pose)
    if sample.topic.endswith("joint_states"):
        position = message.position + chance.normal(0, noise.joint_rad, len(message.position))
        arm, fingers = slice(len(offset_rad)), slice(len(offset_rad), len(offset_rad) + 2)
        position[arm] += offset_rad
        position[fingers] = message.position[fingers] + chance.normal(0, noise.finger_m, 2)
        return replace(message, position=position)
    if sample.topic.endswith("arm_controller/controller_state"):
        return replace(
            message,
            reference=replace(message.reference, positions=message.reference.positions + offset_rad),
            feedback=replace(message.feedback, positions=message.feedback.positions + offset_rad),
        )
    if sample.topic.endswith("odom"):
        at = message.pose.pose.position
        (dx, dy), passed_s = chance.normal(0, noise.odom_m, 2), sample.time_ns * 1e-9 - start_s
        position = replace(at, x=at.x * (1 + drift[0]) + dx, y=at.y * (1 + drift[1]) + dy + 1e-4 * passed_s)
        inner = replace(message.pose.pose, position=position)
        return replace(message, pose=replace(message.pose, pose=inner))
    return message
