"""How to dispose of one item: find it, take it, show it to the bin, drop it where the bin says.

What to do next follows from what is perceived (the camera sees it, the fingers feel it), not from what was
done, so a slipped grasp and a restarted process need no code of their own.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from rodeo.clock import Clock
from rodeo.config import Site
from rodeo.lab.config import ItemConfig, Pose2
from rodeo.lab.drop import RECORDED_AFTER_DROP_S
from rodeo.lab.items import NotGraspable, top_grasps
from rodeo.lab.layout import PICK_DISTANCE_M, BinLayout, ahead, wrap
from rodeo.lab.place import PLACE_LIMIT_M, TAKEN_LIMIT_M
from rodeo.lab.world import GRIPPER_CLOSED_M, GRIPPER_OPEN_M, STOWED_RAD
from rodeo.vision.classification import UNKNOWN
from rodeo.witness import Claimant, Classification, Drop
from services.robot_agent.arm import (
    ASIDE_RAD,
    CRUISE_RAD_S,
    LOOK_RAD,
    READY_RAD,
    Arm,
    Trajectory,
    Vector,
    pointing_down,
)
from services.robot_agent.bin import SmartBin
from services.robot_agent.body import Body, Checkpoint
from services.robot_agent.errors import (
    Blocked,
    GraspFailed,
    MotionFailed,
    NoAnswer,
    NotFound,
    TakenOut,
    TaskFailed,
    Unreachable,
)
from services.robot_agent.eyes import WristCamera
from services.robot_agent.memory import Held, Memory
from services.robot_agent.navigation import Floor, Point, in_base_frame
from services.robot_agent.parking import leave
from services.robot_agent.perception import Cluster, Sighting, View, best, candidates, cloud, clusters

log = logging.getLogger(__name__)

Point3 = tuple[float, float, float]
Report = Callable[[str, float], None]
"""Told what is being done and what share of the task that is."""


class Record(Protocol):
    """What is kept of the work while it is done."""

    @property
    def claimant(self) -> Claimant:
        """For whom and what the robot works, as it tells the bin."""
        ...

    def note(self, payload: dict[str, Any]) -> None:
        """What belongs in the recording."""
        ...

    def await_witness(self, item: str, checkpoint: Checkpoint) -> None:
        """Return when a witness saw where `item` lies and knows of the recording. Raises NoAnswer."""
        ...


_PICKS = 4
_DELIVERIES = 4
_SHOWS = 3
_PATIENCE_S = 300.0
"""Site time for which a place that cannot be reached is tried again: who stands in the way may move on, and
another robot takes this long to pick something up while planning goes at wall speed."""
_QUEUE_S = 900.0
"""The same for the bin: other robots use it one after another."""
_PLACES = 12
"""Of the places where it may stand for something, the robot tries so many."""
_BLOCKED_S = 8.0
"""Site time between two tries."""

_SEARCH_M = PLACE_LIMIT_M + 0.1
"""With room for what a view from a distance is off by, and to say that the item lies too far off."""
_LOOK_TURNS_RAD = (0.0, 0.15)
"""Of the waist, between the pictures of one look: their picture elements fall on different points."""
_FAR_MISFIT_M = 0.045
"""Of extents seen from a distance, where a picture element covers 2 cm."""
_NEAR_MISFIT_M = 0.02
_NEAR_WITHIN_M = 0.12
_CANDIDATES = 3
"""Things seen from a distance that are worth a look from above."""
_VIEWS_ABOVE_M = ((0.25, -0.012), (0.22, 0.012))
"""Height of the pads and how far they are to the left of the item, for each view from above."""

_ACROSS_RAD = math.pi / 2
"""Closing direction, in the base frame, that keeps both fingers visible and out of the bin's walls."""
_ABOVE_M = 0.12
_LIFT_M = 0.15
_DESCENT_RAD_S = 0.6
_LIFT_RAD_S = 0.8
_GRIP_FORCE_N = 5.0
_NOTHING_HELD_M = GRIPPER_CLOSED_M + 0.001
_OPEN_ENOUGH_M = GRIPPER_OPEN_M - 0.004
_THERE_RAD = 0.03
"""An arm this close to a posture need not move to it."""
_PUT_DOWN_M = 0.004
_DROP_HIGH_M = 0.08
_DROP_LOW_M = 0.02
_FALL_S = 0.6
"""From opening the fingers until the item lies in the compartment."""
_HOLD_WALL_S = 5.0
"""How long the arm is held still for the bin to speak: what is missing from a recording while nothing moves
is no loss."""
_LOOK_AROUND_S = 1.0
"""Site time after which a robot that waits hears of orders."""
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


class Cleaning:
    """Disposes of items. `dispose` may be called again at any moment after an interruption."""

    def __init__(
        self,
        site: Site,
        body: Body,
        arm: Arm,
        camera: WristCamera,
        floor: Floor,
        memory: Memory,
        smart_bin: SmartBin,
        clock: Clock,
        stop: threading.Event,
        announce: Callable[[Sighting], None],
    ) -> None:
        """`announce` is told where the item lies that is about to be taken."""
        self._site = site
        self._body = body
        self._arm = arm
        self._camera = camera
        self._floor = floor
        self._memory = memory
        self._bin = smart_bin
        self._layout = BinLayout(site.bin)
        self._clock = clock
        self._stop = stop
        self._announce = announce

    def item(self, item_id: str) -> ItemConfig:
        """Raises TaskFailed when the site has no such item."""
        for item in self._site.items:
            if item.id == item_id:
                return item
        raise TaskFailed("no such item on this site", item=item_id)

    def dispose(
        self, item_id: str, place: Point, checkpoint: Checkpoint, report: Report, record: Record
    ) -> None:
        """Bring the item, which lies within PLACE_LIMIT_M of `place`, into the bin, and see that it stays.

        Raises TaskFailed with the last cause when the limits on retries are used up, and when the item is
        not there.
        """
        item = self.item(item_id)
        picks = deliveries = 0
        while True:
            held = self.feel(checkpoint)
            if held is not None and held.item_id != item.id:
                raise TaskFailed("the gripper holds another item", item=item_id, held=held.item_id)
            try:
                if held is None:
                    picks += 1
                    self._pick(
                        item, place, self._where_to_look(item, place, picks), checkpoint, report, record
                    )
                else:
                    deliveries += 1
                    released_s = self._deliver(item, held, checkpoint, report, record)
                    self._finish(released_s, _BIN_ANSWER_WALL_S, checkpoint, report, record)
                    return
            except NotFound as error:
                raise TaskFailed(
                    f"{item_id} was not found near x {place[0]:.2f} y {place[1]:.2f}: {error.message}",
                    cause=error.code,
                    **error.details,
                ) from error
            except Blocked as error:  # waiting was the retry
                raise TaskFailed(f"gave up: {error.message}", item=item_id, cause=error.code) from error
            except (GraspFailed, MotionFailed, Unreachable, NotGraspable, NoAnswer, TakenOut) as error:
                log.warning("%s did not work: %s", "delivering" if held else "grasping", error)
                record.note({"event": "retry", "where": "held" if held else "floor", **error.to_json()})
                if picks >= _PICKS or deliveries >= _DELIVERIES:
                    raise TaskFailed(f"gave up: {error.message}", item=item_id, cause=error.code) from error
                self._recover(checkpoint)

    def _where_to_look(self, item: ItemConfig, place: Point, picks: int) -> Point:
        """Where the task says; after a grasp that failed, where the item was last."""
        known = self._memory.place(item.id)
        return place if picks == 1 or known is None else known

    def confirm(self, released_s: float, checkpoint: Checkpoint, report: Report, record: Record) -> None:
        """Ask the bin about an item that was released at `released_s`, before an interruption.

        Raises TaskFailed when something was taken out since: the item may be anywhere.
        """
        try:
            # What fell before this call was stated long ago, or never will be.
            self._finish(released_s, _BIN_RECALL_WALL_S, checkpoint, report, record)
        except TakenOut as error:
            raise TaskFailed(f"gave up: {error.message}", cause=error.code, **error.details) from error

    def clear_the_bin(self, checkpoint: Checkpoint) -> None:
        """Make room for whoever uses the bin next, with the arm folded, wherever it was left."""
        base, parking = self._body.base_pose(checkpoint), self._layout.parking
        if math.dist((base.x_m, base.y_m), (parking.x_m, parking.y_m)) > _AT_BIN_M:
            return
        self._aside(checkpoint)
        leave(self._body, self._floor, parking, self._memory.lying(), checkpoint)

    # -- feeling what is held --------------------------------------------------------------------------

    def feel(self, checkpoint: Checkpoint) -> Held | None:
        """What is between the fingers, which close on it if they are neither closed nor open."""
        if self._fingers_apart(checkpoint):
            self._body.grip(0.0, _GRIP_FORCE_N, checkpoint)
            if self._fingers_apart(checkpoint):
                return self._memory.held or self._unknown(checkpoint)
        if self._memory.held is not None:
            self._memory.let_go(self._below_pads(checkpoint))
        return None

    def _fingers_apart(self, checkpoint: Checkpoint) -> bool:
        """Whether something keeps the fingers from closing, unless they are open."""
        return _NOTHING_HELD_M < self._body.joints(checkpoint).gripper_m < _OPEN_ENOUGH_M

    def _unknown(self, checkpoint: Checkpoint) -> Held:
        """Something that nobody remembers taking; it hangs as low as any item does."""
        return Held(item_id="", place_m=self._below_pads(checkpoint), hang_m=0.1, centre_m=0.0)

    def _below_pads(self, checkpoint: Checkpoint) -> Point:
        x_m, y_m, _ = self._arm.forward(self._body.joints(checkpoint).arm_rad).position_m
        return ahead(self._body.base_pose(checkpoint), float(x_m), float(y_m))

    def _holding(self, checkpoint: Checkpoint) -> Checkpoint:
        """`checkpoint` that also raises GraspFailed when the fingers have closed on nothing."""

        def check() -> None:
            checkpoint()
            gripper_m = self._body.recent_gripper_m()
            if gripper_m is not None and gripper_m <= _NOTHING_HELD_M:
                raise GraspFailed("the item slipped out on the way", gripper_m=round(gripper_m, 4))

        return check

    # -- finding it ------------------------------------------------------------------------------------

    def _find(self, item: ItemConfig, place: Point, checkpoint: Checkpoint, report: Report) -> list[Sighting]:
        """What may be the item, seen from a distance: from one side, and if need be from another.

        Raises NotFound.
        """
        base = self._body.base_pose(checkpoint)
        lookouts = self._floor.lookouts(place, self._memory.lying(but=item.id), base)
        found: list[Cluster] = []
        for number, side in enumerate(_two_sides(lookouts), 1):
            report(f"driving to {item.id}" if number == 1 else f"looking for {item.id} from elsewhere", 0.1)
            self._drive_to_one_of(side, checkpoint)
            report(f"looking for {item.id}", 0.15)
            views = [view for turn in _LOOK_TURNS_RAD for view in self._look_ahead(turn, checkpoint)]
            found = clusters(cloud(views), place, _SEARCH_M, self._floor.is_open)
            if likely := candidates(found, item, place, _FAR_MISFIT_M):
                return likely[:_CANDIDATES]
        return [best(found, item, place, _FAR_MISFIT_M)]

    def _look_ahead(self, turn_rad: float, checkpoint: Checkpoint) -> list[View]:
        posture = LOOK_RAD + np.array([turn_rad, 0, 0, 0, 0, 0])
        self._body.follow(lambda now: self._arm.trajectory([now, posture]), checkpoint)
        return self._camera.look(checkpoint)

    def _look_down(self, item: ItemConfig, place: Point, checkpoint: Checkpoint) -> Sighting:
        """The item from above. Raises NotFound, Unreachable."""
        views: list[View] = []
        camera_m = self._arm.camera_offset_m
        for height_m, left_m in _VIEWS_ABOVE_M:
            x_m, y_m, _ = in_base_frame(self._body.base_pose(checkpoint), (*place, 0.0))
            # Fingers down and closing across, the gripper's z axis points ahead.
            self._reach((x_m - float(camera_m[2]), y_m + left_m, height_m), _ACROSS_RAD, checkpoint)
            views += self._camera.look(checkpoint)
        found = clusters(cloud(views), place, _NEAR_WITHIN_M, self._floor.is_open)
        return best(found, item, place, _NEAR_MISFIT_M)

    # -- taking it -------------------------------------------------------------------------------------

    def _pick(
        self,
        item: ItemConfig,
        place: Point,
        look_at: Point,
        checkpoint: Checkpoint,
        report: Report,
        record: Record,
    ) -> None:
        """Take the item of the task that names `place`. Raises NotFound also when it lies too far from it."""
        self.stow(checkpoint)
        if self._body.joints(checkpoint).gripper_m < _OPEN_ENOUGH_M:
            self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N, checkpoint)
        sighting = self._see(item, look_at, checkpoint, report)
        self._memory.saw(item.id, sighting.position_m[:2])
        away_m = math.dist(sighting.position_m[:2], place)
        if away_m > TAKEN_LIMIT_M:
            raise NotFound(
                "the item lies too far from the task's place",
                item=item.id,
                away_m=round(away_m, 3),
                limit_m=TAKEN_LIMIT_M,
            )
        self._announce(sighting)
        record.await_witness(item.id, checkpoint)
        report(f"grasping {item.id}", 0.3)
        base = self._body.base_pose(checkpoint)
        grasp = top_grasps(item, sighting.position_m, sighting.quat_wxyz)[0]
        point = in_base_frame(base, grasp.point_m)
        closing = _ACROSS_RAD if grasp.yaw_rad is None else grasp.yaw_rad - base.yaw_rad
        self._reach(_raised(point, _ABOVE_M), closing, checkpoint)
        self._straight(point, closing, _DESCENT_RAD_S, checkpoint)
        held = Held(
            item_id=item.id,
            place_m=sighting.position_m[:2],
            hang_m=point[2],
            centre_m=sighting.position_m[2] - point[2],
        )
        self._memory.took(held)  # before it is so: a robot that is killed now finds it in its gripper
        try:
            self._check_grip(self._body.grip(0.0, _GRIP_FORCE_N, checkpoint).position_m)
            self._straight(_raised(point, _LIFT_M), closing, _LIFT_RAD_S, checkpoint)
            self._check_grip(self._body.joints(checkpoint).gripper_m)
        except GraspFailed:
            self._memory.let_go(held.place_m)
            raise
        self._aside(self._holding(checkpoint))

    def _see(self, item: ItemConfig, place: Point, checkpoint: Checkpoint, report: Report) -> Sighting:
        """The item as it lies, with the robot in front of it. Raises NotFound."""
        if self._in_front(place, checkpoint):
            try:
                return self._look_down(item, place, checkpoint)
            except (NotFound, Unreachable) as error:
                log.info("not right ahead: %s", error)
                self.stow(checkpoint)
        failure: NotFound | None = None
        for likely in self._find(item, place, checkpoint, report):
            spot = likely.position_m[:2]
            report(f"driving up to {item.id}", 0.2)
            self._approach(item, spot, checkpoint)
            try:
                return self._look_down(item, spot, checkpoint)
            except NotFound as error:
                log.info("that was something else: %s", error)
                failure = error
                self.stow(checkpoint)
        assert failure is not None  # _find() returns at least one
        raise failure

    def _in_front(self, place: Point, checkpoint: Checkpoint) -> bool:
        """Whether `place` can be worked at from where the robot stands."""
        forward_m, left_m, _ = in_base_frame(self._body.base_pose(checkpoint), (*place, 0.0))
        return _AHEAD_M[0] <= forward_m <= _AHEAD_M[1] and abs(left_m) <= _BESIDE_M

    def _approach(self, item: ItemConfig, place: Point, checkpoint: Checkpoint) -> None:
        """Stand so that the item is right ahead; places are tried from the nearest."""
        if self._in_front(place, checkpoint):
            return
        self.stow(checkpoint)
        base = self._body.base_pose(checkpoint)
        self._drive_to_one_of(
            self._floor.grasp_poses(place, self._memory.lying(but=item.id), base), checkpoint
        )

    def _drive_to_one_of(
        self, poses: Sequence[Pose2], checkpoint: Checkpoint, patience_s: float = _PATIENCE_S
    ) -> None:
        """The first of the places that can be reached, tried again for `patience_s` of site time.

        `poses` is not empty. Raises Blocked.
        """
        give_up_s = self._clock.now_s() + patience_s
        while True:
            for pose in poses[:_PLACES]:
                try:
                    self._body.navigate(pose, checkpoint)
                    return
                except MotionFailed as error:
                    log.warning("could not drive to x %.2f y %.2f: %s", pose.x_m, pose.y_m, error)
                    failure = error
            if self._clock.now_s() >= give_up_s:
                raise Blocked(failure.message, waited_s=patience_s, **failure.details) from failure
            self._pause(_BLOCKED_S, checkpoint)

    def _check_grip(self, position_m: float) -> None:
        if position_m <= _NOTHING_HELD_M:
            raise GraspFailed("the fingers closed on nothing", position_m=round(position_m, 4))

    def put_back(self, held: Held, checkpoint: Checkpoint) -> None:
        """Lay what is held on the floor where it was taken, for whoever takes it next."""
        self._aside(checkpoint)
        base = self._body.base_pose(checkpoint)
        lying = self._memory.lying(but=held.item_id)
        self._drive_to_one_of(self._floor.grasp_poses(held.place_m, lying, base), checkpoint)
        x_m, y_m, _ = in_base_frame(self._body.base_pose(checkpoint), (*held.place_m, 0.0))
        self._reach((x_m, y_m, held.hang_m + _ABOVE_M), _ACROSS_RAD, checkpoint)
        low: Point3 = (x_m, y_m, held.hang_m + _PUT_DOWN_M)
        self._straight(low, _ACROSS_RAD, _DESCENT_RAD_S, checkpoint)
        self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N, checkpoint)
        self._memory.let_go(held.place_m)
        self._straight(_raised(low, _LIFT_M), _ACROSS_RAD, _LIFT_RAD_S, checkpoint)
        self.stow(checkpoint)

    # -- bringing it -----------------------------------------------------------------------------------

    def _deliver(
        self, item: ItemConfig, held: Held, checkpoint: Checkpoint, report: Report, record: Record
    ) -> float:
        """Returns when it was let go of, site time."""
        holding = self._holding(checkpoint)
        report(f"carrying {item.id} to the bin", 0.45)
        self._aside(holding)
        self._drive_to_one_of([self._layout.parking], holding, _QUEUE_S)
        report(f"showing {item.id} to the bin", 0.6)
        compartment = self._show(held, item, holding, record.claimant).compartment
        report(f"dropping {item.id} into {compartment}", 0.7)
        return self._drop(held, compartment, checkpoint, record)

    def _show(
        self, held: Held, item: ItemConfig, checkpoint: Checkpoint, claimant: Claimant
    ) -> Classification:
        """Hold the item where the camera looks until the bin says what it is, and that this robot shows it.

        What the bin does not know is turned and shown again before its word counts, also that its
        compartment is full; what it takes for somebody else's is shown again. Raises NoAnswer, and TaskFailed
        when the compartment takes no more.
        """
        closing = _ACROSS_RAD
        after_s = 0.0
        for attempt in range(1, _SHOWS + 1):
            # The clock of a fast simulation is heard late: the last answer may be ahead of it.
            after_s = max(after_s, self._clock.now_s())
            self._bin.present(claimant)
            x_m, y_m, z_m = in_base_frame(self._body.base_pose(checkpoint), self._layout.show_point)
            self._reach((x_m, y_m, z_m - held.centre_m), closing, checkpoint)
            try:
                said = self._bin.wait_for(Classification, after_s, checkpoint, _BIN_ANSWER_WALL_S)
            except NoAnswer:
                if attempt == _SHOWS:
                    raise
                log.warning("the bin said nothing; showing %s again", item.id)
            else:
                after_s = said.shown_s
                if not _names(said, claimant):
                    if attempt == _SHOWS:
                        raise NoAnswer(
                            "the bin does not name the robot that shows",
                            number=said.number,
                            named=[one.device for one in said.claimants],
                        )
                    log.warning("the bin does not say that %s shows; showing again", claimant.device)
                elif said.item_class != UNKNOWN or attempt == _SHOWS:
                    if said.full:
                        raise TaskFailed("the compartment is full", compartment=said.compartment)
                    return said
                else:
                    closing = _ACROSS_RAD + _OTHER_VIEWS_RAD[attempt - 1]
                    log.info("the bin does not know %s; showing another side", item.id)
            self._aside(checkpoint)
            self._pause(_LOOK_AWAY_S, checkpoint)
        raise AssertionError("unreachable")

    def _drop(self, held: Held, compartment: str, checkpoint: Checkpoint, record: Record) -> float:
        """Returns when it was let go of, site time."""
        base = self._body.base_pose(checkpoint)
        x_m, y_m, rim_m = in_base_frame(base, self._layout.compartment(compartment))
        self._reach((x_m, y_m, rim_m + held.hang_m + _DROP_HIGH_M), _ACROSS_RAD, checkpoint)
        low: Point3 = (x_m, y_m, rim_m + held.hang_m + _DROP_LOW_M)
        self._straight(low, _ACROSS_RAD, _DESCENT_RAD_S, checkpoint)
        # The bin says when the weight had settled: later than this, also by a clock that is a little behind.
        released_s = self._clock.now_s()
        record.note({"event": "releasing", "item": held.item_id})
        self._body.grip(GRIPPER_OPEN_M, _GRIP_FORCE_N, checkpoint)
        record.note(
            {"event": "released", "item": held.item_id}
        )  # sealed at once: from here on a hole is no loss
        self._memory.let_go(None)
        self._pause(_FALL_S, checkpoint)
        self._hold_still(released_s, checkpoint)
        try:
            self._retreat(_raised(low, _RETREAT_M), checkpoint)
        except (MotionFailed, Unreachable) as error:  # the item is in the bin all the same
            log.warning("the arm did not draw back from the bin: %s", error)
            record.note({"event": "retry", "where": "bin", **error.to_json()})
            self._recover(checkpoint)
        return released_s

    def _hold_still(self, released_s: float, checkpoint: Checkpoint) -> None:
        """Until the bin speaks of what fell after `released_s`; it may also stay silent."""
        try:
            self._bin.wait_for(Drop, released_s, checkpoint, _HOLD_WALL_S)
        except NoAnswer as error:
            log.info("%s yet", error)

    def _finish(
        self, released_s: float, patience_s: float, checkpoint: Checkpoint, report: Report, record: Record
    ) -> None:
        """Wait for the bin's own word, make room at the bin, and be there until what fell has stayed in it.

        Without the bin's word the recording stands as it is and the oracle decides. Raises TakenOut.
        """
        report("waiting for the bin to confirm", 0.9)
        drop: Drop | None = None
        try:
            drop = self._bin.wait_for(Drop, released_s, checkpoint, patience_s)
        except NoAnswer as error:
            log.warning("%s; submitting without it", error)
            record.note({"event": "unconfirmed", **error.to_json()})
        report("driving clear of the bin", 0.92)
        try:
            self.clear_the_bin(checkpoint)
        except (MotionFailed, Unreachable) as error:
            log.warning("the robot stays at the bin: %s", error)
        report("seeing that it stays in the bin", 0.94)
        until_s = (released_s if drop is None else drop.settled_s) + RECORDED_AFTER_DROP_S
        while (now_s := self._clock.now_s()) < until_s:
            self._pause(min(until_s - now_s, _LOOK_AROUND_S), checkpoint)
        if drop is not None and (removal := self._bin.removed(drop.compartment, drop.after_s)) is not None:
            raise TakenOut(
                "something was taken out of the bin after the drop",
                compartment=removal.compartment,
                weight_n=removal.weight_n,
                after_s=round(removal.settled_s - drop.settled_s, 3),
            )

    # -- arm motions -----------------------------------------------------------------------------------

    def stow(self, checkpoint: Checkpoint) -> None:
        """Fold the arm for driving, unless it is, as after a task or as when new."""
        arm_rad = self._body.joints(checkpoint).arm_rad
        if any(np.abs(arm_rad - folded).max() <= _THERE_RAD for folded in (READY_RAD, STOWED_RAD)):
            return
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


def _two_sides(poses: list[Pose2]) -> list[list[Pose2]]:
    """The poses, the first preferred; then those that look from elsewhere than the first."""
    first = poses[0]
    elsewhere = [p for p in poses if abs(wrap(p.yaw_rad - first.yaw_rad)) > math.pi / 3]
    return [poses, elsewhere] if elsewhere else [poses]


def _names(said: Classification, claimant: Claimant) -> bool:
    """Whether the bin says that `claimant` showed it. Addresses may differ in case."""
    own = claimant.address.lower(), claimant.recording, claimant.task_id, claimant.attempt
    return own in [(o.address.lower(), o.recording, o.task_id, o.attempt) for o in said.claimants]


def _raised(point: Point3, by_m: float) -> Point3:
    return point[0], point[1], point[2] + by_m
