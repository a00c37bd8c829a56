"""What a grip bears: an item at rest in the hand follows it without steps as long as the physics says so.

At the worst step of every ten the physics is asked for one step whether item and fingers would stay where
they are in the hand, with less friction than they have. The step is taken from the whole state with all its
contacts, so that whatever else is in the way is felt, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from rodeo.checks.motion.kinematics import HandPath, inverse, product, turned
from rodeo.evidence.series import Array
from rodeo.lab.world import TIMESTEP_S

EVERY = 10
"""Steps of 2 ms between two rows of a replay."""
STRETCH = 250
"""Steps that are taken together. Then the hand is put onto its path again: 10 N take it 0.01 mm from it by
then."""
_SPARE = 0.7
"""Share of the friction with which the grip must bear its load: the ensemble of replays goes down to 0.85."""
_PRESSING = 0.5
"""A grip that presses with less than this share of what it was last stepped with is stepped again."""
_AT_REST_M_S = 1e-3
_AT_REST_RAD_S = 1e-2
"""What moves no faster than this in the hand is at rest there; an honest grip creeps at a hundredth of it."""
_BORNE_M_S2 = 0.1
"""What the pads hold by friction follows the hand to this, a hundredth of gravity; what slides does not."""
_PRESSED_M_S2 = 1.5
"""The same along the fingers' way, and for the fingers: there the contact is a spring, which takes up another
load within micrometres."""
_BORNE_RAD_S2 = 2.0
"""`_BORNE_M_S2` at 5 cm."""
_LEVER_M = 0.05
"""What an angular acceleration asks of the grip, as a linear one: an item's radius."""


@dataclass(frozen=True, eq=False)
class Way:
    """What hand and fingers do, one row per step."""

    hand: HandPath
    speed: Array
    """(n, 6) what takes a free joint from each row to the next in one step: m/s in the map's frame, rad/s in
    the hand's"""
    control: Array
    """(n, 8) the hand's acceleration, then what is added to the fingers' springs, N"""

    @classmethod
    def of(cls, hand: HandPath, fingers_n: Array) -> Way:
        """`fingers_n` (n, 2)."""
        turn = hand.quaternion
        step = product(inverse(turn[:-1]), turn[1:])
        # The angle over the sine of its half, by the series of the arc sine: to 1e-8 at the 15 rad/s that all
        # joints of an arm make together. NumPy's own arc sine depends on what the processor can do.
        sine2 = (step[:, 1:] ** 2).sum(axis=1)
        scale = 2 + sine2 / 3 + 3 * sine2**2 / 20
        moves = np.empty((len(turn), 6))
        moves[:-1, :3] = np.diff(hand.position_m, axis=0)
        moves[:-1, 3:] = step[:, 1:] * scale[:, None]
        moves[-1] = moves[-2]
        speed = moves / TIMESTEP_S
        control = np.empty((len(turn), 8))
        control[0, :6] = 0.0
        control[1:, :6] = np.diff(speed, axis=0) / TIMESTEP_S
        control[:, 6:] = fingers_n
        return cls(hand, speed, control)

    def __len__(self) -> int:
        return len(self.speed)


@dataclass(frozen=True, eq=False)
class Rows:
    """What was found for some steps; arrays have one row per `EVERY` of them."""

    steps: int
    states: Array
    """(n, size) after the first of each ten"""
    sensors: Array
    """(n, sensors) at it; followed without steps the pads' are those at the worst of the ten"""
    state: Array
    """(size,) after the last step"""


class Grip:
    """One item in one hand, in a model with these joints and a sensor `item` of where that is."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, hand: str, fingers: list[str], item: str
    ) -> None:
        self._model, self._data = model, data
        seen = model.sensor("item").adr[0]
        self._seen = slice(seen, seen + 3)
        free, held = model.joint(hand), model.joint(item)
        slides = [model.joint(name) for name in fingers]
        # In a state, which is the time, all positions and all speeds.
        speeds = 1 + model.nq
        self.hand_qpos = slice(1 + free.qposadr[0], 8 + free.qposadr[0])
        self.hand_qvel = slice(speeds + free.dofadr[0], speeds + free.dofadr[0] + 6)
        self.item_qpos = slice(1 + held.qposadr[0], 8 + held.qposadr[0])
        self.item_qvel = slice(speeds + held.dofadr[0], speeds + held.dofadr[0] + 6)
        self.finger_qpos = [1 + int(slide.qposadr[0]) for slide in slides]
        self.finger_qvel = [speeds + int(slide.dofadr[0]) for slide in slides]
        self._hand_dof, self._item_dof = (slice(j.dofadr[0], j.dofadr[0] + 6) for j in (free, held))
        left = slides[0]
        self._closing = turned(model.body_quat[model.jnt_bodyid[left.id]], left.axis)
        """(3,) along which the fingers move, in the hand's frame"""

    def at_rest(self, state: Array) -> bool:
        """Whether neither item nor fingers move in the hand."""
        moves, turns = self._against_hand(state[None])
        return bool(
            np.linalg.norm(moves) < _AT_REST_M_S
            and np.linalg.norm(turns) < _AT_REST_RAD_S
            and np.abs(state[self.finger_qvel]).max() < _AT_REST_M_S
        )

    def pressing_n(self, way: Way, steps: slice, state: Array) -> Array:
        """(n,) what pushes the fingers together where they are in `state`, N."""
        pushes = way.control[steps, 6:] - self._model.actuator_biasprm[6:, 1] * -state[self.finger_qpos]
        return np.asarray((pushes[:, 1] - pushes[:, 0]) / 2)

    def carry(self, way: Way, steps: slice, state: Array, pressed_n: float) -> Rows:
        """Item and fingers where they are in the hand in `state`, up to the `STRETCH` that the grip does
        not bear. `pressed_n` is what the fingers pressed with when they were last stepped."""
        model = self._model
        place, turn = self._in_hand(state)
        push_n = self.pressing_n(way, steps, state)
        asks = self._asks(way, steps, place) / np.maximum(push_n, 1e-3)
        rows = np.arange(steps.start, steps.stop, EVERY)
        tens = np.full((len(rows), EVERY), -1.0)
        tens.flat[: len(asks)] = asks
        worst = rows + tens.argmax(axis=1)
        least_n = np.minimum.reduceat(push_n, rows - steps.start)

        friction = model.geom_friction.copy()
        model.geom_friction[:, 0] *= _SPARE
        after, sensors = rollout.rollout(
            model,
            self._data,
            self._followed(way, worst, state, place, turn),
            way.control[worst][:, None],
            initial_warmstart=self._accelerations(way, worst, place, turn),
        )
        model.geom_friction[:] = friction
        moves, turns = (change / TIMESTEP_S for change in self._against_hand(after[:, 0]))
        along = (moves * self._closing).sum(axis=1)
        across = np.linalg.norm(moves - along[:, None] * self._closing, axis=1)
        fingers = np.abs(after[:, 0, self.finger_qvel]).max(axis=1) / TIMESTEP_S
        borne = (
            (across < _BORNE_M_S2)
            & (np.maximum(np.abs(along), fingers) < _PRESSED_M_S2)
            & (np.linalg.norm(turns, axis=1) < _BORNE_RAD_S2)
            & (least_n > _PRESSING * pressed_n)
        )
        ten = STRETCH // EVERY
        count = len(rows) if borne.all() else int(borne.argmin()) // ten * ten
        end = min(steps.start + count * EVERY, steps.stop)
        # The state after a step is the one before the next.
        at = np.minimum(np.r_[rows[:count], rows[:count] + 1, end], len(way) - 1)
        states = self._followed(way, at, state, place, turn)
        sensors = sensors[:count, 0]
        sensors[:, self._seen] = states[:count, self.item_qpos][:, :3]
        return Rows(end - steps.start, states[count:-1], sensors, states[-1])

    def _in_hand(self, state: Array) -> tuple[Array, Array]:
        """Position (3,) and quaternion (4,) of the item in the hand."""
        hand, item = state[self.hand_qpos], state[self.item_qpos]
        back = inverse(hand[3:])
        return turned(back, item[:3] - hand[:3]), product(back, item[3:])

    def _against_hand(self, states: Array) -> tuple[Array, Array]:
        """(n, 3) speed and (n, 3) turning speed of the item in the hand, in the hand's frame."""
        hand, item = states[:, self.hand_qpos], states[:, self.item_qpos]
        hand_speed, item_speed = states[:, self.hand_qvel], states[:, self.item_qvel]
        back = inverse(hand[:, 3:])
        place = turned(back, item[:, :3] - hand[:, :3])
        moves = turned(back, item_speed[:, :3] - hand_speed[:, :3]) - np.cross(hand_speed[:, 3:], place)
        turns = turned(product(back, item[:, 3:]), item_speed[:, 3:]) - hand_speed[:, 3:]
        return moves, turns

    def _asks(self, way: Way, steps: slice, place: Array) -> Array:
        """(n,) what the motion asks of the grip at each step, m/s2."""
        turns, turning = way.speed[steps, 3:], way.control[steps, 3:6]
        pull = turned(inverse(way.hand.quaternion[steps]), way.control[steps, :3] - self._model.opt.gravity)
        pull += np.cross(turning, place) + turns * (turns * place).sum(axis=1)[:, None]
        pull -= place * (turns**2).sum(axis=1)[:, None]
        return np.asarray(np.linalg.norm(pull, axis=1) + _LEVER_M * np.linalg.norm(turning, axis=1))

    def _followed(self, way: Way, at: Array, state: Array, place: Array, turn: Array) -> Array:
        """(n, size) states before these steps with the item there in the hand, and fingers that stand."""
        position_m, quaternion = way.hand.position_m[at], way.hand.quaternion[at]
        speed = way.speed[np.maximum(at - 1, 0)]
        states = np.tile(state, (len(at), 1))
        states[:, self.hand_qpos] = np.hstack([position_m, quaternion])
        states[:, self.hand_qvel] = speed
        states[:, self.item_qpos] = np.hstack(
            [position_m + turned(quaternion, place), product(quaternion, turn)]
        )
        states[:, self.item_qvel] = np.hstack(
            [
                speed[:, :3] + turned(quaternion, np.cross(speed[:, 3:], place)),
                turned(inverse(turn), speed[:, 3:]),
            ]
        )
        states[:, self.finger_qvel] = 0.0
        return states

    def _accelerations(self, way: Way, at: Array, place: Array, turn: Array) -> Array:
        """(n, nv) of all joints if nothing moves in the hand: where the solver begins."""
        control, turns = way.control[at], way.speed[at, 3:]
        swing = np.cross(control[:, 3:6], place) + np.cross(turns, np.cross(turns, place))
        found = np.zeros((len(at), self._model.nv))
        found[:, self._hand_dof] = control[:, :6]
        found[:, self._item_dof] = np.hstack(
            [
                control[:, :3] + turned(way.hand.quaternion[at], swing),
                turned(inverse(turn), control[:, 3:6]),
            ]
        )
        return found
