"""The recorded motion, moved again through the physics of the site's lab.

What was measured is followed, what was not is simulated. The lab is built from the site file with the task's
item alone, placed where motion capture last saw it before the gripper closed. The hand goes where pose and
joints of the robot took it, as if it were too heavy for anything to hold up; `Kinematics.deepest` says if
something was in the way of the robot. The fingers get their recorded effort, with a soft pull towards their
recorded positions; the item is moved by contact and gravity only. So a recording shows work exactly if the
same motion does the work again.

An item at rest in the hand is not stepped while the grip bears the forces of the motion; the physics computes
those, too (`grip`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
from mujoco import rollout
from scipy.interpolate import PchipInterpolator

from rodeo.checks.case import Case, CaseError
from rodeo.checks.counts import COUNTS
from rodeo.checks.motion.grip import EVERY, STRETCH, Grip, Rows, Way
from rodeo.checks.motion.kinematics import HandPath, Kinematics, fixtures, kinematics_of, reduce_to_solids
from rodeo.checks.motion.phases import HELD_S, LIFTED_M, Phases, phases_of
from rodeo.checks.motion.poses import pose_of, sighting
from rodeo.checks.results import once_per_case
from rodeo.checks.tables import increasing, joints_of
from rodeo.evidence.series import Array
from rodeo.lab.arm import GRASP_SITE, ArmModel
from rodeo.lab.items import MeasuredItem
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import (
    TIMESTEP_S,
    arm_model,
    robot_spec,
    world_spec,
)

BEFORE_CLOSING_S = 0.3
HELD_SHARE = 0.9
"""Share of the time after the lift with both pads on the item: a contact may flicker while it settles."""
LAY_S = 1.0
"""Over which it is looked at where the item lay, before the gripper closes."""
BEFORE_RELEASE_S = 0.5
SETTLE_S = 1.0
"""Replayed after the recorded item came to rest."""

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_HAND = "hand"
_HAND_KG = 1e5
"""Also its moments of inertia, kg m2. Much more, and the solver's numbers are too far apart."""
_LONGEST_CARRY = 32
"""Stretches that are asked about at once. Each yes doubles the next question, and a no makes it one stretch
again, so that a grip that fails again and again costs a fifth more than stepping it."""
_SOLVED_KG = 1.0
"""Inertia that the solver's tolerance is scaled by: the item's and the fingers', rather than the hand's."""
_ASLEEP_M_S = 1e-3
"""Slower than this (or rad/s) item and fingers rest."""
_STILL = 1e-4
"""A hand that does not leave this (m, and of its quaternion) stands still."""
_FINGER_STIFFNESS_N_M = 500.0
"""Soft enough that 1 mm of disagreement adds 0.5 N to the recorded effort."""
_FINGER_DAMPING_N_S_M = 10.0


@dataclass(frozen=True)
class Perturbation:
    """Small errors of measurement and of the model, for one replay."""

    item_m: tuple[float, float] = (0.0, 0.0)
    """Item beside where motion capture had it; its markers are on its outside."""
    arm_rad: tuple[float, ...] = ()
    """Encoders' zero, of each joint; empty for none."""
    friction: float = 1.0
    """Times the model's."""
    effort: float = 1.0
    """Times the recorded effort of the fingers."""


@cache
def ensemble(joints: int) -> tuple[Perturbation, ...]:
    """Perturbations for an arm with this number of joints: none, then 1.5 mm of motion capture, half a
    milliradian of encoders, 15 % of friction and 10 % of effort. Every proof gets the same ones, so that
    anybody gets the same result."""
    return (
        Perturbation(),
        *(
            Perturbation(
                item_m=tuple(rng.normal(0, 0.0015, 2)),
                arm_rad=tuple(rng.normal(0, 0.0005, joints)),
                friction=rng.uniform(0.85, 1.15),
                effort=rng.uniform(0.9, 1.1),
            )
            for rng in (np.random.default_rng(number) for number in range(1, 5))
        ),
    )


SIGHTINGS = (
    Perturbation(),
    *(
        Perturbation(item_m=(radius_m * math.cos(turn), radius_m * math.sin(turn)))
        for radius_m in (0.005, 0.010, 0.015)
        for turn in np.arange(8) * (math.pi / 4)
    ),
)
"""Where an item may lie that a depth camera saw from above, the likeliest first: to 1.5 cm, as its picture
elements and the way back to the map allow. An item that the gripper finds nowhere there was not taken."""


def ensemble_around(perturbation: Perturbation, joints: int) -> tuple[Perturbation, ...]:
    """`ensemble` beside the place that `perturbation` found for the item."""
    x_m, y_m = perturbation.item_m
    return tuple(replace(m, item_m=(m.item_m[0] + x_m, m.item_m[1] + y_m)) for m in ensemble(joints))


@dataclass(frozen=True)
class Vote:
    """How many of how many replays did the work."""

    succeeded: int
    run: int


@dataclass(frozen=True, eq=False)
class Motion:
    """What is replayed; arrays have one row per 2 ms."""

    phases: Phases
    time_s: Array
    """(n,)"""
    kinematics: Kinematics
    hand: HandPath
    """The hand's path in n rows."""
    fingers_m: Array
    """(n, 2)"""
    finger_speed_m_s: Array
    """(n, 2)"""
    effort_n: Array
    """(n, 2) of the fingers"""
    item_m: Array
    """(3,) where the item lay"""
    item_quat: Array
    """(4,) w, x, y, z"""

    def hand_by(self, perturbation: Perturbation, rows: slice, from_s: float = -math.inf) -> HandPath:
        """The hand with the perturbation's encoders `from_s` on."""
        if not any(perturbation.arm_rad):
            return HandPath(self.hand.position_m[rows], self.hand.quaternion[rows])
        return self.kinematics.hand_path(self.time_s[rows], np.array(perturbation.arm_rad), from_s)


@dataclass(frozen=True, eq=False)
class Replay:
    """What physics made of the recording; arrays have one row per 20 ms."""

    phases: Phases
    time_s: Array
    """(n,)"""
    item_m: Array
    """(n, 3) the item's centre in frame `map`"""
    item_in_gripper_m: Array
    """(n, 3) the same in the gripper's frame"""
    pad_force_n: Array
    """(n, 2) normal force of the left and right pad on the item"""
    placed_m: Array
    """(3,) where the item was placed, from motion capture"""
    perturbation: Perturbation
    motion: Motion
    world: World
    states: Array
    """(n, size) full states of the physics"""

    @property
    def held(self) -> Array:
        """(n,) whether both pads press on the item."""
        return np.asarray((self.pad_force_n > 0).all(axis=1))

    @property
    def picked(self) -> bool:
        """Whether the item is off the floor and between the pads some time after the recorded lift."""
        after = (self.time_s > self.phases.lifted_s) & (self.time_s <= self.phases.lifted_s + HELD_S)
        rise_m = self.item_m[after, 2] - self.placed_m[2]
        return bool(after.any() and rise_m[-1] > LIFTED_M / 2 and self.held[after].mean() > HELD_SHARE)

    @property
    def release_s(self) -> float:
        """When both pads last pressed on the item. Raises CaseError if they never did."""
        held = np.flatnonzero(self.held)
        if not len(held):
            raise CaseError("the gripper never holds the item in the replay")
        return float(self.time_s[held[-1]])


@once_per_case
def replay_of(case: Case) -> Replay:
    """Replay the carry of the task's item. Raises CaseError when the recording shows none.

    With the item exactly where motion capture had it, or, if the gripper misses it there, with the first of
    `ensemble` in which it does not.
    """
    joints = joints_of(case)
    joint_time_s = increasing(joints)
    arm = arm_model(case.robot.kinematics)
    fingers_m = joints.named("position", list(arm.fingers))
    phases = phases_of(case)
    if case.unmarked:
        case.item  # noqa: B018 - a place that is none is the creator's failure, before what the robot saw
    lay = _signed_pose if case.tracked else sighting
    item_m, item_quat = lay(case, phases.closing_s)
    if isinstance(case.item, MeasuredItem):
        item_m = np.array([*item_m[:2], case.item.size_m[2] / 2])
    known_s = kinematics_of(case).time_s
    start_s = max(phases.closing_s - BEFORE_CLOSING_S, known_s[0])
    end_s = min(phases.rest_s + SETTLE_S, known_s[-1])
    if start_s > phases.lifted_s:
        raise CaseError(
            "where the robot stood is not recorded before the item is lifted",
            lifted_s=phases.lifted_s,
            recorded_from_s=round(float(start_s), 2),
        )
    if not 0 < end_s - start_s <= COUNTS.carried_s:
        raise CaseError(
            "the carry is not recorded, or is longer than a proof may hold",
            carried_s=round(end_s - start_s, 2),
            limit_s=COUNTS.carried_s,
        )
    time_s = np.arange(start_s, end_s, TIMESTEP_S)

    fingers = PchipInterpolator(joint_time_s, fingers_m)
    effort = joints.named("effort", list(arm.fingers))
    motion = Motion(
        phases=phases,
        time_s=time_s,
        kinematics=kinematics_of(case),
        hand=kinematics_of(case).hand_path(time_s, np.zeros(len(arm.joints))),
        fingers_m=fingers(time_s),
        finger_speed_m_s=fingers.derivative()(time_s),
        effort_n=np.stack([np.interp(time_s, joint_time_s, column) for column in effort.T], axis=1),
        item_m=item_m,
        item_quat=item_quat,
    )
    world = World(case)
    guesses = ensemble(len(arm.joints)) if case.tracked else SIGHTINGS
    exact = world.run(motion, guesses[0])
    if exact.picked:
        return exact
    until_s = phases.lifted_s + HELD_S
    perturbation = next(
        (perturbation for perturbation in guesses[1:] if world.run(motion, perturbation, until_s).picked),
        None,
    )
    return exact if perturbation is None else world.run(motion, perturbation)


def _signed_pose(case: Case, before_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion of the item as it lay, by motion capture. Raises CaseError."""
    item = pose_of(case, case.item.id)
    seen = np.flatnonzero(item.time_s <= before_s)
    if not len(seen):
        raise CaseError("motion capture did not sign where the item lay", before_s=before_s)
    # Of the last poses, as single ones are a little off.
    last = seen[item.time_s[seen] > item.time_s[seen[-1]] - LAY_S]
    quaternion = item.quaternion[last].mean(axis=0)
    return np.median(item.position_m[last], axis=0), quaternion / np.linalg.norm(quaternion)


@once_per_case
def vote_of(case: Case) -> Vote:
    """How many of several replays with small errors do the work; ended as soon as the majority is clear.

    Each picks the item up from the floor and, from half a second before the replay's release on, drops it.
    Raises what `replay_of` raises.
    """
    found = replay_of(case)
    wanted = compartment_at(case, found.item_m[-1])
    joints = len(arm_model(case.robot.kinematics).joints)
    members = ensemble(joints) if case.tracked else ensemble_around(found.perturbation, joints)
    succeeded = failed = 0
    for perturbation in members:
        if max(succeeded, failed) > len(members) // 2:
            break
        if perturbation == found.perturbation:
            fell = found.picked and wanted is not None
        elif members.index(perturbation) < members.index(found.perturbation):
            fell = False  # tried before, and missed
        else:
            picked = found.world.run(found.motion, perturbation, found.phases.lifted_s + HELD_S).picked
            fell = (
                picked and compartment_at(case, found.world.drop(found, perturbation)) == wanted is not None
            )
        succeeded, failed = succeeded + fell, failed + (not fell)
    return Vote(succeeded, succeeded + failed)


def compartment_at(case: Case, point_m: Array) -> str | None:
    """The bin's compartment that a point of frame `map` (3,) is in."""
    return BinLayout(case.bin).compartment_at(point_m)


class World:
    """The lab with one item and the robot's hand, which follows its path whatever it meets."""

    def __init__(self, case: Case) -> None:
        robot, item = case.robot, case.item
        prefix = f"{robot.name}/"
        spec = world_spec(SimpleNamespace(**fixtures(case), items=[item], robots=[]))
        arm = arm_model(robot.kinematics)
        _add_hand(spec, robot_spec(robot), arm, prefix)
        reduce_to_solids(spec, case)
        self._fingers = [prefix + name for name in arm.fingers]
        for axis in np.eye(6):
            motor = spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target=_HAND, gear=axis)
            # The control is an acceleration.
            motor.gainprm[0] = _HAND_KG
        for name in self._fingers:
            spec.joint(name).actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            spec.joint(name).limited = mujoco.mjtLimited.mjLIMITED_FALSE
            servo = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
            servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            servo.biasprm[1:3] = -_FINGER_STIFFNESS_N_M, -_FINGER_DAMPING_N_S_M
        _add_sensors(spec, prefix, item.id)
        self.model = spec.compile()
        self.model.stat.meaninertia = _SOLVED_KG
        self.data = mujoco.MjData(self.model)
        self._replayed_s = 0.0
        self._grip = Grip(self.model, self.data, _HAND, self._fingers, item.id)
        self._sensor = {
            self.model.sensor(i).name: slice(a, a + d)
            for i, (a, d) in enumerate(zip(self.model.sensor_adr, self.model.sensor_dim, strict=True))
        }
        self._new = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, self._new, _STATE)

    def run(self, motion: Motion, perturbation: Perturbation, until_s: float = math.inf) -> Replay:
        """Move the physics over the motion (2 ms apart) from the item on the floor, up to `until_s`."""
        rows, grip = slice(0, int(np.searchsorted(motion.time_s, until_s))), self._grip
        state = self._new.copy()
        state[grip.finger_qpos] = motion.fingers_m[0]
        state[grip.finger_qvel] = motion.finger_speed_m_s[0]
        state[grip.item_qpos] = (*np.add(motion.item_m, (*perturbation.item_m, 0.0)), *motion.item_quat)
        states, sensors = self._roll(motion, perturbation, rows, motion.hand_by(perturbation, rows), state)
        return Replay(
            phases=motion.phases,
            time_s=motion.time_s[rows][::EVERY],
            item_m=sensors[:, self._sensor["item"]],
            item_in_gripper_m=sensors[:, self._sensor["item_in_gripper"]],
            pad_force_n=self._pads_n(sensors),
            placed_m=motion.item_m,
            perturbation=perturbation,
            motion=motion,
            world=self,
            states=states,
        )

    def drop(self, found: Replay, perturbation: Perturbation) -> Array:
        """(3,) where the item comes to rest when `found` continues, perturbed from before its release."""
        row = max(int(np.searchsorted(found.time_s, found.release_s - BEFORE_RELEASE_S)) - 1, 0)
        rows = slice(row * EVERY + 1, len(found.motion.time_s))
        hand = found.motion.hand_by(perturbation, rows, float(found.motion.time_s[rows.start]))
        _, sensors = self._roll(found.motion, perturbation, rows, hand, found.states[row])
        return np.asarray(sensors[-1, self._sensor["item"]])

    def _pads_n(self, sensors: Array) -> Array:
        """(n, 2) force of the left and right pad on the item."""
        forces = (sensors[:, self._sensor[pad]] for pad in ("left_pad", "right_pad"))
        return np.stack([np.linalg.norm(force, axis=1) for force in forces], axis=1)

    def _roll(
        self, motion: Motion, perturbation: Perturbation, rows: slice, hand: HandPath, state: Array
    ) -> tuple[Array, Array]:
        """States after and sensors at every tenth step, from `state` on."""
        way = Way.of(
            hand,
            motion.effort_n[rows] * perturbation.effort
            + motion.fingers_m[rows] * _FINGER_STIFFNESS_N_M
            + motion.finger_speed_m_s[rows] * _FINGER_DAMPING_N_S_M,
        )
        lifted = int(np.searchsorted(motion.time_s[rows], motion.phases.lifted_s + HELD_S))
        count = len(range(0, len(way), EVERY))
        states, sensors = np.empty((count, len(state))), np.empty((count, self.model.nsensordata))
        friction = self.model.geom_friction.copy()
        self.model.geom_friction[:, 0] *= perturbation.friction
        begin, row, ahead, pressed_n = 0, 0, 1, 0.0
        while begin < len(way):
            stretch = slice(begin, min(begin + STRETCH, len(way)))
            found = None
            if begin and self._asleep(state, way, begin):
                count = len(range(begin, stretch.stop, EVERY))
                felt = sensors[row - 1]
                found = Rows(
                    stretch.stop - begin, np.tile(state, (count, 1)), np.tile(felt, (count, 1)), state
                )
            elif begin > lifted and self._rests_in_hand(state, sensors[row - 1]):
                asked = slice(begin, min(begin + ahead * STRETCH, len(way)))
                found = self._grip.carry(way, asked, state, pressed_n)
                ahead = min(2 * ahead, _LONGEST_CARRY) if begin + found.steps == asked.stop else 1
            if found is None or not found.steps:
                found = self._step(way, stretch, state)
                pressed_n = float(self._grip.pressing_n(way, stretch, found.state).min())
            states[row : row + len(found.states)] = found.states
            sensors[row : row + len(found.states)] = found.sensors
            state = found.state
            begin, row = begin + found.steps, row + len(found.states)
        self.model.geom_friction[:] = friction
        # What a hand presses into the floor bursts: then it is nowhere, and was not picked up.
        states, sensors = (np.nan_to_num(found, posinf=0.0, neginf=0.0) for found in (states, sensors))
        return states, sensors

    def _step(self, way: Way, steps: slice, state: Array) -> Rows:
        """The physics itself from `state` on, its hand on the path at the first of these steps."""
        state, begin = state.copy(), steps.start
        state[self._grip.hand_qpos] = (*way.hand.position_m[begin], *way.hand.quaternion[begin])
        state[self._grip.hand_qvel] = way.speed[max(begin - 1, 0)]
        self._replayed_s += TIMESTEP_S * (steps.stop - begin)
        if self._replayed_s > COUNTS.replayed_s:
            raise CaseError("the replay needs more seconds than a proof may take", limit_s=COUNTS.replayed_s)
        states, sensors = rollout.rollout(self.model, self.data, state, way.control[None, steps])
        return Rows(len(states[0]), states[0, ::EVERY], sensors[0, ::EVERY], states[0, -1])

    def _rests_in_hand(self, state: Array, sensors: Array) -> bool:
        """Whether both pads press on an item that moves with them."""
        return bool((self._pads_n(sensors[None]) > 0).all()) and self._grip.at_rest(state)

    def _asleep(self, state: Array, way: Way, begin: int) -> bool:
        """Whether nothing moves, and nothing is moved in the stretch before `begin` or in the one after: then
        it needs no steps, as MuJoCo lets bodies sleep."""
        both = slice(begin - STRETCH, begin + STRETCH)
        moving = state[[*self._grip.finger_qvel, *range(*self._grip.item_qvel.indices(len(state)))]]
        return bool(
            np.abs(moving).max() < _ASLEEP_M_S
            and np.ptp(way.hand.position_m[both], axis=0).max() < _STILL
            and np.ptp(way.hand.quaternion[both], axis=0).max() < _STILL
            and np.ptp(way.control[both, 6:], axis=0).max() < _STILL * _FINGER_STIFFNESS_N_M
        )


def _add_hand(spec: mujoco.MjSpec, robot: mujoco.MjSpec, arm: ArmModel, prefix: str) -> None:
    """The robot's hand with its fingers, free of its arm, too heavy for anything to move."""
    for kind in (robot.actuators, robot.sensors, robot.tendons, robot.excludes):
        for element in list(kind):
            robot.delete(element)
    hand = robot.joint(arm.fingers[0]).parent.parent
    for joint in list(hand.joints):
        robot.delete(joint)
    body = spec.worldbody.add_frame().attach_body(hand, prefix)
    body.pos, body.quat = [0, 0, 0], [1, 0, 0, 0]
    body.mass, body.explicitinertial, body.inertia = _HAND_KG, True, [_HAND_KG] * 3
    body.ipos, body.iquat, body.gravcomp = [0, 0, 0], [1, 0, 0, 0], 1
    body.add_freejoint(name=_HAND)


def _add_sensors(spec: mujoco.MjSpec, prefix: str, item_id: str) -> None:
    kind, obj = mujoco.mjtSensor, mujoco.mjtObj
    spec.add_sensor(name="item", type=kind.mjSENS_FRAMEPOS, objtype=obj.mjOBJ_BODY, objname=item_id)
    spec.add_sensor(
        name="item_in_gripper",
        type=kind.mjSENS_FRAMEPOS,
        objtype=obj.mjOBJ_BODY,
        objname=item_id,
        reftype=obj.mjOBJ_SITE,
        refname=prefix + GRASP_SITE,
    )
    for pad in ("left_pad", "right_pad"):
        spec.add_sensor(
            name=pad,
            type=kind.mjSENS_CONTACT,
            objtype=obj.mjOBJ_GEOM,
            objname=prefix + pad,
            reftype=obj.mjOBJ_BODY,
            refname=item_id,
            # The net force of all contacts between the two, in the world's frame.
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1],
        )
