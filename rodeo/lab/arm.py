"""What a robot's model says of its arm: names, number and ranges of its joints, the hand and its fingers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rodeo.errors import ConfigError

GRASP_SITE = "grasp"
"""Where the pads meet; x points out of the hand, the fingers close along y."""

_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


@dataclass(frozen=True, eq=False)
class ArmModel:
    """Names are without the robot's prefix."""

    joints: tuple[str, ...]
    """From the base to the hand, each of them a hinge."""
    fingers: tuple[str, str]
    """Left, whose positions are positive, and right; each of them slides."""
    hand: str
    """The body that carries the fingers."""
    ranges_rad: np.ndarray
    """(len(joints), 2) lowest and highest position."""

    @classmethod
    def of(cls, model: mujoco.MjModel, prefix: str = "") -> ArmModel:
        """The arm that ends in GRASP_SITE. Raises ConfigError where that is no arm with two fingers."""
        chain: list[int] = []
        """Bodies from the base to the grasp."""
        body = int(model.site(prefix + GRASP_SITE).bodyid[0])
        while body != 0 and model.body(body).name != f"{prefix}base_link":
            chain.insert(0, body)
            body = int(model.body_parentid[body])
        joints = [joint for body in chain for joint in _joints_of(model, body)]
        sliding = [joint for joint in range(model.njnt) if model.jnt_type[joint] == _SLIDE]
        parents = {joint: int(model.body_parentid[model.jnt_bodyid[joint]]) for joint in sliding}
        hand = next((one for one in reversed(chain) if one in parents.values()), 0)
        fingers = [joint for joint in sliding if hand and parents[joint] == hand]
        fingers.sort(key=lambda joint: -model.jnt_range[joint].sum())
        if not joints or len(fingers) != 2 or any(model.jnt_type[joint] != _HINGE for joint in joints):
            raise ConfigError(
                "not a usable robot: it needs hinges from base_link to the grasp, and two fingers that slide "
                "on the hand",
                joints=_names(model, joints, prefix),
                fingers=_names(model, fingers, prefix),
            )
        left, right = _names(model, fingers, prefix)
        return cls(
            joints=tuple(_names(model, joints, prefix)),
            fingers=(left, right),
            hand=model.body(hand).name.removeprefix(prefix),
            ranges_rad=model.jnt_range[joints].copy(),
        )

    def posture(self, name: str, angles_rad: Sequence[float]) -> np.ndarray:
        """`angles_rad` of the site file's posture `name` as an array. Raises ConfigError unless there is one
        for each joint, within its range."""
        posture = np.array(angles_rad)
        if posture.shape != (len(self.joints),):
            raise ConfigError(
                "a posture has one angle for each joint of the arm",
                posture=name,
                angles=len(posture),
                joints=list(self.joints),
            )
        low, high = self.ranges_rad.T
        for outside in np.flatnonzero((posture < low) | (posture > high)):
            raise ConfigError(
                "a posture is outside a joint's range",
                posture=name,
                joint=self.joints[outside],
                angle_rad=float(posture[outside]),
            )
        return posture


def _joints_of(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _names(model: mujoco.MjModel, joints: Sequence[int], prefix: str) -> list[str]:
    return [model.joint(joint).name.removeprefix(prefix) for joint in joints]
