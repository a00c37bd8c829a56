"""A base that drives, and a mobile manipulator: a base with an arm, two fingers and a camera at the wrist."""

from __future__ import annotations

import itertools
import logging
import math
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import numpy as np

from rodeo.host.clock import Clock
from rodeo.lab.config import DockConfig, ItemConfig, Pose2
from rodeo.lab.geometry import ahead
from rodeo.lab.items import top_grasps
from rodeo.lab.layout import dock_parking, on_contacts
from rodeo.lab.world import GRIPPER_OPEN_M
from rodeo.robot.arm import (
    CRUISE_RAD_S,
    Arm,
    Trajectory,
    Vector,
    pointing_down,
)
from rodeo.robot.body import PATIENCE_S, Point, Point3
from rodeo.robot.errors import Blocked, GraspFailed, MotionFailed, Unreachable
from rodeo.robot.memory import Held, Memory
from rodeo.robot.navigation import Floor, in_base_frame
from rodeo.robot.perception import Sighting, View
from rodeo.robot.ros_body import NOTHING_HELD_M, OPEN_ENOUGH_M, RosBody, holds_something
from rodeo.robot.wrist_camera import WristCamera

log = logging.getLogger(__name__)

_PLACES = 12
"""Number of places that the robot tries, where it may stand for something."""
_BLOCKED_S = 8.0
"""Site time between two tries."""
_ASIDE_SHARE = 0.5
"""Share of the tries after which a blocked robot makes way. Robots that block each other must not do the
same."""
_ASIDE_PLACES = 3
_DOCKINGS = 4
_LOOK_AROUND_S = 10.0
"""Site time after which a robot that waits hears of orders."""

_ACROSS_RAD = math.pi / 2
"""Closing direction, in the base frame, that keeps both fingers visible and out of a bin's walls."""
_ABOVE_M = 0.12
_LIFT_M = 0.15
_DESCENT_RAD_S = 0.6
_LIFT_RAD_S = 0.8
_GRIP_FORCE_N = 5.0
_SETTLES_S = 1.0
"""From the end of a lift until the arm stands still enough to feel a weight."""
_FEELS, _BETWEEN_S = 5, 0.05
"""How often it then feels, and how long it waits in between."""
_THERE_RAD = 0.03
"""An arm this close to a posture need not move to it."""
_PUT_DOWN_M = 0.004
_PLACE_HIGH_M = 0.08
_PLACE_LOW_M = 0.02
_RETREAT_M = 0.08


class Driving:
    """What of `rodeo.robot.body.Body` needs no arm. One thread."""

    def __init__(
        self,
        body: RosBody,
        floor: Floor,
        memory: Memory,
        clock: Clock,
        chance: np.random.Generator,
        stop: threading.Event,
    ) -> None:
        """`chance` decides where the robot makes way; `stop` ends `wait`."""
        self._body = body
        self._floor = floor
        self._memory = memory
        self._clock = clock
        self._chance = chance
        self._stop = stop

    def here(self) -> Pose2:
        return self._body.base_pose()

    def drive(self, poses: Sequence[Pose2], patience_s: float = PATIENCE_S) -> None:
        give_up_s = self._clock.now_s() + patience_s
        while True:
            for pose in poses[:_PLACES]:
                try:
                    self._body.navigate(pose)
                    return
                except MotionFailed as error:
                    log.warning("could not drive to x %.2f y %.2f: %s", pose.x_m, pose.y_m, error)
                    failure = error
            if self._clock.now_s() >= give_up_s:
                raise Blocked(failure.message, waited_s=patience_s, **failure.details) from failure
            if self._floor.is_shared and self._chance.random() < _ASIDE_SHARE:
                self.make_way()
            self.wait(_BLOCKED_S)

    def make_way(self) -> None:
        """Drive to some free place: who stands in the way may be waiting for this robot to go."""
        for place in itertools.islice(self._floor.explore(self._memory.lying(), self._chance), _ASIDE_PLACES):
            try:
                self._body.navigate(place)
                return
            except MotionFailed as error:
                log.info("cannot make way to x %.2f y %.2f: %s", place.x_m, place.y_m, error)

    def dock(self, at: DockConfig) -> None:
        if self.docked() == at:
            return
        parking = dock_parking(at)
        for attempt in range(1, _DOCKINGS + 1):
            try:
                self._body.navigate(parking)
            except MotionFailed as error:
                if attempt == _DOCKINGS:
                    raise
                log.warning("could not dock: %s", error)
                if self._floor.is_shared:
                    self.make_way()
                    continue
            if self.docked() == at:
                return
            log.info("missed the contacts; docking again")
            self.leave(parking)
        raise MotionFailed("the robot cannot reach the dock's contacts", dockings=_DOCKINGS)

    def docked(self) -> DockConfig | None:
        """The dock on whose contacts the robot stands."""
        base = self._body.base_pose()
        return next((dock for dock in self._floor.docks if on_contacts(dock, base)), None)

    def leave(self, parked: Pose2) -> None:
        for pose in self._floor.ways_out(parked, self._memory.lying()):
            try:
                self._body.navigate(pose)
                return
            except MotionFailed as error:
                log.info("cannot take this path: %s", error)
        log.warning("no path away from x %.2f y %.2f; staying", parked.x_m, parked.y_m)

    def wait(self, seconds: float) -> None:
        until_s = self._clock.now_s() + seconds
        while True:
            next_s = min(until_s, self._clock.now_s() + _LOOK_AROUND_S)
            self._clock.wait_until(next_s, self._stop)
            self._body.interrupts.check()
            if next_s >= until_s:
                return


class MobileBase(Driving):
    """A robot without an arm: what has to be done with one before it drives is done."""

    def fold(self) -> None:
        """Nothing has to be folded."""

    def carry(self) -> None:
        """Nothing reaches out."""

    def held(self) -> Held | None:
        return None

    def put_back(self, held: Held) -> None:
        """Raises Unreachable: it is in no hand of this robot."""
        raise Unreachable("the robot has no arm", item=held.item_id)


class MobileManipulator(Driving):
    """Implements `rodeo.robot.body.Body`. One thread."""

    def __init__(
        self,
        body: RosBody,
        arm: Arm,
        camera: WristCamera,
        floor: Floor,
        memory: Memory,
        clock: Clock,
        chance: np.random.Generator,
        stop: threading.Event,
    ) -> None:
        super().__init__(body, floor, memory, clock, chance, stop)
        self._arm = arm
        self._camera = camera
        self._above_placed: Point3 | None = None
        """Point in the base frame: to where the fingers go up from what was placed last."""

    # -- postures --------------------------------------------------------------------------------------

    def fold(self) -> None:
        """Unless the arm is folded, as after a task or as when new."""
        arm, arm_rad = self._arm, self._body.joints().arm_rad
        if any(np.abs(arm_rad - folded).max() <= _THERE_RAD for folded in (arm.ready_rad, arm.stowed_rad)):
            return
        self._body.follow(lambda now: arm.trajectory([now, arm.ready_rad]))

    def carry(self) -> None:
        """On the side where the arm is."""
        self._body.follow(self._plan_aside)

    def _plan_aside(self, now: Vector) -> Trajectory:
        aside_rad = self._arm.aside_rad.copy()
        aside_rad[0] *= 1.0 if now[0] >= 0 else -1.0
        return self._arm.trajectory([now, aside_rad])

    # -- seeing ----------------------------------------------------------------------------------------

    def look(self, turn_rad: float = 0.0) -> list[View]:
        posture = self._arm.look_rad.copy()
        posture[0] += turn_rad
        self._body.follow(lambda now: self._arm.trajectory([now, posture]))
        return self._camera.look()

    def look_down(self, place: Point, height_m: float, left_m: float = 0.0) -> list[View]:
        x_m, y_m, _ = in_base_frame(self._body.base_pose(), (*place, 0.0))
        # Fingers down and closing across, the gripper's z axis points ahead.
        ahead_m = float(self._arm.camera_offset_m[2])
        self._reach((x_m - ahead_m, y_m + left_m, height_m), _ACROSS_RAD)
        return self._camera.look()

    # -- taking ----------------------------------------------------------------------------------------

    def open_fingers(self) -> None:
        if self._body.joints().gripper_m < OPEN_ENOUGH_M:
            self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N)

    def picture(self) -> bytes:
        return self._camera.picture()

    def feels(self) -> bool:
        return self._body.recent_efforts_nm() is not None

    def grasp(self, item: ItemConfig, sighting: Sighting, weighs: bool = False) -> Held:
        base = self._body.base_pose()
        best = top_grasps(item, sighting.position_m, sighting.quat_wxyz)[0]
        point = in_base_frame(base, best.point_m)
        closing = _ACROSS_RAD if best.yaw_rad is None else best.yaw_rad - base.yaw_rad
        self._reach(_raised(point, _ABOVE_M), closing)
        self._straight(point, closing, _DESCENT_RAD_S)
        empty_nm = None
        if weighs:
            self._straight(_raised(point, _LIFT_M), closing, _LIFT_RAD_S)
            empty_nm = _efforts_nm(self._body, self.wait)
            self._straight(point, closing, _DESCENT_RAD_S)
        held = Held(
            item_id=item.id,
            place_m=sighting.position_m[:2],
            hang_m=point[2],
            centre_m=sighting.position_m[2] - point[2],
            grasped_s=self._clock.now_s(),
        )
        self._memory.took(held)  # before it is so: a robot that is killed now finds it in its gripper
        try:
            _check_grip(self._body.grip(0.0, _GRIP_FORCE_N).position_m)
            self._straight(_raised(point, _LIFT_M), closing, _LIFT_RAD_S)
            if empty_nm is not None:
                stands_rad, more_nm = (
                    self._body.joints().arm_rad,
                    _efforts_nm(self._body, self.wait) - empty_nm,
                )
                held = held.model_copy(update={"weight_n": self._arm.weight_n(stands_rad, more_nm)})
                self._memory.took(held)
            _check_grip(self._body.joints().gripper_m)
        except GraspFailed:
            self._memory.let_go(held.place_m)
            raise
        with self.holding():
            self.carry()
        return held

    def held(self) -> Held | None:
        """The fingers close on it if they are neither closed nor open."""
        if self._fingers_apart():
            self._body.grip(0.0, _GRIP_FORCE_N)
            if self._fingers_apart():
                # What nobody remembers taking hangs as low as any item does.
                unknown = Held(item_id="", place_m=self._below_pads(), hang_m=0.1, centre_m=0.0)
                return self._memory.held or unknown
        if self._memory.held is not None:
            self._memory.let_go(self._below_pads())
        return None

    def _fingers_apart(self) -> bool:
        """Whether something keeps the fingers from closing, unless they are open."""
        return holds_something(self._body.joints().gripper_m)

    def _below_pads(self) -> Point:
        x_m, y_m, _ = self._arm.forward(self._body.joints().arm_rad).position_m
        return ahead(self._body.base_pose(), float(x_m), float(y_m))

    def holding(self) -> AbstractContextManager[None]:
        return self._body.interrupts.also(self._check_held)

    def _check_held(self) -> None:
        gripper_m = self._body.recent_gripper_m()
        if gripper_m is not None and gripper_m <= NOTHING_HELD_M:
            raise GraspFailed("the item slipped out on the way", gripper_m=round(gripper_m, 4))

    # -- bringing --------------------------------------------------------------------------------------

    def show(self, held: Held, point: Point3, turn_rad: float = 0.0) -> None:
        x_m, y_m, z_m = in_base_frame(self._body.base_pose(), point)
        self._reach((x_m, y_m, z_m - held.centre_m), _ACROSS_RAD + turn_rad)

    def place(self, held: Held, point: Point3, releasing: Callable[[], None]) -> None:
        x_m, y_m, z_m = in_base_frame(self._body.base_pose(), point)
        low: Point3 = (x_m, y_m, z_m + held.hang_m + _PLACE_LOW_M)
        self._lower((x_m, y_m, z_m + held.hang_m + _PLACE_HIGH_M), low)
        self._above_placed = _raised(low, _RETREAT_M)
        releasing()
        self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N)

    def draw_back(self) -> None:
        """In one go: a gripper that pauses in a bin's view is looked at."""
        if self._above_placed is None:
            self.carry()
            return
        target, self._above_placed = pointing_down(self._above_placed, _ACROSS_RAD), None

        def plan(now: Vector) -> Trajectory:
            straight = self._arm.trajectory(self._arm.line(now, target), _LIFT_RAD_S)
            return straight.then(self._plan_aside(straight.positions[-1]))

        self._body.follow(plan)

    def put_back(self, held: Held) -> None:
        self.carry()
        base = self._body.base_pose()
        lying = self._memory.lying(but=held.item_id)
        self.drive(self._floor.grasp_poses(held.place_m, lying, base))
        x_m, y_m, _ = in_base_frame(self._body.base_pose(), (*held.place_m, 0.0))
        low: Point3 = (x_m, y_m, held.hang_m + _PUT_DOWN_M)
        self._lower((x_m, y_m, held.hang_m + _ABOVE_M), low)
        self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N)
        self._memory.let_go(held.place_m)
        self._straight(_raised(low, _LIFT_M), _ACROSS_RAD, _LIFT_RAD_S)
        self.fold()

    # -- moving the fingers ----------------------------------------------------------------------------

    def _lower(self, high: Point3, low: Point3) -> None:
        """To `high` any way, from there to `low` in a straight line."""
        self._reach(high, _ACROSS_RAD)
        self._straight(low, _ACROSS_RAD, _DESCENT_RAD_S)

    def _reach(self, point: Point3, closing_rad: float) -> None:
        """Gripper to a point of the base frame, pointing down, any way."""
        target = pointing_down(point, closing_rad)

        def plan(now: Vector) -> Trajectory:
            return self._arm.trajectory([now, self._arm.inverse(target, now)], CRUISE_RAD_S)

        self._body.follow(plan)

    def _straight(self, point: Point3, closing_rad: float, speed_rad_s: float) -> None:
        """The same along a straight line."""
        target = pointing_down(point, closing_rad)
        self._body.follow(lambda now: self._arm.trajectory(self._arm.line(now, target), speed_rad_s))


def _efforts_nm(body: RosBody, wait: Callable[[float], None]) -> Vector:
    """(joints,) torques of the arm at rest: the mean of some. Raises GraspFailed where they are not said."""
    wait(_SETTLES_S)
    felt = []
    for _ in range(_FEELS):
        wait(_BETWEEN_S)
        if (now_nm := body.joints().efforts_nm) is None:
            raise GraspFailed("the arm's joints do not say their torques, so nothing can be weighed")
        felt.append(now_nm)
    return np.asarray(np.mean(felt, axis=0))


def _check_grip(position_m: float) -> None:
    if position_m <= NOTHING_HELD_M:
        raise GraspFailed("the fingers closed on nothing", position_m=round(position_m, 4))


def _raised(point: Point3, by_m: float) -> Point3:
    return point[0], point[1], point[2] + by_m
