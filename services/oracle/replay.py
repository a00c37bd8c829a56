"""The recorded motion, moved again through the physics of the site's lab.

The world is built from the site file with the task's item alone, placed where motion capture last saw it
before the gripper closed. Base and arm follow their recorded positions on stiff servos; the fingers get their
recorded effort, with a soft pull towards their recorded positions; the item is moved by contact and gravity
only. So a recording shows work exactly if the same motion does the work again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import mujoco
import numpy as np
from mujoco import rollout
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from rodeo.evidence.series import Array
from rodeo.lab.config import Pose2
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import (
    ARM_JOINTS,
    FINGER_JOINTS,
    GRASP_SITE,
    GRIPPER_CLOSED_M,
    TIMESTEP_S,
    WHEEL_JOINTS,
    robot_model,
    world_spec,
)
from rodeo.topics import GRIPPER_STATE
from services.oracle.case import Case, CaseError, Pose, increasing

LIFTED_M = 0.05
"""An item this far above where it lay has left the floor."""
BEFORE_CLOSING_S = 0.3
CLOSING_SEARCH_S = 15.0
"""The gripper takes no longer to close. How long it then stands before the lift says nothing about the work:
an agent on a busy machine may think for long."""
CLOSED_M = 0.001
"""A gripper that closes by less than this closes on nothing."""
HELD_S = 1.0
"""For so long after the lift an item must stay in the gripper to count as picked up."""
HELD_SHARE = 0.9
"""Of that time with both pads on it: a contact may flicker while it settles."""
BEFORE_RELEASE_S = 0.5
SETTLE_S = 1.0
"""Replayed after the recorded item came to rest."""
FALL_S = 1.0
"""From the opening of the fingers until the item lies, where nobody saw it."""
LONGEST_S = 600.0
"""No carry across one room takes longer; bounds what a proof can make the oracle compute."""

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_BASE_JOINTS = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")
_SERVO_RAD_S = 200.0
"""Natural frequency of the servos: an acceleration a leaves an error of a / 200**2, 0.05 mm at 2 m/s2."""
_FINGER_STIFFNESS_N_M = 500.0
"""Soft enough that 1 mm of disagreement adds 0.5 N to the recorded effort."""
_FINGER_DAMPING_N_S_M = 10.0


@dataclass(frozen=True)
class Phases:
    """When the recorded task happened, s of site time."""

    closing_s: float
    """The gripper begins to close on the item."""
    lifted_s: float
    """The item has left the floor."""
    rest_s: float
    """The item lies still for good."""


@dataclass(frozen=True)
class Chance:
    """Small errors of measurement and of the model, for one replay."""

    item_m: tuple[float, float] = (0.0, 0.0)
    """Item beside where motion capture had it; its markers are on its outside."""
    arm_rad: tuple[float, ...] = (0.0,) * len(ARM_JOINTS)
    """Encoders' zero."""
    friction: float = 1.0
    """Times the model's."""
    effort: float = 1.0
    """Times the recorded effort of the fingers."""


MEMBERS = (
    Chance(),
    *(
        Chance(
            item_m=tuple(chance.normal(0, 0.0015, 2)),
            arm_rad=tuple(chance.normal(0, 0.0005, len(ARM_JOINTS))),
            friction=chance.uniform(0.85, 1.15),
            effort=chance.uniform(0.9, 1.1),
        )
        for chance in (np.random.default_rng(number) for number in range(1, 5))
    ),
)
"""Of the ensemble: none, then 1.5 mm of motion capture, half a milliradian of encoders, 15 % of friction and
10 % of effort. The same ones for every proof, so that anybody gets the same result."""


SIGHTINGS = (
    Chance(),
    *(
        Chance(item_m=(radius_m * math.cos(turn), radius_m * math.sin(turn)))
        for radius_m in (0.005, 0.010, 0.015)
        for turn in np.arange(8) * (math.pi / 4)
    ),
)
"""Where an item may lie that a depth camera saw from above, the likeliest first: to 1.5 cm, as its picture
elements and the way back to the map allow. An item that the gripper finds nowhere there was not taken."""


def around(chance: Chance) -> tuple[Chance, ...]:
    """`MEMBERS` beside the place that `chance` found for the item."""
    x_m, y_m = chance.item_m
    return tuple(replace(m, item_m=(m.item_m[0] + x_m, m.item_m[1] + y_m)) for m in MEMBERS)


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
    path: Array
    """(n, 14) coordinates of base, arm and fingers"""
    speed: Array
    """(n, 14) their rates"""
    effort: Array
    """(n, 2) of the fingers, N"""
    item_m: Array
    """(3,) where the item lay"""
    item_quat: Array
    """(4,) w, x, y, z"""


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
    tracking_error_m: float
    """Largest distance between the replayed and the recorded base; large if something held it."""
    chance: Chance
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


def replay(case: Case) -> Replay:
    """Replay the carry of the task's item. Raises CaseError when the recording shows none.

    With the item exactly where motion capture had it, or, if the gripper misses it there, with the first of
    `MEMBERS` in which it does not.
    """
    base, joints = case.base, case.joints
    joint_time_s = increasing(joints)
    fingers_m = joints.named("position", list(FINGER_JOINTS))
    if case.mocap:
        item = case.pose(case.item.id)
        phases = find_phases(item, joint_time_s, (fingers_m[:, 0] - fingers_m[:, 1]) / 2)
        signed = np.flatnonzero(case.witnessed(case.item.id) & (item.time_s <= phases.closing_s))
        if not len(signed):
            raise CaseError("motion capture did not sign where the item lay", before_s=phases.closing_s)
        item_m, item_quat = item.position_m[signed[-1]], item.quaternion[signed[-1]]
    else:
        phases = felt_phases(case)
        item_m, item_quat = case.sighting(phases.closing_s)
    start_s = max(phases.closing_s - BEFORE_CLOSING_S, joint_time_s[0], base.time_s[0])
    end_s = min(phases.rest_s + SETTLE_S, joint_time_s[-1], base.time_s[-1])
    if not 0 < end_s - start_s <= LONGEST_S:
        raise CaseError("the carry is absurdly long or not recorded", start_s=start_s, end_s=end_s)
    time_s = np.arange(start_s, end_s, TIMESTEP_S)

    arm = PchipInterpolator(joint_time_s, joints.named("position", list(ARM_JOINTS)))
    fingers = PchipInterpolator(joint_time_s, fingers_m)
    effort = np.stack(
        [np.interp(time_s, joint_time_s, e) for e in joints.named("effort", list(FINGER_JOINTS)).T], axis=1
    )
    parts = _base_path(base), arm, fingers
    motion = Motion(
        phases=phases,
        time_s=time_s,
        path=np.hstack([part(time_s) for part in parts]),
        speed=np.hstack([part.derivative()(time_s) for part in parts]),
        effort=effort,
        item_m=item_m,
        item_quat=item_quat,
    )
    world = World(case)
    guesses = MEMBERS if case.mocap else SIGHTINGS
    exact = world.run(motion, guesses[0])
    if exact.picked:
        return exact
    until_s = phases.lifted_s + HELD_S
    chance = next((chance for chance in guesses[1:] if world.run(motion, chance, until_s).picked), None)
    return exact if chance is None else world.run(motion, chance)


def vote(case: Case, found: Replay) -> Vote:
    """How many of several replays with small errors do the work; ended as soon as the majority is clear.

    Each picks the item up from the floor and, from half a second before the release in `found` on, drops it.
    """
    wanted = compartment_at(case, found.item_m[-1])
    members = MEMBERS if case.mocap else around(found.chance)
    succeeded = failed = 0
    for chance in members:
        if max(succeeded, failed) > len(MEMBERS) // 2:
            break
        if chance == found.chance:
            fell = found.picked and wanted is not None
        elif members.index(chance) < members.index(found.chance):
            fell = False  # tried before, and missed
        else:
            picked = found.world.run(found.motion, chance, found.phases.lifted_s + HELD_S).picked
            fell = picked and compartment_at(case, found.world.drop(found, chance)) == wanted is not None
        succeeded, failed = succeeded + fell, failed + (not fell)
    return Vote(succeeded, succeeded + failed)


def compartment_at(case: Case, point_m: Array) -> str | None:
    """The bin's compartment that a point of frame `map` (3,) is in."""
    layout, (x_m, y_m, z_m) = BinLayout(case.site.bin), map(float, point_m)
    return next((name for name in case.site.bin.compartments if layout.contains(name, (x_m, y_m, z_m))), None)


def find_phases(item: Pose, joint_time_s: Array, gripper_m: Array) -> Phases:
    """When the item was gripped, lifted and left, from its poses and the gripper's half gap (n,).

    Raises CaseError when the item never leaves the floor or the gripper does not close before.
    """
    z = item.position_m[:, 2]
    lifted = np.flatnonzero(z > z[0] + LIFTED_M)
    if not len(lifted):
        raise CaseError("the item never leaves the floor", rise_m=round(float(z.max() - z[0]), 4))
    lifted_s = float(item.time_s[lifted[0]])
    before = joint_time_s <= lifted_s
    if not before.any():
        raise CaseError("the joints were not recorded when the item was lifted", lifted_s=lifted_s)
    gaps, times = gripper_m[before], joint_time_s[before]
    wider = np.flatnonzero(gaps > gaps[-1] + CLOSED_M)
    if not len(wider):
        closes_by_m = round(float(gaps.max() - gaps[-1]), 4)
        raise CaseError("the gripper does not close before the item is lifted", closes_by_m=closes_by_m)
    closes = (times <= times[wider[-1]]) & (times > times[wider[-1]] - CLOSING_SEARCH_S)
    closing_s = float(times[closes][np.flatnonzero(gaps[closes] > gaps[closes].max() - 0.0005)[-1]])
    moved = np.linalg.norm(item.position_m - item.position_m[-1], axis=1) > 0.005
    rest_s = float(item.time_s[np.flatnonzero(moved)[-1]])
    return Phases(closing_s, lifted_s, rest_s)


def felt_phases(case: Case) -> Phases:
    """The same from what the gripper felt: it was commanded to close, something kept it from doing so, and it
    rose with that. Raises CaseError."""
    state = case.table(GRIPPER_STATE, ns=case.robot.namespace)
    time_s, joint_time_s = increasing(state), increasing(case.joints)
    reference_m = state.named("reference.positions", list(FINGER_JOINTS), "joint_names")
    wanted_m = np.maximum((reference_m[:, 0] - reference_m[:, 1]) / 2, GRIPPER_CLOSED_M)
    fingers_m = case.joints.named("position", list(FINGER_JOINTS))
    gap_m = np.interp(time_s, joint_time_s, (fingers_m[:, 0] - fingers_m[:, 1]) / 2)
    arm_rad = case.joints.named("position", list(ARM_JOINTS))
    height_m = _grasp_height_m(
        case, np.stack([np.interp(time_s, joint_time_s, a) for a in arm_rad.T], axis=1)
    )
    held = (gap_m > wanted_m + CLOSED_M) & (gap_m > GRIPPER_CLOSED_M + CLOSED_M)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]])))
    for begin, end in reversed(list(zip(edges[::2], edges[1::2], strict=True))):
        rises = np.flatnonzero(height_m[begin:end] > height_m[begin] + LIFTED_M)
        if len(rises) and time_s[end - 1] - time_s[begin + rises[0]] > HELD_S:
            lifted_s, rest_s = time_s[begin + rises[0]], time_s[end - 1] + FALL_S
            return Phases(float(time_s[begin]), float(lifted_s), float(rest_s))
    raise CaseError("the gripper never closes on something and rises with it")


def _grasp_height_m(case: Case, arm_rad: Array) -> Array:
    """(n,) height of the gripper over the floor for arm joints (n, 6)."""
    model = robot_model(case.robot.kinematics)
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in ARM_JOINTS]
    heights = np.empty(len(arm_rad))
    for index, angles in enumerate(arm_rad):
        data.qpos[joints] = angles
        mujoco.mj_kinematics(model, data)
        heights[index] = data.site(GRASP_SITE).xpos[2]
    return heights


def _base_path(base: Pose) -> PchipInterpolator:
    """Base motion over time as the coordinates of `_BASE_JOINTS`."""
    angles = Rotation.from_quat(np.roll(base.quaternion, -1, axis=1)).as_euler("ZYX")
    return PchipInterpolator(base.time_s, np.hstack([base.position_m, np.unwrap(angles, axis=0)]))


class World:
    """The lab with one item, its robot on servos that follow the recording."""

    def __init__(self, case: Case) -> None:
        robot, item = case.robot, case.item
        site = SimpleNamespace(
            lab=case.site.lab,
            bin=case.site.bin,
            dock=case.site.dock,
            items=[item],
            robots=[robot.model_copy(update={"pose": Pose2(x_m=0, y_m=0)})],
        )
        spec = world_spec(site)
        prefix = f"{robot.name}/"
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        for sensor in list(spec.sensors):
            spec.delete(sensor)
        for wheel in WHEEL_JOINTS:
            spec.delete(spec.joint(prefix + wheel))
        spec.delete(spec.joint(prefix + "base"))
        # Scales and what is only seen change nothing for the item and cost time in every step.
        for name in case.site.bin.compartments:
            bucket = f"{case.site.bin.name}/{name}"
            spec.delete(spec.joint(bucket))
        for geom in list(spec.geoms):
            if not geom.contype and not geom.conaffinity:
                spec.delete(geom)
        # The base follows its recorded pose, so its wheels need no ground to stand on.
        for contact in list(spec.pairs):
            spec.delete(contact)
        base = spec.body(prefix + "base_link")
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        axes = (*np.eye(3), *np.eye(3)[::-1])
        for name, kind, axis in zip(_BASE_JOINTS, (slide,) * 3 + (hinge,) * 3, axes, strict=True):
            base.add_joint(name=name, type=kind, axis=list(axis), frictionloss=0, damping=[0, 0, 0])
        # Sleeping saves nothing while everything that can move is moved.
        spec.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        self._servos = [*_BASE_JOINTS, *(prefix + name for name in ARM_JOINTS)]
        self._fingers = [prefix + name for name in FINGER_JOINTS]
        for name in (*self._servos, *self._fingers):
            spec.joint(name).actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            spec.joint(name).limited = mujoco.mjtLimited.mjLIMITED_FALSE
            actuator = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        self._add_sensors(spec, prefix, item.id)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._item = self.model.joint(item.id)
        self._tune()

    @staticmethod
    def _add_sensors(spec: mujoco.MjSpec, prefix: str, item_id: str) -> None:
        kind, obj = mujoco.mjtSensor, mujoco.mjtObj
        spec.add_sensor(name="item", type=kind.mjSENS_FRAMEPOS, objtype=obj.mjOBJ_BODY, objname=item_id)
        spec.add_sensor(
            name="item_in_gripper",
            type=kind.mjSENS_FRAMEPOS,
            objtype=obj.mjOBJ_BODY,
            objname=item_id,
            reftype=obj.mjOBJ_SITE,
            refname=prefix + "grasp",
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

    def _tune(self) -> None:
        """Servo gains by the inertia that each joint moves."""
        mujoco.mj_forward(self.model, self.data)
        inertia = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, inertia)
        for name in self._servos:
            dof = self.model.joint(name).dofadr[0]
            self._set_gains(name, inertia[dof, dof] * _SERVO_RAD_S**2, 2 * inertia[dof, dof] * _SERVO_RAD_S)
        for name in self._fingers:
            self._set_gains(name, _FINGER_STIFFNESS_N_M, _FINGER_DAMPING_N_S_M)

    def _set_gains(self, name: str, stiffness: float, damping: float) -> None:
        """force = ctrl - stiffness * position - damping * speed"""
        actuator = self.model.actuator(name).id
        self.model.actuator_gainprm[actuator, 0] = 1.0
        self.model.actuator_biasprm[actuator, 1:3] = -stiffness, -damping

    def run(self, motion: Motion, chance: Chance, until_s: float = math.inf) -> Replay:
        """Step the physics over the motion (2 ms apart) from the item on the floor, up to `until_s`."""
        model, data = self.model, self.data
        steps = int(np.searchsorted(motion.time_s, until_s))
        path, speed = motion.path[:steps], motion.speed[:steps]
        joints = [model.joint(name) for name in (*self._servos, *self._fingers)]
        data.qpos[[j.qposadr[0] for j in joints]] = path[0]
        data.qvel[:] = 0
        data.qvel[[j.dofadr[0] for j in joints]] = speed[0]
        at = self._item.qposadr[0]
        data.qpos[at : at + 3] = np.add(motion.item_m, (*chance.item_m, 0.0))
        data.qpos[at + 3 : at + 7] = motion.item_quat
        mujoco.mj_forward(model, data)
        state = np.zeros(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, state, _STATE)
        states, sensors = self._roll(state, self._control(motion, chance, slice(0, steps)), chance)
        every = slice(0, None, 10)
        base_m = states[every, 1 + joints[0].qposadr[0] : 4 + joints[0].qposadr[0]]
        columns = {
            model.sensor(i).name: sensors[every, a : a + d]
            for i, (a, d) in enumerate(zip(model.sensor_adr, model.sensor_dim, strict=True))
        }
        pads = np.stack([np.linalg.norm(columns[pad], axis=1) for pad in ("left_pad", "right_pad")], axis=1)
        return Replay(
            phases=motion.phases,
            time_s=motion.time_s[:steps][every],
            item_m=columns["item"],
            item_in_gripper_m=columns["item_in_gripper"],
            pad_force_n=pads,
            placed_m=motion.item_m,
            tracking_error_m=float(np.linalg.norm(base_m - path[every, :3], axis=1).max()),
            chance=chance,
            motion=motion,
            world=self,
            states=states[every],
        )

    def drop(self, found: Replay, chance: Chance) -> Array:
        """(3,) where the item comes to rest when `found` goes on by chance from before its release."""
        row = max(int(np.searchsorted(found.time_s, found.release_s - BEFORE_RELEASE_S)) - 1, 0)
        begin = int(np.searchsorted(found.motion.time_s, found.time_s[row])) + 1
        control = self._control(found.motion, chance, slice(begin, None))
        _, sensors = self._roll(found.states[row], control, chance)
        address = self.model.sensor("item").adr[0]
        return np.asarray(sensors[-1, address : address + 3])

    def _control(self, motion: Motion, chance: Chance, rows: slice) -> Array:
        """(m, nu) what the servos get: recorded path and speed, and the recorded effort of the fingers."""
        stiffness, damping = -self.model.actuator_biasprm[:, 1], -self.model.actuator_biasprm[:, 2]
        control = motion.path[rows] * stiffness + motion.speed[rows] * damping
        arm = slice(len(_BASE_JOINTS), len(_BASE_JOINTS) + len(ARM_JOINTS))
        control[:, arm] += np.array(chance.arm_rad) * stiffness[arm]
        control[:, arm.stop :] += motion.effort[rows] * chance.effort
        return control

    def _roll(self, state: Array, control: Array, chance: Chance) -> tuple[Array, Array]:
        """States and sensors of each step. Raises CaseError when the physics diverges."""
        friction = self.model.geom_friction.copy()
        self.model.geom_friction[:, 0] *= chance.friction
        states, sensors = rollout.rollout(self.model, self.data, state, control[None])
        self.model.geom_friction[:] = friction
        if not np.isfinite(states[0, -1]).all():
            raise CaseError("the replay is not stable")
        return states[0], sensors[0]
