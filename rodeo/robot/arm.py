"""Kinematics of the arm: poses to joint angles, paths to trajectories within the joints' limits.

Pure computation on the robot model; knows neither bus nor simulator. The base frame is base_link: origin on
the floor below the robot's centre, x forward, y left, z up. The gripper frame has its origin where the pads
meet, x out of the fingers and y along the direction in which they close.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from rodeo.lab.arm import GRASP_SITE
from rodeo.lab.config import MotionLimits, PosturesConfig
from rodeo.lab.layout import SHOULDER_M
from rodeo.lab.world import CAMERA_SITE, arm_model, robot_model
from rodeo.robot.errors import Unreachable

Vector = NDArray[np.float64]

_POSITION_TOLERANCE_M = 5e-4
_ANGLE_TOLERANCE_RAD = 5e-3
_IK_STEPS = 200
_IK_STEP_S = 0.1
_BRANCH_JUMP_RAD = 2.5
"""A solution further than this from where the arm is means another branch: a wild swing to get there."""

CRUISE_RAD_S = 1.2
"""Joint speed of ordinary motions, well below the limit so that tracking errors stay within it too."""
_ACCELERATION_RAD_S2 = 2.5
_JERK_RAD_S3 = 15.0
_ROUNDING = 1e-3
"""Part of the joints' speed limit that is not planned with: a driver refuses whatever exceeds the limit."""
_SAMPLE_PERIOD_S = 0.05
_LINE_STEP_M = 0.01
_LINE_JUMP_RAD = 0.35
"""A larger joint step between two neighbouring points of a line means that the arm would flip over."""


@dataclass(frozen=True)
class GripperPose:
    """Pose of the gripper in the base frame: `position_m` (3,), `rotation` (3, 3)."""

    position_m: Vector
    rotation: Vector


def pointing_down(position_m: Sequence[float], closing_yaw_rad: float) -> GripperPose:
    """Fingers straight down, closing along the horizontal direction `closing_yaw_rad`.

    Closing along yaw and along yaw + pi is the same grasp; the one in [0, pi) is meant.
    """
    closing_yaw_rad %= np.pi
    c, s = np.cos(closing_yaw_rad), np.sin(closing_yaw_rad)
    rotation = np.array([[0.0, c, s], [0.0, s, -c], [-1.0, 0.0, 0.0]])
    return GripperPose(np.asarray(position_m, float), rotation)


@dataclass(frozen=True)
class Trajectory:
    """Joint motion: `times_s` (n,) from 0, `positions` and `velocities` (n, joints) in rad and rad/s."""

    times_s: Vector
    positions: Vector
    velocities: Vector

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    def then(self, other: Trajectory) -> Trajectory:
        """This motion and, from rest, `other`, which begins where this one ends; no pause between them."""
        return Trajectory(
            np.append(self.times_s, self.duration_s + other.times_s[1:]),
            np.vstack([self.positions, other.positions[1:]]),
            np.vstack([self.velocities, other.velocities[1:]]),
        )


class Solver:
    """Inverse kinematics of a robot whose joints move, but for those that are not among `dofs`."""

    def __init__(self, model: mujoco.MjModel, dofs: set[int]) -> None:
        others = sorted(set(range(model.nv)) - dofs)
        self._hold_others = mink.DofFreezingTask(model, dof_indices=others)
        self._limit = mink.ConfigurationLimit(model)
        # Kept from one solution to the next: making them costs more than solving.
        self._configuration = mink.Configuration(model)
        self._reach = mink.FrameTask(GRASP_SITE, "site", position_cost=10.0, orientation_cost=1.0)

    def solve(self, target: GripperPose, start: Vector) -> tuple[Vector, Vector]:
        """The model's positions nearest to the target that are found from `start`, and what is missing to it:
        (6,) in m and rad."""
        configuration, task = self._configuration, self._reach
        configuration.update(start)
        task.set_target(
            mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(target.rotation), target.position_m)
        )
        error = task.compute_error(configuration)
        for _ in range(_IK_STEPS):
            velocity = mink.solve_ik(
                configuration,
                [task],
                _IK_STEP_S,
                solver="daqp",
                damping=1e-4,
                limits=[self._limit],
                constraints=[self._hold_others],
            )
            configuration.integrate_inplace(velocity, _IK_STEP_S)
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < _POSITION_TOLERANCE_M / 5 and (
                np.linalg.norm(error[3:]) < _ANGLE_TOLERANCE_RAD / 5
            ):
                break
        return configuration.q, error


class Arm:
    """Kinematics of one robot's arm, as `kinematics` (MJCF or URDF, by default ours) describes it.

    Not thread-safe: it keeps scratch data. Raises ConfigError for a file that describes no such robot and
    for postures that are not the arm's.
    """

    def __init__(
        self,
        limits: MotionLimits,
        kinematics: Path | None = None,
        postures: PosturesConfig = PosturesConfig(),  # noqa: B008 - frozen
    ) -> None:
        self.model = robot_model(kinematics)
        arm = arm_model(kinematics)
        self.stowed_rad, self.ready_rad, self.look_rad, self.aside_rad = (
            arm.posture(name, getattr(postures, name))
            for name in ("stowed_rad", "ready_rad", "look_rad", "aside_rad")
        )
        self._data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in arm.joints]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self.lower = np.array([joint.range[0] for joint in joints])
        self.upper = np.array([joint.range[1] for joint in joints])
        self._limit_rad_s = (1 - _ROUNDING) * limits.joint_rad_s
        self._site = self.model.site(GRASP_SITE).id
        self._camera = self.model.site(CAMERA_SITE).id
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._solver = Solver(self.model, {*self._dofs.tolist()})
        self._open_qpos = self.model.qpos0.copy()
        """The model's own posture with the fingers open."""
        for finger, side in zip(arm.fingers, (1, -1), strict=True):
            self._open_qpos[self.model.joint(finger).qposadr[0]] = side * 0.04

    def forward(self, q: Vector) -> GripperPose:
        """Gripper pose for joint angles `q`, one for each joint."""
        self._place(q)
        mujoco.mj_kinematics(self.model, self._data)
        position = self._data.site_xpos[self._site].copy()
        return GripperPose(position, self._data.site_xmat[self._site].reshape(3, 3).copy())

    def camera(self, q: Vector) -> tuple[Vector, Vector]:
        """Position (3,) and rotation (3, 3) of the wrist camera's optical frame in the base frame."""
        self._place(q)
        mujoco.mj_kinematics(self.model, self._data)
        position = self._data.site_xpos[self._camera].copy()
        return position, self._data.site_xmat[self._camera].reshape(3, 3).copy()

    def weight_n(self, q: Vector, torques_nm: Vector) -> float:
        """The weight between the pads, by what the joints at `q` push more than without it: the one that
        explains these torques (joints,) best. It hangs below the pads."""
        self._place(q)
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self._data, jacobian, None, self._site)
        lifts_m = jacobian[2, self._dofs]
        return float(lifts_m @ torques_nm / (lifts_m @ lifts_m))

    @cached_property
    def camera_offset_m(self) -> Vector:
        """(3,) from where the pads meet to the camera, in the gripper frame."""
        position_m, _ = self.camera(self.ready_rad)
        gripper = self.forward(self.ready_rad)
        return gripper.rotation.T @ (position_m - gripper.position_m)

    def collides(self, q: Vector) -> bool:
        """Whether the robot touches itself at `q`."""
        self._place(q)
        # What contacts need of mj_fwdPosition: neither inertia nor constraints.
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_collision(self.model, self._data)
        return bool(self._data.ncon)

    def inverse(self, target: GripperPose, near: Vector) -> Vector:
        """Joint angles for a gripper pose, on the branch of `near`, where the arm is now.

        Raises Unreachable with how far off the best configuration was.
        """
        closest_m = np.inf
        x_m, y_m = target.position_m[:2]
        aimed = self.ready_rad.copy()
        aimed[0] = np.arctan2(y_m, x_m - SHOULDER_M)
        # The first joint aims the arm, the last one turns the hand.
        turn = np.eye(len(near))[-1]
        for seed in (near, *(aimed + roll * turn for roll in (0.0, np.pi / 2, -np.pi / 2))):
            q, error_m, angle_rad = self._solve(target, seed)
            closest_m = min(closest_m, error_m)
            solved = error_m <= _POSITION_TOLERANCE_M and angle_rad <= _ANGLE_TOLERANCE_RAD
            if solved and np.abs(q - near).max() <= _BRANCH_JUMP_RAD and not self.collides(q):
                return q
        raise Unreachable(
            "the arm does not reach this pose",
            position_m=np.round(target.position_m, 4).tolist(),
            closest_m=round(float(closest_m), 4),
        )

    def _solve(self, target: GripperPose, seed: Vector) -> tuple[Vector, float, float]:
        self._place(np.clip(seed, self.lower + 1e-3, self.upper - 1e-3))
        q, error = self._solver.solve(target, self._data.qpos)
        return q[self._qpos].copy(), float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))

    def line(self, start: Vector, target: GripperPose) -> Vector:
        """Knots (n, joints) that move the gripper from `start` to `target` along a straight line.

        The orientation turns to the target's within the first point, so give the same one. Raises
        Unreachable when a point cannot be reached or the arm would have to flip on the way.
        """
        begin = self.forward(start).position_m
        length_m = float(np.linalg.norm(target.position_m - begin))
        count = max(2, int(np.ceil(length_m / _LINE_STEP_M)) + 1)
        knots = [start]
        for share in np.linspace(0.0, 1.0, count)[1:]:
            point = GripperPose(begin + share * (target.position_m - begin), target.rotation)
            q = self.inverse(point, knots[-1])
            if np.abs(q - knots[-1]).max() > _LINE_JUMP_RAD:
                raise Unreachable("the arm would flip on this line", position_m=point.position_m.tolist())
            knots.append(q)
        return np.array(knots)

    def trajectory(self, knots: Sequence[Vector] | Vector, speed_rad_s: float = CRUISE_RAD_S) -> Trajectory:
        """The fastest smooth motion through joint angles `knots` (n, joints) that keeps the limits.

        The arm follows a spline through the knots, whose parameter goes from rest to rest. Raises
        Unreachable when the robot would touch itself on the way.
        """
        path = np.asarray(knots, float)
        keep = np.r_[True, np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-6]
        path = path[keep]
        if len(path) == 1:
            return Trajectory(np.array([0.0]), path, np.zeros_like(path))
        s = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
        spline = CubicSpline(s, path, bc_type="natural" if len(path) > 2 else "not-a-knot")
        dense = np.linspace(0.0, s[-1], max(20, int(s[-1] / 0.02)))
        for q in spline(dense):
            if self.collides(q):
                raise Unreachable("the robot would touch itself on the way", q=np.round(q, 3).tolist())
        slope = np.abs(spline(dense, 1)).max()
        bend = np.abs(spline(dense, 2)).max()
        speed = min(speed_rad_s, self._limit_rad_s) / slope
        if bend > 1e-9:
            # Half of the acceleration may go into following the bend at full speed.
            speed = min(speed, float(np.sqrt(0.5 * _ACCELERATION_RAD_S2 / bend)))
        along = RestToRest(float(s[-1]), speed, 0.5 * _ACCELERATION_RAD_S2 / slope, _JERK_RAD_S3 / slope)
        times = np.append(np.arange(0.0, along.duration_s, _SAMPLE_PERIOD_S), along.duration_s)
        places, speeds = along.at(times)
        return Trajectory(times, spline(places), spline(places, 1) * speeds[:, None])

    def _place(self, q: Vector) -> None:
        self._data.qpos[:] = self._open_qpos
        self._data.qpos[self._qpos] = q


class RestToRest:
    """The fastest motion from 0 to `length`, from rest to rest, within limits of speed, acceleration and
    jerk; all in one unit of length, its multiples per s, per s^2, and per s^3.

    Seven phases of constant jerk: the acceleration rises, stays, falls; the speed stays; and the same
    backwards (Biagiotti, Melchiorri: Trajectory Planning for Automatic Machines and Robots, 2008, section
    3.4).

    Raises Unreachable unless the length and every limit are finite and positive.
    """

    def __init__(self, length: float, speed: float, acceleration: float, jerk: float) -> None:
        limits = {"length": length, "speed": speed, "acceleration": acceleration, "jerk": jerk}
        if not all(0 < value < math.inf for value in limits.values()):
            raise Unreachable("no motion within the limits", **limits)
        self.length = length
        rising_s, staying_s = _speeding_up(speed, acceleration, jerk)
        cruising_s = length / speed - (2 * rising_s + staying_s)
        if cruising_s < 0:
            # The limit of speed is not reached.
            ramp_s = acceleration / jerk
            peak = acceleration / 2 * (math.sqrt(ramp_s**2 + 4 * length / acceleration) - ramp_s)
            if peak > acceleration * ramp_s:
                rising_s, staying_s = ramp_s, peak / acceleration - ramp_s
            else:
                rising_s, staying_s = math.cbrt(length / (2 * jerk)), 0.0
            cruising_s = 0.0
        self._lasts_s = np.array([rising_s, staying_s, rising_s, cruising_s, rising_s, staying_s, rising_s])
        self._jerks = jerk * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
        self._begins_s = np.append(0.0, np.cumsum(self._lasts_s)[:-1])
        self.duration_s = float(self._lasts_s.sum())
        self._states = np.zeros((len(self._jerks), 3))
        """Place, speed and acceleration at the beginning of each phase."""
        for phase, (lasts_s, one) in enumerate(zip(self._lasts_s[:-1], self._jerks[:-1], strict=True)):
            self._states[phase + 1] = _moved(self._states[phase], one, lasts_s)

    def at(self, times_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) places and (n,) speeds at times (n,) since the start; from the end on it rests."""
        phases = np.searchsorted(self._begins_s, times_s, side="right") - 1
        moved = _moved(self._states[phases].T, self._jerks[phases], times_s - self._begins_s[phases])
        over = times_s >= self.duration_s
        return np.where(over, self.length, moved[0]), np.where(over, 0.0, moved[1])


def _speeding_up(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """For how long (s) the acceleration rises, and stays, on the way from rest to this speed."""
    if speed * jerk < acceleration**2:
        return math.sqrt(speed / jerk), 0.0
    return acceleration / jerk, speed / acceleration - acceleration / jerk


def _moved(
    state: NDArray[np.float64], jerk: NDArray[np.float64], lasts_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(3, ...) place, speed and acceleration after `lasts_s` with this jerk."""
    place, speed, acceleration = state
    return np.array([
        place + lasts_s * (speed + lasts_s * (acceleration / 2 + lasts_s * jerk / 6)),
        speed + lasts_s * (acceleration + lasts_s * jerk / 2),
        acceleration + lasts_s * jerk,
    ])  # fmt: skip
