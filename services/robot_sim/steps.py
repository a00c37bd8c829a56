"""How wide the steps of the physics are: narrow where something is or may soon be touched, wide elsewhere.

A step costs the same at any width. A robot that drives, stands or charges far from anything loose comes out a
few millimetres elsewhere by wide ones, which whoever steers takes back. An arm in free air follows its servos
to a tenth of a milliradian at any width. A grip that closes or opens and what falls would come out otherwise.
What is decided follows from the world's state alone.
"""

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from rodeo.lab.arm import GRASP_SITE, ArmModel
from rodeo.lab.world import (
    CONTROL_PERIOD_S,
    GRIPPER_OPEN_M,
    TIMESTEP_S,
    WHEEL_JOINTS,
)
from services.robot_sim.touch import Touch

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
        item_dofs = model.body_dofadr[items][:, None] + np.arange(6)
        rest = np.full(model.nv, REST_SPEED)
        rest[item_dofs] = [ITEM_REST_M_S] * 3 + [ITEM_REST_RAD_S] * 3
        still = rest.copy()
        """(nv,) the most that each speed may be in a world that is not stepped narrowly."""
        base_dofs = np.empty((len(robots), 6), int)
        fingers = np.empty((len(robots), 2), int)
        for k, robot in enumerate(robots):
            arm, base = ArmModel.of(model, f"{robot}/"), model.body(f"{robot}/base_link")
            base_dofs[k] = base.dofadr[0] + np.arange(6)
            still[base_dofs[k]] = np.inf
            for name in (*WHEEL_JOINTS, *arm.joints, *arm.fingers):
                most = FINGER_STILL_M_S if name in arm.fingers else np.inf
                still[model.joint(f"{robot}/{name}").dofadr[0]] = most
            fingers[k] = [model.joint(f"{robot}/{name}").qposadr[0] for name in arm.fingers]
        self._touch = Touch(
            data,
            items,
            np.array([model.body(f"{robot}/base_link").id for robot in robots], int),
            np.array([model.site(f"{robot}/{GRASP_SITE}").id for robot in robots], int),
            item_dofs,
            base_dofs,
            fingers,
            rest,
            still,
            reach_m=HAND_REACHES_M,
            hand_near_m=HAND_NEAR_M,
            held_m=HELD_M,
            base_near_m=BASE_NEAR_M,
            standing_speed=STANDING_SPEED,
            holds_below_m=HOLDS_BELOW_M,
        )
        self._looked_s: float | None = None
        """For steps of which width the world was looked at as it is now."""

    @property
    def rests(self) -> bool:
        """Whether nothing moves at all."""
        return self._touch.rests()

    @property
    def width_s(self) -> float:
        """Of all steps of the next control period."""
        if self._gripping():
            return TIMESTEP_S
        touched, held = self._touch.state()
        if touched:
            return TIMESTEP_S
        return HOLDING_S if held else WIDE_S

    def advance(self) -> None:
        """One control period, up to a look at where everything is then and what it touches: all that is
        measured is of the period's end. The next one's first step need not look again."""
        model, data, width_s = self._model, self._data, self.width_s
        if width_s != self._looked_s:
            self._look(width_s)
        mujoco.mj_step2(model, data)
        mujoco.mj_step(model, data, nstep=round(CONTROL_PERIOD_S / width_s) - 1)
        mujoco.mj_step1(model, data)

    def look_again(self) -> None:
        """Something was put somewhere."""
        self._looked_s = None

    def _look(self, width_s: float) -> None:
        """How stiff a contact is depends on how wide the step is."""
        self._model.opt.timestep = self._looked_s = width_s
        mujoco.mj_step1(self._model, self._data)
