"""How wide the steps of the physics are: narrow where something is or may soon be touched, wide elsewhere.

A step costs the same at any width. A robot that drives, stands or charges far from anything loose ends up a
few millimetres elsewhere by wide ones, which steering corrects. An arm in free air follows its servos to a
tenth of a milliradian at any width. A closing or opening grip and falling things would end up otherwise. The
decision follows from the world's state alone.
"""

import math
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from rodeo.lab.arm import GRASP_SITE, ArmModel
from rodeo.lab.body import numbers
from rodeo.lab.world import (
    CONTROL_PERIOD_S,
    GRIPPER_OPEN_M,
    TIMESTEP_S,
    WHEEL_JOINTS,
)

WIDE_S = CONTROL_PERIOD_S / 3
"""The tyres' contacts, with a time constant of 50 ms, bear it: a base that stops rocks for 0.2 s longer than
by steps of TIMESTEP_S. Of 10 ms it would be 0.5 s."""
HOLDING_S = CONTROL_PERIOD_S / 7
"""While something rests in a closed gripper. MuJoCo gives a contact a time constant of at least two steps: in
wider ones the pads, which have 6 ms, would be softer than in those of TIMESTEP_S, and give way."""
BASE_NEAR_M = 0.7
"""Between a moving base's centre and an item, over the floor: the base's corners are 0.59 m from it."""
HAND_NEAR_M = 0.25
"""Between where the pads meet and an item's centre."""
HAND_REACHES_M = 1.5
"""More than between a base's centre and its hand, over the floor."""
HELD_M = 0.08
"""The same of an item that a closed gripper holds."""
FASTEST_M_S = 5.0
"""Faster than a hand or a base and an item come nearer to each other."""
STANDING_SPEED = 0.01
"""m/s or rad/s: a base slower than this comes no nearer to anything within a period."""
REST_SPEED = 1e-3
"""m/s or rad/s: whatever has a joint rests below it, but for items."""
ITEM_REST_M_S, ITEM_REST_RAD_S = 5e-3, 0.1
"""The same of an item. In a bucket, soft contacts let several creep over each other for minutes,
at up to 2 mm/s and 0.06 rad/s. What falls, rolls or tips over is faster within some milliseconds."""
FINGER_STILL_M_S = 2e-3
HOLDS_BELOW_M = GRIPPER_OPEN_M - 0.003
"""A finger further in may hold something."""


class Steps:
    """Steps one world with these robots.

    Args:
        loose: bodies that can be touched and moved, each with a free joint.
        gripping: whether a gripper is under way.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robots: Sequence[str],
        loose: Sequence[str],
        gripping: Callable[[], bool],
    ) -> None:
        self._model, self._data = model, data
        self._gripping = gripping
        items = np.array([model.body(body).id for body in loose], int)
        ours = [_Robot(model, robot) for robot in robots]
        self._near = _Near(data, ours, (3 * items).tolist())
        self._item_dofs = model.body_dofadr[items][:, None] + np.arange(6)
        self._rest = np.full(model.nv, REST_SPEED)
        self._rest[self._item_dofs] = [ITEM_REST_M_S] * 3 + [ITEM_REST_RAD_S] * 3
        self._still = self._rest.copy()
        """(nv,) the most that each speed may be in a world that is not stepped narrowly."""
        for one in ours:
            self._still[one.free_dofs] = np.inf
            self._still[one.finger_dofs] = FINGER_STILL_M_S
        self._velocity, self._speed = data.qvel, np.empty(model.nv)
        self._looked_s: float | None = None
        """Step width for which the present world was looked at."""

    @property
    def rests(self) -> bool:
        """Whether nothing moves at all."""
        return bool((np.abs(self._velocity, self._speed) < self._rest).all())

    @property
    def width_s(self) -> float:
        """Width of all steps of the next control period."""
        if self._gripping():
            return TIMESTEP_S
        still, held = self._still, self._near.held()
        if held is None:
            return TIMESTEP_S
        if held:
            still = still.copy()
            still[self._item_dofs[held]] = np.inf
        if (np.abs(self._velocity, self._speed) > still).any():
            return TIMESTEP_S
        return HOLDING_S if held else WIDE_S

    def advance(self) -> None:
        """Simulate one control period, and compute positions and contacts at its end, because sensors measure
        the end of the period. The first step of the next period need not compute them again."""
        model, data, width_s = self._model, self._data, self.width_s
        self._near.pass_period()
        if width_s != self._looked_s:
            self._look(width_s)
        mujoco.mj_step2(model, data)
        mujoco.mj_step(model, data, nstep=round(CONTROL_PERIOD_S / width_s) - 1)
        mujoco.mj_step1(model, data)

    def look_again(self) -> None:
        """Something was put somewhere."""
        self._looked_s = None
        self._near.look_again()

    def _look(self, width_s: float) -> None:
        """How stiff a contact is depends on how wide the step is."""
        self._model.opt.timestep = self._looked_s = width_s
        mujoco.mj_step1(self._model, self._data)


class _Robot:
    """Where a robot's numbers are in the arrays of `mjData`."""

    def __init__(self, model: mujoco.MjModel, name: str) -> None:
        arm, base = ArmModel.of(model, f"{name}/"), model.body(f"{name}/base_link")
        self.base = 3 * int(base.id)
        """Where its base's x is in `xpos`."""
        self.hand = 3 * int(model.site(f"{name}/{GRASP_SITE}").id)
        """Where the x of the point where its pads meet is in `site_xpos`."""
        joints = {one: model.joint(f"{name}/{one}") for one in (*WHEEL_JOINTS, *arm.joints, *arm.fingers)}
        self.base_dofs = [int(base.dofadr[0]) + k for k in range(6)]
        self.fingers = [int(joints[one].qposadr[0]) for one in arm.fingers]
        self.finger_dofs = [int(joints[one].dofadr[0]) for one in arm.fingers]
        """Indices into `qvel`."""
        self.free_dofs = [
            *self.base_dofs, *(int(joints[one].dofadr[0]) for one in (*WHEEL_JOINTS, *arm.joints))
        ]  # fmt: skip
        """Indices into `qvel` of what may be as fast as it likes far from anything loose."""


class _Near:
    """Which items robots are near to, or hold.

    Args:
        items: where each one's x is in `mjData.xpos`.
    """

    def __init__(self, data: mujoco.MjData, robots: Sequence[_Robot], items: Sequence[int]) -> None:
        self._pairs = [(number, at, robot) for robot in robots for number, at in enumerate(items)]
        self._looks = [0] * len(self._pairs)
        """For each of them, the control period in which they can have come near to each other."""
        self._period = 0
        # Arrays of `data`, to read single numbers: see rodeo/lab/body.py.
        self._angle, self._rate = numbers(data.qpos), numbers(data.qvel)
        self._bodies_m, self._sites_m = numbers(data.xpos), numbers(data.site_xpos)

    def look_again(self) -> None:
        """Something was put somewhere."""
        self._looks = [0] * len(self._pairs)

    def pass_period(self) -> None:
        self._period += 1

    def held(self) -> list[int] | None:
        """Items that closed grippers hold; None where a robot is near another one."""
        held, period = list[int](), self._period
        for pair, look in enumerate(self._looks):
            if look > period:
                continue
            item, at, robot = self._pairs[pair]
            base_m = self._over_floor_m(at, robot)
            apart_m = base_m - HAND_REACHES_M
            if apart_m <= 0.0:
                hand_m = self._from_hand_m(at, robot)
                if hand_m < HELD_M and self._closed(robot):
                    held.append(item)
                elif hand_m < HAND_NEAR_M or (base_m < BASE_NEAR_M and self._drives(robot)):
                    return None
                apart_m = min(hand_m - HAND_NEAR_M, base_m - BASE_NEAR_M)
            self._looks[pair] = period + math.floor(apart_m / (FASTEST_M_S * CONTROL_PERIOD_S))
        return held

    def _over_floor_m(self, at: int, robot: _Robot) -> float:
        """Between item and base."""
        x_m = self._bodies_m[at] - self._bodies_m[robot.base]
        y_m = self._bodies_m[at + 1] - self._bodies_m[robot.base + 1]
        return math.sqrt(x_m * x_m + y_m * y_m)

    def _from_hand_m(self, at: int, robot: _Robot) -> float:
        bodies_m, sites_m, hand = self._bodies_m, self._sites_m, robot.hand
        x_m, y_m = bodies_m[at] - sites_m[hand], bodies_m[at + 1] - sites_m[hand + 1]
        z_m = bodies_m[at + 2] - sites_m[hand + 2]
        return math.sqrt(x_m * x_m + y_m * y_m + z_m * z_m)

    def _closed(self, robot: _Robot) -> bool:
        """Whether the robot's fingers may hold something."""
        return any(abs(self._angle[finger]) < HOLDS_BELOW_M for finger in robot.fingers)

    def _drives(self, robot: _Robot) -> bool:
        return any(abs(self._rate[dof]) > STANDING_SPEED for dof in robot.base_dofs)
