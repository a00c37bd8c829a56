"""Driving the base: a route follower (regulated pure pursuit with turns on the spot) and velocity commands.

Used from the simulation's thread only, once per control period; localisation is the motion capture's.
"""

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise

from rodeo.lab.body import Body, Twist2
from rodeo.lab.config import MotionLimits, Pose2
from rodeo.lab.geometry import seen_from, wrap
from rodeo.lab.world import CONTROL_PERIOD_S
from services.robot_sim.planner import Point2, Route

LOOKAHEAD_M = 0.35
TURN_FIRST_RAD = 0.5
"""A path that starts further off the heading than this is begun with a turn on the spot."""
SLOWEST_M_S = 0.04
SLOWEST_RAD_S = 0.08
STRAIGHT_SPEED_M_S = 0.35
YAW_TOLERANCE_RAD = 0.012
POSITION_TOLERANCE_M = 0.008
WAYPOINT_TOLERANCE_M = 0.03
ARRIVED_M = 0.02
ARRIVED_RAD = 0.03
"""A goal counts as reached by a robot that stands this close to it."""
STANDING_S = 0.5
STANDING_M_S = 0.003
STANDING_RAD_S = 0.005
"""Standing is being no faster than this for STANDING_S."""
PATIENCE_S = 6.0
"""Without progress for this long the goal is given up."""
CMD_VEL_TIMEOUT_S = 0.5


class NavigationError(IntEnum):
    """error_code of nav2_msgs/action/NavigateToPose (codes of FollowPath)."""

    NONE = 0
    UNKNOWN = 100
    """Here: the emergency stop."""
    FAILED_TO_MAKE_PROGRESS = 105


@dataclass
class Drive:
    """A route under way. Ends when `finished` is set; `error` then says how."""

    route: Route
    cancelled: Callable[[], bool]
    finished: threading.Event = field(default_factory=threading.Event)
    error: NavigationError = NavigationError.NONE
    was_cancelled: bool = False
    was_blocked: bool = False
    """Something that the route did not know of stands on it: plan another one."""
    remaining_m: float = 0.0
    ahead: tuple[Point2, ...] = ()
    """Corners of the route not yet passed, its end included."""


class BaseDriver:
    """Moves one base: along a route if there is one, else as `cmd_vel` says while that is fresh."""

    def __init__(self, body: Body, limits: MotionLimits) -> None:
        self._body, self._limits = body, limits
        self._drive: Drive | None = None
        self._follower: Iterator[Twist2] = iter(())
        self._command = Twist2()
        self._command_until_s = -math.inf
        self._twist = Twist2()
        self._progress: tuple[float, tuple[float, float, float]] | None = None

    @property
    def idle(self) -> bool:
        return self._drive is None and self._twist == Twist2()

    def follow(self, drive: Drive) -> None:
        """Start on a route; a route under way ends as cancelled."""
        self.halt()
        self._drive = drive
        goal = drive.route.goal
        drive.ahead = (
            (drive.route.depart.x_m, drive.route.depart.y_m),
            *drive.route.way,
            (goal.x_m, goal.y_m),
        )
        self._follower = self._follow(drive)
        self._progress = None

    def halt(self) -> None:
        """End the route under way, if there is one, as cancelled."""
        if self._drive is not None:
            self._end(self._drive, cancelled=True)

    @property
    def way(self) -> list[Point2]:
        """From where the base is along the rest of its route; empty without a route."""
        if self._drive is None:
            return []
        x_m, y_m, _ = self._body.place
        return [(x_m, y_m), *self._drive.ahead]

    def block(self) -> None:
        """End the route under way because something stands on it."""
        if self._drive is not None:
            self._drive.was_blocked = True
            self._end(self._drive)

    def stop(self) -> None:
        """Emergency stop: no ramp; the route under way fails, and a velocity command is forgotten."""
        if self._drive is not None:
            self._drive.error = NavigationError.UNKNOWN
            self._end(self._drive)
        self._command_until_s = -math.inf
        self._twist = Twist2()

    def command(self, twist: Twist2, now_s: float) -> None:
        """A velocity command; it holds for CMD_VEL_TIMEOUT_S of site time."""
        self._command, self._command_until_s = twist, now_s + CMD_VEL_TIMEOUT_S

    def step(self, now_s: float) -> None:
        drive = self._drive
        wanted: Twist2 | None = None
        if drive is None:
            wanted = self._command if now_s < self._command_until_s else None
        elif drive.cancelled():
            self._end(drive, cancelled=True)
        elif self._stuck(now_s):
            drive.error = NavigationError.FAILED_TO_MAKE_PROGRESS
            self._end(drive)
        else:
            wanted = next(self._follower, None)
            if wanted is None:
                self._end(drive)
        self._apply(wanted or Twist2())

    def _end(self, drive: Drive, cancelled: bool = False) -> None:
        drive.was_cancelled = cancelled
        self._drive = None
        drive.finished.set()

    def _stuck(self, now_s: float) -> bool:
        x_m, y_m, yaw_rad = self._body.place
        if self._progress is not None:
            since_s, (before_x_m, before_y_m, before_rad) = self._progress
            moved_m = math.hypot(x_m - before_x_m, y_m - before_y_m)
            if moved_m < 0.04 and abs(wrap(yaw_rad - before_rad)) < 0.04:
                return now_s - since_s > PATIENCE_S
        self._progress = (now_s, (x_m, y_m, yaw_rad))
        return False

    def _apply(self, wanted: Twist2) -> None:
        """Ramp towards the wanted speed within the base's accelerations."""
        dv = self._limits.acceleration_m_s2 * CONTROL_PERIOD_S
        dw = self._limits.acceleration_rad_s2 * CONTROL_PERIOD_S
        self._twist = Twist2(
            _towards(self._twist.linear_m_s, wanted.linear_m_s, dv),
            _towards(self._twist.angular_rad_s, wanted.angular_rad_s, dw),
        )
        self._body.drive(self._twist)

    # -- the route, one twist per control period ---------------------------------------------------

    def _follow(self, drive: Drive) -> Iterator[Twist2]:
        route = drive.route
        yield from self._line(drive, route.depart, route.length_m)
        goal = (route.goal.x_m, route.goal.y_m)
        for k, (a, b) in enumerate(pairwise(route.way)):
            drive.ahead = (*route.way[k + 1 :], goal)
            rest_m = sum(math.dist(p, q) for p, q in pairwise((*route.way[k + 1 :], goal)))
            last = k == len(route.way) - 2
            yield from self._segment(drive, a, b, rest_m, None if last else route.way[k + 2])
        drive.ahead = (goal,)
        yield from self._approach(drive)
        while not self._arrived(route.goal):
            yield from self._retry(drive)
            yield from self._approach(drive)

    def _retry(self, drive: Drive) -> Iterator[Twist2]:
        """Back to where the straight approach began; without one there is room to turn towards the goal."""
        goal, begin, here = drive.route.goal, drive.route.way[-1], self._body.pose
        yaw_rad = goal.yaw_rad
        if begin == (goal.x_m, goal.y_m):
            yaw_rad = _bearing((here.x_m, here.y_m), begin)
            if abs(wrap(yaw_rad - here.yaw_rad)) > math.pi / 2:
                yaw_rad = wrap(yaw_rad + math.pi)
            yield from self._turn(yaw_rad)
        yield from self._line(drive, Pose2(x_m=begin[0], y_m=begin[1], yaw_rad=yaw_rad), 0.0)

    def _approach(self, drive: Drive) -> Iterator[Twist2]:
        """Straight in to the goal, until the robot stands."""
        yield from self._turn(drive.route.goal.yaw_rad)
        yield from self._line(drive, drive.route.goal, 0.0)
        yield from self._turn(drive.route.goal.yaw_rad)
        yield from self._settle()

    def _arrived(self, goal: Pose2) -> bool:
        pose = self._body.pose
        off_m = math.hypot(goal.x_m - pose.x_m, goal.y_m - pose.y_m)
        return off_m <= ARRIVED_M and abs(wrap(goal.yaw_rad - pose.yaw_rad)) <= ARRIVED_RAD

    def _segment(
        self, drive: Drive, a: Point2, b: Point2, rest_m: float, beyond: Point2 | None
    ) -> Iterator[Twist2]:
        """Along the line from a to b, cutting the corner towards `beyond` within the lookahead."""
        length_m = math.dist(a, b)
        if length_m < WAYPOINT_TOLERANCE_M:
            return
        ux, uy = (b[0] - a[0]) / length_m, (b[1] - a[1]) / length_m
        # A slight bend is driven through; for a sharp one the robot stops and turns.
        passing = beyond is not None and abs(wrap(_bearing(b, beyond) - _bearing(a, b))) < TURN_FIRST_RAD
        while True:
            x_m, y_m, yaw_rad = self._body.place
            ahead = _bearing((x_m, y_m), b)
            if abs(wrap(ahead - yaw_rad)) > TURN_FIRST_RAD:
                yield from self._turn(ahead)
                x_m, y_m, yaw_rad = self._body.place
            along = (x_m - a[0]) * ux + (y_m - a[1]) * uy
            left_m = length_m - along
            drive.remaining_m = rest_m + max(0.0, left_m)
            if left_m < (0.1 if passing else WAYPOINT_TOLERANCE_M):
                return
            reach = min(along + LOOKAHEAD_M, length_m)
            dx, dy = a[0] + ux * reach - x_m, a[1] + uy * reach - y_m
            yield self._pursue(dx, dy, yaw_rad, math.inf if passing else left_m)

    def _pursue(self, dx: float, dy: float, yaw_rad: float, left_m: float) -> Twist2:
        """Arc through what is dx, dy away in the map, slower in bends and near the end."""
        error = wrap(math.atan2(dy, dx) - yaw_rad)
        curvature = 2 * math.sin(error) / max(math.hypot(dx, dy), 0.15)
        speed = min(self._limits.cruise_m_s, math.sqrt(2 * 0.6 * self._limits.acceleration_m_s2 * left_m))
        speed = max(SLOWEST_M_S, min(speed, self._limits.cruise_rad_s / max(abs(curvature), 1e-6)))
        return Twist2(speed, self._rate(speed * curvature))

    def _line(self, drive: Drive, goal: Pose2, rest_m: float) -> Iterator[Twist2]:
        """Straight forwards or backwards along the goal's heading until level with it."""
        while True:
            x_m, y_m, yaw_rad = self._body.place
            left_m, aside_m = (-own for own in seen_from(goal, x_m, y_m))
            drive.remaining_m = rest_m + abs(left_m)
            if abs(left_m) < POSITION_TOLERANCE_M:
                return
            sign = math.copysign(1.0, left_m)
            fastest = min(STRAIGHT_SPEED_M_S, self._limits.cruise_m_s)
            speed = min(fastest, math.sqrt(0.8 * self._limits.acceleration_m_s2 * abs(left_m)))
            # Steer onto the line, as far as there is still way to do so.
            aim = math.atan2(aside_m, max(abs(left_m), 0.25)) if abs(left_m) > 0.1 else 0.0
            error = wrap(goal.yaw_rad + sign * aim - yaw_rad)
            yield Twist2(sign * max(SLOWEST_M_S, speed), self._rate(1.5 * error))

    def _rate(self, wanted_rad_s: float) -> float:
        return max(-self._limits.cruise_rad_s, min(wanted_rad_s, self._limits.cruise_rad_s))

    def _turn(self, yaw_rad: float) -> Iterator[Twist2]:
        while True:
            error = wrap(yaw_rad - self._body.place[2])
            if abs(error) < YAW_TOLERANCE_RAD:
                return
            speed = min(self._limits.cruise_rad_s, math.sqrt(self._limits.acceleration_rad_s2 * abs(error)))
            yield Twist2(0.0, math.copysign(max(SLOWEST_RAD_S, speed), error))

    def _settle(self) -> Iterator[Twist2]:
        """Until the base has stood for STANDING_S: clients that hear of the arrival see it where it stays."""
        periods = round(STANDING_S / CONTROL_PERIOD_S)
        stood = 0
        while stood < periods:
            twist = self._body.wheel_twist
            still = abs(twist.linear_m_s) <= STANDING_M_S and abs(twist.angular_rad_s) <= STANDING_RAD_S
            stood = stood + 1 if still else 0
            yield Twist2()


def _bearing(a: Point2, b: Point2) -> float:
    return math.atan2(b[1] - a[1], b[0] - a[0])


def _towards(value: float, goal: float, step: float) -> float:
    return min(value + step, goal) if goal > value else max(value - step, goal)
