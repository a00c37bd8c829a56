"""The arm's and the gripper's controllers, after ros2_control's trajectory and gripper action controllers.

Used from the simulation's thread only, stepped once per control period.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from scipy.interpolate import BPoly

from rodeo.errors import RodeoError
from rodeo.lab.arm import ArmModel
from rodeo.lab.body import Body
from rodeo.lab.config import MotionLimits
from rodeo.lab.world import CONTROL_PERIOD_S, GRIPPER_OPEN_M

PATH_TOLERANCE_RAD = 0.2
GOAL_TOLERANCE_RAD = 0.02
GOAL_TIME_TOLERANCE_S = 1.0
GRIPPER_TOLERANCE_M = 0.001
STALL_SPEED_M_S = 0.001
STALL_TIME_S = 0.3
_AHEAD = 64
"""Set-points that are taken from a spline at once: one alone costs as much as all of them."""


class TrajectoryError(IntEnum):
    """error_code of control_msgs/action/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class BadTrajectory(RodeoError):
    """The trajectory cannot be followed at all."""

    def __init__(self, error: TrajectoryError, message: str, **details: object) -> None:
        super().__init__(message, **details)
        self.error = error


@dataclass(frozen=True)
class Waypoint:
    """Joint positions in the order of the arm's joints, with derivatives as far as they are given."""

    time_s: float
    derivatives: tuple[np.ndarray, ...]


@dataclass
class Motion:
    """A trajectory under way. Ends when `finished` is set; `error` and `reason` then say how."""

    waypoints: Sequence[Waypoint]
    cancelled: Callable[[], bool]
    path_tolerance_rad: np.ndarray
    goal_tolerance_rad: np.ndarray
    goal_time_tolerance_s: float = GOAL_TIME_TOLERANCE_S
    finished: threading.Event = field(default_factory=threading.Event)
    error: TrajectoryError = TrajectoryError.SUCCESSFUL
    reason: str = ""
    was_cancelled: bool = False
    started_s: float | None = None
    spline: BPoly | None = None
    desired_rad: np.ndarray = field(init=False)
    _ahead: tuple[int, np.ndarray] = field(init=False)
    """The first period, and the (n, joints) set-points from there on."""

    def __post_init__(self) -> None:
        self.desired_rad = np.zeros_like(self.path_tolerance_rad)
        self._ahead = 0, np.empty((0, len(self.path_tolerance_rad)))

    @property
    def end_s(self) -> float:
        return self.waypoints[-1].time_s

    def at(self, spline: BPoly, period: int) -> np.ndarray:
        """(joints,) wanted angles (rad) at this control period after the start."""
        first, ahead_rad = self._ahead
        if not 0 <= period - first < len(ahead_rad):
            first, times_s = period, CONTROL_PERIOD_S * np.arange(period, period + _AHEAD)
            ahead_rad = spline(np.minimum(times_s, self.end_s))
            self._ahead = first, ahead_rad
        return ahead_rad[period - first]


def check(waypoints: Sequence[Waypoint], arm: ArmModel, limits: MotionLimits) -> None:
    """Raise BadTrajectory unless times rise, positions are in the joints' ranges, speeds within limits."""
    if not waypoints:
        raise BadTrajectory(TrajectoryError.INVALID_GOAL, "the trajectory is empty")
    times = np.array([w.time_s for w in waypoints])
    values = np.array([w.derivatives[0] for w in waypoints])
    if not (np.isfinite(values).all() and np.isfinite(times).all()):
        raise BadTrajectory(TrajectoryError.INVALID_GOAL, "the trajectory has numbers that are not finite")
    if times[0] < 0 or (np.diff(times) <= 0).any():
        raise BadTrajectory(
            TrajectoryError.INVALID_GOAL, "the points' times must increase", times_s=times.tolist()[:8]
        )
    low, high = arm.ranges_rad.T
    outside = (values < low - 1e-6) | (values > high + 1e-6)
    if outside.any():
        point, joint = np.argwhere(outside)[0]
        raise BadTrajectory(
            TrajectoryError.INVALID_GOAL,
            "a position is outside the joint's range",
            joint=arm.joints[joint],
            point=int(point),
            position_rad=float(values[point, joint]),
        )
    if len(times) > 1:
        speeds = np.abs(np.diff(values, axis=0)) / np.diff(times)[:, None]
        if speeds.max() > limits.joint_rad_s:
            raise BadTrajectory(
                TrajectoryError.INVALID_GOAL,
                "a joint would exceed its speed limit",
                joint=arm.joints[int(speeds.max(axis=0).argmax())],
                speed_rad_s=float(speeds.max()),
                limit_rad_s=limits.joint_rad_s,
            )


class ArmDriver:
    """Follows one trajectory at a time; between trajectories it holds still."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._motion: Motion | None = None
        self._hold_rad = body.arm_setpoint

    @property
    def idle(self) -> bool:
        return self._motion is None

    @property
    def reference_rad(self) -> np.ndarray:
        """(len(arm_model.joints),) where the joints are wanted now."""
        return self._hold_rad

    def follow(self, motion: Motion) -> None:
        """Start a trajectory from where the arm is; one under way ends as cancelled."""
        self.halt()
        self._motion = motion

    def halt(self) -> None:
        """End the trajectory under way, if there is one, as cancelled."""
        if self._motion is not None:
            self._end(self._motion, cancelled=True)

    def stop(self) -> None:
        """Emergency stop: hold still here and now; the trajectory under way fails."""
        if self._motion is not None:
            self._motion.error = TrajectoryError.INVALID_GOAL
            self._motion.reason = "emergency stop"
            self._end(self._motion)
            self._hold_rad = self._body.arm.copy()

    def hold(self, setpoint_rad: np.ndarray) -> None:
        """Stay at this set-point."""
        self._hold_rad = setpoint_rad

    def step(self, now_s: float) -> None:
        if self._motion is not None:
            self._advance(self._motion, now_s)
        self._body.move_arm(self._hold_rad)

    def _advance(self, motion: Motion, now_s: float) -> None:
        if motion.cancelled():
            self._end(motion, cancelled=True)
            return
        if motion.started_s is None or motion.spline is None:
            motion.started_s, motion.spline = now_s, self._spline(motion)
        elapsed_s = now_s - motion.started_s
        motion.desired_rad = motion.at(motion.spline, round(elapsed_s / CONTROL_PERIOD_S))
        self._hold_rad = motion.desired_rad
        body = self._body
        if not body.arm_within(motion.desired_rad, motion.path_tolerance_rad):
            # What blocks the arm is not pushed any further.
            self._hold_rad = body.arm.copy()
            joint, off_rad = self._worst(motion, motion.path_tolerance_rad)
            motion.error = TrajectoryError.PATH_TOLERANCE_VIOLATED
            motion.reason = f"{joint} is {off_rad:.3f} rad off its path"
            self._end(motion)
        elif elapsed_s >= motion.end_s:
            if body.arm_within(motion.desired_rad, motion.goal_tolerance_rad):
                self._end(motion)
            elif elapsed_s >= motion.end_s + motion.goal_time_tolerance_s:
                joint, off_rad = self._worst(motion, motion.goal_tolerance_rad)
                motion.error = TrajectoryError.GOAL_TOLERANCE_VIOLATED
                motion.reason = f"{joint} stopped {off_rad:.3f} rad short"
                self._end(motion)

    def _worst(self, motion: Motion, tolerance_rad: np.ndarray) -> tuple[str, float]:
        """The joint that is furthest outside of its tolerance, and how far any is from where it is wanted."""
        off_rad = np.abs(self._body.arm - motion.desired_rad)
        return self._body.arm_model.joints[int((off_rad - tolerance_rad).argmax())], float(off_rad.max())

    def _spline(self, motion: Motion) -> BPoly:
        """Linear, cubic or quintic between points, as their derivatives allow (as ros2_control does)."""
        waypoints = list(motion.waypoints)
        if waypoints[0].time_s > 0:
            order = len(waypoints[0].derivatives)
            zero = np.zeros_like(self._hold_rad)
            still = (self._hold_rad, zero, zero)[:order]
            waypoints.insert(0, Waypoint(0.0, still))
        if len(waypoints) == 1:
            waypoints.append(Waypoint(waypoints[0].time_s + 1e-3, waypoints[0].derivatives))
        return BPoly.from_derivatives([w.time_s for w in waypoints], [list(w.derivatives) for w in waypoints])

    def _end(self, motion: Motion, cancelled: bool = False) -> None:
        motion.was_cancelled = cancelled
        self._motion = None
        motion.finished.set()


@dataclass
class Grip:
    """A gripper command under way. Ends when `finished` is set."""

    position_m: float
    force_n: float
    cancelled: Callable[[], bool]
    finished: threading.Event = field(default_factory=threading.Event)
    stalled: bool = False
    was_cancelled: bool = False
    was_stopped: bool = False
    """By the emergency stop."""
    still_since_s: float | None = None


class GripperDriver:
    """Keeps pushing towards the last command, so that what is held stays held."""

    def __init__(self, body: Body, position_m: float = GRIPPER_OPEN_M, force_n: float = 5.0) -> None:
        self._body = body
        self._grip: Grip | None = None
        self.position_m, self.force_n = position_m, force_n

    @property
    def idle(self) -> bool:
        return self._grip is None

    def follow(self, grip: Grip) -> None:
        self.halt()
        self._grip = grip
        self.position_m, self.force_n = grip.position_m, grip.force_n

    def halt(self) -> None:
        """End the command under way, if there is one, as cancelled; the fingers keep pushing."""
        if self._grip is not None:
            self._end(self._grip, cancelled=True)

    def stop(self) -> None:
        """Emergency stop: the command under way fails; what is held stays held."""
        if self._grip is not None:
            self._grip.was_stopped = True
            self._end(self._grip)

    def step(self, now_s: float) -> None:
        self._body.move_gripper(self.position_m, self.force_n)
        grip = self._grip
        if grip is None:
            return
        if grip.cancelled():
            self._end(grip, cancelled=True)
        elif abs(self._body.gripper_m - grip.position_m) <= GRIPPER_TOLERANCE_M:
            self._end(grip)
        elif abs(self._body.gripper_speed_m_s) > STALL_SPEED_M_S or grip.still_since_s is None:
            grip.still_since_s = now_s
        elif now_s - grip.still_since_s >= STALL_TIME_S:
            grip.stalled = True
            self._end(grip)

    def _end(self, grip: Grip, cancelled: bool = False) -> None:
        grip.was_cancelled = cancelled
        self._grip = None
        grip.finished.set()
