"""How to dispose of one item: go there, take it, show it to the bin, drop it where the bin says.

What to do next follows from what is perceived (on the floor, held, in the bin), not from what was done, so
a slipped grasp and a restarted process need no code of their own.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rodeo.clock import Clock
from rodeo.config import Site
from rodeo.lab.config import ItemConfig, Pose2
from rodeo.lab.items import NotGraspable, shape_of, top_grasps
from rodeo.lab.layout import PICK_DISTANCE_M, BinLayout
from rodeo.lab.world import GRIPPER_CLOSED_M, GRIPPER_OPEN_M
from services.robot_agent.arm import (
    ASIDE_RAD,
    CRUISE_RAD_S,
    READY_RAD,
    Arm,
    Trajectory,
    Vector,
    pointing_down,
)
from services.robot_agent.bin import SmartBin
from services.robot_agent.body import ON_FLOOR_M, Body, Checkpoint, Pose3
from services.robot_agent.errors import GraspFailed, MotionFailed, NoAnswer, TaskFailed, Unreachable
from services.robot_agent.navigation import Floor, in_base_frame
from services.robot_agent.parking import leave

log = logging.getLogger(__name__)

Point3 = tuple[float, float, float]
Report = Callable[[str, float], None]
"""Told what is being done and what share of the task that is."""
Note = Callable[[dict[str, Any]], None]
"""Told what belongs in the recording."""

_PICKS = 4
_DELIVERIES = 4
_SHOWS = 3

_ACROSS_RAD = math.pi / 2
"""Closing direction, in the base frame, that keeps both fingers visible and out of the bin's walls."""
_ABOVE_M = 0.12
_LIFT_M = 0.15
_DESCENT_RAD_S = 0.6
_LIFT_RAD_S = 0.8
_GRIP_FORCE_N = 5.0
_NOTHING_HELD_M = GRIPPER_CLOSED_M + 0.001
_OPEN_ENOUGH_M = GRIPPER_OPEN_M - 0.004
_HELD_WITHIN_M = 0.08
"""An item whose centre is this close to where the pads meet, with closed fingers, is held."""
_PUT_DOWN_M = 0.004
_DROP_HIGH_M = 0.08
_DROP_LOW_M = 0.02
_FALL_S = 0.6
"""From opening the fingers until the item lies in the compartment."""
_HOLD_WALL_S = 5.0
"""How long the arm is held still for the bin to speak: what is missing from a recording while nothing moves
is no loss."""
_RETREAT_M = 0.08
_LOOK_AWAY_S = 1.5
_OTHER_VIEWS_RAD = (0.6, -0.6)
"""How far the gripper turns for the next views of what the bin does not know."""
_AHEAD_M = (PICK_DISTANCE_M - 0.08, PICK_DISTANCE_M + 0.04)
_BESIDE_M = 0.08
"""With the item in this window ahead the robot need not drive to take it."""
_AT_BIN_M = 0.5
"""Nearer than this to its parking place the robot is in the way of others."""
_BIN_ANSWER_WALL_S = 20.0
_BIN_RECALL_WALL_S = 4.0


class Where(StrEnum):
    FLOOR = "floor"
    HELD = "held"
    BIN = "bin"


class Cleaning:
    """Disposes of items. `dispose` may be called again at any moment after an interruption."""

    def __init__(
        self,
        site: Site,
        body: Body,
        arm: Arm,
        floor: Floor,
        smart_bin: SmartBin,
        clock: Clock,
        stop: threading.Event,
    ) -> None:
        self._site = site
        self._body = body
        self._arm = arm
        self._floor = floor
        self._bin = smart_bin
        self._layout = BinLayout(site.bin)
        self._clock = clock
        self._stop = stop

    def item(self, item_id: str) -> ItemConfig:
        """Raises TaskFailed when the site has no such item."""
        for item in self._site.items:
            if item.id == item_id:
                return item
        raise TaskFailed("no such item on this site", item=item_id)

    def dispose(
        self,
        item_id: str,
        since_s: float,
        checkpoint: Checkpoint,
        report: Report,
        note: Note,
        resumed: bool = False,
    ) -> None:
        """Bring the item into the bin.

        Args:
            since_s: site time of the assignment; the bin's statements before it do not count.
            resumed: whether some of the work may have been done, and recorded, before an interruption.

        Raises TaskFailed with the last cause when the limits on retries are used up, and when there is
        nothing to do: what is in the bin already cannot be brought there again.
        """
        item = self.item(item_id)
        if not resumed and self.where(item, checkpoint) == Where.BIN:
            raise TaskFailed("the item was already in the bin", item=item_id)
        picks = deliveries = 0
        while (where := self.where(item, checkpoint)) != Where.BIN:
            try:
                if where == Where.FLOOR:
                    picks += 1
                    self._pick(item, checkpoint, report)
                else:
                    deliveries += 1
                    self._deliver(item, checkpoint, report, note)
            except (GraspFailed, MotionFailed, Unreachable, NotGraspable, NoAnswer) as error:
                log.warning(
                    "%s did not work: %s", "grasping" if where == Where.FLOOR else "delivering", error
                )
                note({"event": "retry", "where": where.value, **error.to_json()})
                if picks >= _PICKS or deliveries >= _DELIVERIES:
                    raise TaskFailed(f"gave up: {error.message}", item=item_id, cause=error.code) from error
                self._recover(checkpoint)
        report("waiting for the bin to confirm", 0.9)
        # What fell before this call was attested long ago, or never will be.
        patience_s = _BIN_ANSWER_WALL_S if deliveries else _BIN_RECALL_WALL_S
        self._confirm(since_s, patience_s, checkpoint, note)

    def clear_the_bin(self, checkpoint: Checkpoint) -> None:
        """Make room for whoever uses the bin next, with the arm folded, wherever it was left."""
        base, parking = self._body.base_pose(checkpoint), self._layout.parking
        if math.dist((base.x_m, base.y_m), (parking.x_m, parking.y_m)) > _AT_BIN_M:
            return
        self._aside(checkpoint)
        trash = self._body.trash_on_floor(checkpoint)
        leave(self._body, self._floor, parking, trash, checkpoint)

    def where(self, item: ItemConfig, checkpoint: Checkpoint) -> Where:
        """Where the item is now. Raises TaskFailed when it is where the robot cannot take it."""
        if self._in_bin(item, checkpoint):
            return Where.BIN
        pose = self._body.pose_of(item.id, checkpoint)
        if self._holds(pose, checkpoint):
            return Where.HELD
        if pose.position_m[2] < ON_FLOOR_M:
            return Where.FLOOR
        raise TaskFailed("the item is out of reach", item=item.id, position_m=pose.position_m)

    def _in_bin(self, item: ItemConfig, checkpoint: Checkpoint) -> bool:
        position_m = self._body.pose_of(item.id, checkpoint).position_m
        return any(self._layout.contains(name, position_m) for name in self._site.bin.compartments)

    def _holds(self, item: Pose3, checkpoint: Checkpoint) -> bool:
        joints = self._body.joints(checkpoint)
        base = self._body.base_pose(checkpoint)
        pads = self._arm.forward(joints.arm_rad).position_m
        near = math.dist(pads, in_base_frame(base, item.position_m)) <= _HELD_WITHIN_M
        return near and _NOTHING_HELD_M < joints.gripper_m < _OPEN_ENOUGH_M

    # -- taking it -------------------------------------------------------------------------------------

    def _pick(self, item: ItemConfig, checkpoint: Checkpoint, report: Report) -> None:
        self.stow(checkpoint)
        self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N, checkpoint)
        self._approach(item, checkpoint, report)
        report(f"grasping {item.id}", 0.3)
        pose = self._body.pose_of(item.id, checkpoint)
        base = self._body.base_pose(checkpoint)
        grasp = top_grasps(item, pose.position_m, pose.quat_wxyz)[0]
        point = in_base_frame(base, grasp.point_m)
        closing = _ACROSS_RAD if grasp.yaw_rad is None else grasp.yaw_rad - base.yaw_rad
        self._reach(_raised(point, _ABOVE_M), closing, checkpoint)
        self._straight(point, closing, _DESCENT_RAD_S, checkpoint)
        self._check_grip(self._body.grip(0.0, _GRIP_FORCE_N, checkpoint).position_m)
        self._straight(_raised(point, _LIFT_M), closing, _LIFT_RAD_S, checkpoint)
        self._check_grip(self._body.joints(checkpoint).gripper_m)
        if self.where(item, checkpoint) != Where.HELD:
            raise GraspFailed("the item did not come along", item=item.id)
        self._aside(checkpoint)

    def _approach(self, item: ItemConfig, checkpoint: Checkpoint, report: Report) -> None:
        """Stand so that the item is right ahead; places are tried from the nearest."""
        base = self._body.base_pose(checkpoint)
        position = self._body.pose_of(item.id, checkpoint).position_m
        forward_m, left_m, _ = in_base_frame(base, position)
        if _AHEAD_M[0] <= forward_m <= _AHEAD_M[1] and abs(left_m) <= _BESIDE_M:
            return
        lying = self._body.trash_on_floor(checkpoint, but=item.id)
        report(f"driving to {item.id}", 0.1)
        self._drive_to_one_of(self._floor.grasp_poses(position[:2], lying, base), checkpoint)

    def _drive_to_one_of(self, poses: list[Pose2], checkpoint: Checkpoint) -> None:
        """The first of the places that can be reached; `poses` is not empty."""
        failure: MotionFailed | None = None
        for pose in poses:
            try:
                self._body.navigate(pose, checkpoint)
                return
            except MotionFailed as error:
                log.warning("could not drive to x %.2f y %.2f: %s", pose.x_m, pose.y_m, error)
                failure = error
        assert failure is not None
        raise failure

    def _check_grip(self, position_m: float) -> None:
        if position_m <= _NOTHING_HELD_M:
            raise GraspFailed("the fingers closed on nothing", position_m=round(position_m, 4))

    def put_back(self, item_id: str, place: tuple[float, float], checkpoint: Checkpoint) -> None:
        """Lay the held item on the floor at `place`, so that the work can be done, and recorded, again."""
        item = self.item(item_id)
        self._aside(checkpoint)
        base = self._body.base_pose(checkpoint)
        lying = self._body.trash_on_floor(checkpoint, but=item.id)
        self._drive_to_one_of(self._floor.grasp_poses(place, lying, base), checkpoint)
        x_m, y_m, _ = in_base_frame(self._body.base_pose(checkpoint), (*place, 0.0))
        hang_m = self._hang_m(item, checkpoint)
        self._reach((x_m, y_m, hang_m + _ABOVE_M), _ACROSS_RAD, checkpoint)
        low: Point3 = (x_m, y_m, hang_m + _PUT_DOWN_M)
        self._straight(low, _ACROSS_RAD, _DESCENT_RAD_S, checkpoint)
        self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N, checkpoint)
        self._straight(_raised(low, _LIFT_M), _ACROSS_RAD, _LIFT_RAD_S, checkpoint)
        self.stow(checkpoint)

    # -- bringing it -----------------------------------------------------------------------------------

    def _deliver(self, item: ItemConfig, checkpoint: Checkpoint, report: Report, note: Note) -> None:
        report(f"carrying {item.id} to the bin", 0.45)
        self._aside(checkpoint)
        self._body.navigate(self._layout.parking, checkpoint)
        report(f"showing {item.id} to the bin", 0.6)
        compartment = str(self._show(item, checkpoint)["compartment"])
        report(f"dropping {item.id} into {compartment}", 0.7)
        self._drop(item, compartment, checkpoint, note)

    def _show(self, item: ItemConfig, checkpoint: Checkpoint) -> dict[str, Any]:
        """Hold the item where the camera looks until the bin says what it is.

        What the bin does not know is turned and shown again before its word counts. Raises NoAnswer, and
        TaskFailed when the compartment takes no more.
        """
        closing = _ACROSS_RAD
        for attempt in range(1, _SHOWS + 1):
            last = self._bin.last_seq("classification")
            base = self._body.base_pose(checkpoint)
            point = np.array(in_base_frame(base, self._layout.show_point))
            target = point - self._offset(item, checkpoint)
            self._reach((target[0], target[1], target[2]), closing, checkpoint)
            try:
                said = self._bin.wait_for("classification", _newer_than(last), checkpoint, _BIN_ANSWER_WALL_S)
            except NoAnswer:
                if attempt == _SHOWS:
                    raise
                log.warning("the bin said nothing; showing %s again", item.id)
            else:
                if said.get("full"):
                    raise TaskFailed("the compartment is full", compartment=said["compartment"])
                if said.get("class") != "unknown" or attempt == _SHOWS:
                    return said
                closing = _ACROSS_RAD + _OTHER_VIEWS_RAD[attempt - 1]
                log.info("the bin does not know %s; showing another side", item.id)
            self._aside(checkpoint)
            self._pause(_LOOK_AWAY_S, checkpoint)
        raise AssertionError("unreachable")

    def _drop(self, item: ItemConfig, compartment: str, checkpoint: Checkpoint, note: Note) -> None:
        base = self._body.base_pose(checkpoint)
        x_m, y_m, rim_m = in_base_frame(base, self._layout.compartment(compartment))
        hang_m = self._hang_m(item, checkpoint)
        self._reach((x_m, y_m, rim_m + hang_m + _DROP_HIGH_M), _ACROSS_RAD, checkpoint)
        low: Point3 = (x_m, y_m, rim_m + hang_m + _DROP_LOW_M)
        self._straight(low, _ACROSS_RAD, _DESCENT_RAD_S, checkpoint)
        last = self._bin.last_seq("disposal")
        self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N, checkpoint)
        note({"event": "released", "item": item.id})  # sealed at once: from here on a hole is no loss
        self._pause(_FALL_S, checkpoint)
        if self._in_bin(item, checkpoint):
            self._hold_still(last, checkpoint)
        self._retreat(_raised(low, _RETREAT_M), checkpoint)

    def _hold_still(self, last: int, checkpoint: Checkpoint) -> None:
        """Until the bin speaks of what fell after statement `last`; it may also stay silent."""
        try:
            self._bin.wait_for("disposal", _newer_than(last), checkpoint, _HOLD_WALL_S)
        except NoAnswer as error:
            log.info("%s yet", error)

    def _confirm(self, since_s: float, patience_s: float, checkpoint: Checkpoint, note: Note) -> None:
        """Wait for the bin's own word. Without it the recording stands as it is and the oracle decides."""
        try:
            self._bin.wait_for("disposal", lambda d: float(d["time_s"]) >= since_s, checkpoint, patience_s)
        except NoAnswer as error:
            log.warning("%s; submitting without it", error)
            note({"event": "unconfirmed", **error.to_json()})

    def _offset(self, item: ItemConfig, checkpoint: Checkpoint) -> Vector:
        """From where the pads meet to the item's centre, in the base frame (3,)."""
        base = self._body.base_pose(checkpoint)
        centre = in_base_frame(base, self._body.pose_of(item.id, checkpoint).position_m)
        return np.array(centre) - self._arm.forward(self._body.joints(checkpoint).arm_rad).position_m

    def _hang_m(self, item: ItemConfig, checkpoint: Checkpoint) -> float:
        """How far the item reaches below where the pads meet."""
        w, x, y, z = self._body.pose_of(item.id, checkpoint).quat_wxyz
        up = np.abs(Rotation.from_quat((x, y, z, w)).as_matrix()[2])
        return float(up @ shape_of(item).half_m - self._offset(item, checkpoint)[2])

    # -- arm motions -----------------------------------------------------------------------------------

    def stow(self, checkpoint: Checkpoint) -> None:
        """Fold the arm for driving."""
        self._body.follow(lambda now: self._arm.trajectory([now, READY_RAD]), checkpoint)

    def _aside(self, checkpoint: Checkpoint) -> None:
        """Bring the gripper over the deck, on the side where the arm is."""

        self._body.follow(self._plan_aside, checkpoint)

    def _plan_aside(self, now: Vector) -> Trajectory:
        mirror = np.array([1.0 if now[0] >= 0 else -1.0, 1, 1, 1, 1, 1])
        return self._arm.trajectory([now, ASIDE_RAD * mirror])

    def _retreat(self, point: Point3, checkpoint: Checkpoint) -> None:
        """Straight to `point` and aside in one go: a gripper that pauses in the bin's view is looked at."""
        target = pointing_down(point, _ACROSS_RAD)

        def plan(now: Vector) -> Trajectory:
            straight = self._arm.trajectory(self._arm.line(now, target), _LIFT_RAD_S)
            return straight.then(self._plan_aside(straight.positions[-1]))

        self._body.follow(plan, checkpoint)

    def _recover(self, checkpoint: Checkpoint) -> None:
        """After a failed step: the arm out of the way, whatever is held stays held."""
        try:
            self.stow(checkpoint)
        except (MotionFailed, Unreachable) as error:
            log.warning("the arm did not fold: %s", error)

    def _reach(self, point: Point3, closing_rad: float, checkpoint: Checkpoint) -> None:
        """Gripper to a point of the base frame, pointing down, any way."""
        target = pointing_down(point, closing_rad)

        def plan(now: Vector) -> Trajectory:
            return self._arm.trajectory([now, self._arm.inverse(target, now)], CRUISE_RAD_S)

        self._body.follow(plan, checkpoint)

    def _straight(
        self, point: Point3, closing_rad: float, speed_rad_s: float, checkpoint: Checkpoint
    ) -> None:
        """The same along a straight line."""
        target = pointing_down(point, closing_rad)
        self._body.follow(
            lambda now: self._arm.trajectory(self._arm.line(now, target), speed_rad_s), checkpoint
        )

    def _pause(self, seconds: float, checkpoint: Checkpoint) -> None:
        """Let `seconds` of site time pass."""
        self._clock.wait_until(self._clock.now_s() + seconds, self._stop)
        checkpoint()


def _newer_than(seq: int) -> Callable[[dict[str, Any]], bool]:
    return lambda statement: int(statement["seq"]) > seq


def _raised(point: Point3, by_m: float) -> Point3:
    return point[0], point[1], point[2] + by_m
