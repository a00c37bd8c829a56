"""How wide the steps of the physics are: narrow where something is or may soon be touched, wide elsewhere.

A step costs the same at any width. A robot that drives, stands or charges far from anything loose comes out a
few millimetres elsewhere by wide ones, which whoever steers takes back; a moving arm, a grip and what falls
would come out otherwise. What is decided follows from the world's state alone.
"""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from rodeo.lab.arm import GRASP_SITE, ArmModel
from rodeo.lab.world import (
    CONTROL_PERIOD_S,
    CONTROL_STEPS,
    GRIPPER_OPEN_M,
    TIMESTEP_S,
    WHEEL_JOINTS,
)

WIDE_S = 0.009
"""Two of them and one of TIMESTEP_S make a control period: what is measured at its end, which MuJoCo takes
before a step, is as old as ever. The tyres' contacts, with a time constant of 50 ms, bear it."""
BASE_NEAR_M = 0.7
"""Between a base's centre and an item, over the floor: the base's corners are 0.59 m from it."""
HAND_NEAR_M = 0.3
"""Between where the pads meet and an item, over the floor."""
LOOSE_STILL = 1e-3
"""m/s or rad/s: what is loose rests below it."""
ARM_STILL_RAD_S = 0.05
"""Faster than this an arm moves, or something shakes it; driving sways a folded one by a third of that."""
FINGER_STILL_M_S = 2e-3
HOLDS_BELOW_M = GRIPPER_OPEN_M - 0.003
"""A finger further in may hold something."""

_WIDE_STEPS = round((CONTROL_PERIOD_S - TIMESTEP_S) / WIDE_S)


class Steps:
    """Steps one world with these robots.

    Args:
        loose: bodies that can be touched and moved, each with a free joint.
        reaching: whether an arm or a gripper is under way.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robots: Sequence[str],
        loose: Sequence[str],
        reaching: Callable[[], bool],
    ) -> None:
        self._model, self._data = model, data
        self._reaching = reaching
        self._still = np.full(model.nv, LOOSE_STILL)
        """(nv,) the most that each speed may be in a world that is stepped widely."""
        fingers = []
        for robot in robots:
            arm, base = ArmModel.of(model, f"{robot}/"), model.body(f"{robot}/base_link")
            for dof in np.flatnonzero(model.dof_bodyid == base.id):
                self._still[dof] = np.inf
            for names, most in (
                (WHEEL_JOINTS, np.inf),
                (arm.joints, ARM_STILL_RAD_S),
                (arm.fingers, FINGER_STILL_M_S),
            ):
                for name in names:
                    self._still[model.joint(f"{robot}/{name}").dofadr[0]] = most
            fingers += [model.joint(f"{robot}/{name}").qposadr[0] for name in arm.fingers]
        self._fingers = np.array(fingers, int)
        bases = [model.body(f"{robot}/base_link").id for robot in robots]
        self._hands = np.array([model.site(f"{robot}/{GRASP_SITE}").id for robot in robots], int)
        self._bases = len(bases)
        self._bodies = np.array([*bases, *(model.body(body).id for body in loose)], int)
        self._near_m2 = np.repeat([BASE_NEAR_M * BASE_NEAR_M, HAND_NEAR_M * HAND_NEAR_M], len(bases))

    @property
    def narrow(self) -> bool:
        """Whether something is or may soon be touched that counts, or moves that is no base."""
        data = self._data
        return bool(
            self._reaching()
            or (np.abs(data.qvel) > self._still).any()
            or (np.abs(data.qpos[self._fingers]) < HOLDS_BELOW_M).any()
            or self._near()
        )

    def _near(self) -> bool:
        # These are from before the last step: by a few millimetres of a moving base.
        bodies_m = self._data.xpos[self._bodies, :2]
        places_m = np.concatenate((bodies_m[: self._bases], self._data.site_xpos[self._hands, :2]))
        way_m = bodies_m[self._bases :, None] - places_m
        return bool(((way_m * way_m).sum(axis=2) < self._near_m2).any())

    def advance(self) -> None:
        """One control period."""
        model, data = self._model, self._data
        if self.narrow:
            mujoco.mj_step(model, data, nstep=CONTROL_STEPS)
            return
        model.opt.timestep = WIDE_S
        mujoco.mj_step(model, data, nstep=_WIDE_STEPS)
        model.opt.timestep = TIMESTEP_S
        mujoco.mj_step(model, data)
