"""How to dispose of one item: find it, take it, show it to the bin, drop it where the bin says.

What to do next follows from what is perceived (the camera sees it, the fingers feel it), not from what was
done, so a slipped grasp and a restarted process need no code of their own.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from rodeo.bus.messages import Task
from rodeo.errors import wrong_fields
from rodeo.lab.config import ItemConfig, Pose2
from rodeo.lab.drop import RECORDED_AFTER_DROP_S
from rodeo.lab.geometry import wrap
from rodeo.lab.items import NotGraspable
from rodeo.lab.layout import PICK_DISTANCE_M, BinLayout
from rodeo.robot.behaviour import Behaviour, Done, Estimate, Irrevocable, Robot, Work
from rodeo.robot.bin import SmartBin, names
from rodeo.robot.body import Point
from rodeo.robot.errors import (
    Blocked,
    GraspFailed,
    MotionFailed,
    NoAnswer,
    NotFound,
    TakenOut,
    TaskFailed,
    Unreachable,
)
from rodeo.robot.memory import Held
from rodeo.robot.navigation import in_base_frame
from rodeo.robot.perception import Cluster, Sighting, View, best, candidates, cloud, clusters
from rodeo.robot.recording import last_s, notes, recording_of, statements
from rodeo.vision.classification import UNKNOWN
from rodeo.witness.statement import Claimant, Classification, Drop
from rodeo_kinds.waste_disposal.aftermath import Aftermath
from rodeo_kinds.waste_disposal.params import CleaningParams
from rodeo_kinds.waste_disposal.place import PLACE_LIMIT_M, TAKEN_LIMIT_M

log = logging.getLogger(__name__)

_PICKS = 4
_DELIVERIES = 4
_SHOWS = 3
_QUEUE_S = 900.0
"""Site time for which the robot tries to reach the bin: other robots use it one after another."""

_SEARCH_M = PLACE_LIMIT_M + 0.1
"""With room for what a view from a distance is off by, and to say that the item lies too far off."""
_LOOK_TURNS_RAD = (0.0, 0.15)
"""Turns of the waist between the pictures of one look: their picture elements fall on different points."""
_FAR_MISFIT_M = 0.045
"""Misfit of extents seen from a distance, where a picture element covers 2 cm."""
_NEAR_MISFIT_M = 0.02
_NEAR_WITHIN_M = 0.12
_CANDIDATES = 3
"""Things seen from a distance that are worth a look from above."""
_VIEWS_ABOVE_M = ((0.25, -0.012), (0.22, 0.012))
"""Height of the pads and how far they are to the left of the item, for each view from above."""

_FALL_S = 0.6
"""From opening the fingers until the item lies in the compartment."""
_HOLD_WALL_S = 5.0
"""How long the arm is held still for the bin to speak: what is missing from a recording while nothing moves
is no loss."""
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


@dataclass(frozen=True)
class Station:
    """A bin: what it says, and where it takes what."""

    bin: SmartBin
    layout: BinLayout

    @property
    def name(self) -> str:
        return self.layout.config.name

    def away_m(self, x_m: float, y_m: float) -> float:
        """From the place to where the robot parks."""
        return math.dist((x_m, y_m), (self.layout.parking.x_m, self.layout.parking.y_m))


class WasteDisposal(Behaviour):
    """Disposes of items. `dispose` may be called again at any moment after an interruption."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._items = robot.site.items
        self._body = robot.body
        self._floor = robot.floor
        self._memory = robot.memory
        self.stations = [Station(robot.bins[one.name], BinLayout(one)) for one in robot.site.bins]
        self._clock = robot.clock
        self._announce = robot.announce

    # -- what the mind asks ----------------------------------------------------------------------------

    def weigh(self, task: Task | None, here: Pose2) -> Estimate:
        """For the way over the item to the bin; without a task over the farthest item.

        Raises TaskFailed where the site has no such item or bin, and where nobody can look at the place.
        """
        if task is None:
            places, stations = [(item.pose.x_m, item.pose.y_m) for item in self._items], self.stations
        else:
            params = ordered(task)
            self.item(params.item_id)
            places, stations = [(params.x_m, params.y_m)], self.choice(params)[:1]
            try:
                self._floor.lookouts(places[0], (), here)
            except Unreachable as error:
                raise TaskFailed(error.message, cause=error.code, **error.details) from error
        ways = [
            (math.dist((here.x_m, here.y_m), place) + station.away_m(*place), station)
            for place in places
            for station in stations
        ]
        way_m, station = max(
            ways, key=lambda way: way[0], default=(2 * self._floor.diagonal_m, self.stations[0])
        )
        return self.robot.estimate(way_m, station.layout.parking)

    def execute(self, work: Work) -> None:
        params = ordered(work.task)
        place, stations = (params.x_m, params.y_m), self.choice(params)
        self.dispose(params.item_id, place, stations, work)

    def choice(self, params: CleaningParams) -> list[Station]:
        """The bin that the task names, or all, the nearest to the item first. Raises TaskFailed."""
        found = [one for one in self.stations if params.bin in (None, one.name)]
        if not found:
            raise TaskFailed("no such bin on this site", bin=params.bin)
        return sorted(found, key=lambda one: one.away_m(params.x_m, params.y_m))

    @staticmethod
    def irrevocable(recording: Path) -> Irrevocable | None:
        """What was released cannot be taken out of the bin again."""
        released = release_in(recording) or drop_in(recording)
        if released is None:
            return None
        told = tells_of_disposal(recording, *released, RECORDED_AFTER_DROP_S)
        return Irrevocable(released[0], told, where=released[1])

    @staticmethod
    def attend(done: Done) -> None:
        """Wait for the bin's word on what the robot showed it, and until that has stayed in the bin."""
        if done.presented is None:
            return
        name, presented_s = done.presented
        after = Aftermath(done.task, done.recording, done.bins[name], done.clock, done.wait)
        drop = after.confirmation(presented_s, _BIN_ANSWER_WALL_S)
        if drop is None:
            raise NoAnswer("the bin did not confirm that anything fell", bin=name)
        after.stay(drop.settled_s, drop)

    def finish(self, done: Irrevocable, work: Work) -> None:
        station = next((one for one in self.stations if one.name == done.where), None)
        if station is None:
            raise TaskFailed("no such bin on this site", bin=done.where)
        self.confirm(done.done_s, station, work)

    def tidy(self) -> None:
        """Make room for whoever uses a bin next, with the arm folded, wherever it was left."""
        station = self._nearest()
        base, parking = self._body.here(), station.layout.parking
        if station.away_m(base.x_m, base.y_m) > _AT_BIN_M:
            return
        self._body.carry()
        self._body.leave(parking)

    def _nearest(self) -> Station:
        base = self._body.here()
        return min(self.stations, key=lambda one: one.away_m(base.x_m, base.y_m))

    # -- the work --------------------------------------------------------------------------------------

    def item(self, item_id: str) -> ItemConfig:
        """Raises TaskFailed when the site has no such item."""
        for item in self._items:
            if item.id == item_id:
                return item
        raise TaskFailed("no such item on this site", item=item_id)

    def dispose(self, item_id: str, place: Point, stations: Sequence[Station], work: Work) -> None:
        """Bring the item, which lies within PLACE_LIMIT_M of `place`, into the first bin of these that can be
        reached, and see that it stays.

        Raises TaskFailed with the last cause when the limits on retries are used up, and when the item is
        not there.
        """
        item = self.item(item_id)
        picks = deliveries = 0
        while True:
            held = self._body.held()
            if held is not None and held.item_id != item.id:
                raise TaskFailed("the gripper holds another item", item=item_id, held=held.item_id)
            try:
                if held is None:
                    picks += 1
                    self._pick(item, place, self._where_to_look(item, place, picks), work)
                else:
                    deliveries += 1
                    station = self._go_to(stations, item, work)
                    released_s = self._deliver(item, held, station, work)
                    self._finish(released_s, station, _BIN_ANSWER_WALL_S, work)
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
                log.warning("%s failed: %s", "delivering" if held else "grasping", error)
                where = "floor" if held is None else "held"
                work.recording.note({"event": "retry", "where": where, **error.to_json()})
                if picks >= _PICKS or deliveries >= _DELIVERIES:
                    raise TaskFailed(f"gave up: {error.message}", item=item_id, cause=error.code) from error
                self._recover()

    def _where_to_look(self, item: ItemConfig, place: Point, picks: int) -> Point:
        """Where the task says; after a grasp that failed, where the item was last."""
        known = self._memory.place(item.id)
        return place if picks == 1 or known is None else known

    def confirm(self, released_s: float, station: Station, work: Work) -> None:
        """Ask the bin about an item that was released at `released_s`, before an interruption.

        Raises TaskFailed when something was taken out since: the item may be anywhere.
        """
        try:
            # What fell before this call was stated long ago, or never will be.
            self._finish(released_s, station, _BIN_RECALL_WALL_S, work)
        except TakenOut as error:
            raise TaskFailed(f"gave up: {error.message}", cause=error.code, **error.details) from error

    # -- finding it ------------------------------------------------------------------------------------

    def _find(self, item: ItemConfig, place: Point, work: Work) -> list[Sighting]:
        """What may be the item, seen from a distance: from one side, and if need be from another.

        Raises NotFound.
        """
        base = self._body.here()
        lookouts = self._floor.lookouts(place, self._memory.lying(but=item.id), base)
        found: list[Cluster] = []
        for number, side in enumerate(_two_sides(lookouts), 1):
            doing = f"driving to {item.id}" if number == 1 else f"looking for {item.id} from elsewhere"
            work.report(doing, 0.1)
            self._body.drive(side)
            work.report(f"looking for {item.id}", 0.15)
            views = [view for turn in _LOOK_TURNS_RAD for view in self._body.look(turn)]
            found = clusters(cloud(views), place, _SEARCH_M, self._floor.is_open)
            if likely := candidates(found, item, place, _FAR_MISFIT_M):
                return likely[:_CANDIDATES]
        return [best(found, item, place, _FAR_MISFIT_M)]

    def _look_down(self, item: ItemConfig, place: Point) -> Sighting:
        """The item from above. Raises NotFound, Unreachable."""
        views: list[View] = []
        for height_m, left_m in _VIEWS_ABOVE_M:
            views += self._body.look_down(place, height_m, left_m)
        found = clusters(cloud(views), place, _NEAR_WITHIN_M, self._floor.is_open)
        return best(found, item, place, _NEAR_MISFIT_M)

    # -- taking it -------------------------------------------------------------------------------------

    def _pick(self, item: ItemConfig, place: Point, look_at: Point, work: Work) -> None:
        """Take the item of the task that names `place`. Raises NotFound also when it lies too far from it."""
        self._body.fold()
        self._body.open_fingers()
        sighting = self._see(item, look_at, work)
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
        work.recording.await_witness(item.id)
        work.report(f"grasping {item.id}", 0.3)
        self._body.grasp(item, sighting)

    def _see(self, item: ItemConfig, place: Point, work: Work) -> Sighting:
        """The item as it lies, with the robot in front of it. Raises NotFound."""
        if self._in_front(place):
            try:
                return self._look_down(item, place)
            except (NotFound, Unreachable) as error:
                log.info("the item is not within reach from here: %s", error)
                self._body.fold()
        failure: NotFound | None = None
        for likely in self._find(item, place, work):
            spot = likely.position_m[:2]
            work.report(f"driving up to {item.id}", 0.2)
            self._approach(item, spot)
            try:
                return self._look_down(item, spot)
            except NotFound as error:
                log.info("the object there is not the item: %s", error)
                failure = error
                self._body.fold()
        assert failure is not None  # _find() returns at least one
        raise failure

    def _in_front(self, place: Point) -> bool:
        """Whether `place` can be worked at from where the robot stands."""
        forward_m, left_m, _ = in_base_frame(self._body.here(), (*place, 0.0))
        return _AHEAD_M[0] <= forward_m <= _AHEAD_M[1] and abs(left_m) <= _BESIDE_M

    def _approach(self, item: ItemConfig, place: Point) -> None:
        """Stand so that the item is right ahead; places are tried from the nearest."""
        if self._in_front(place):
            return
        self._body.fold()
        base = self._body.here()
        self._body.drive(self._floor.grasp_poses(place, self._memory.lying(but=item.id), base))

    # -- bringing it -----------------------------------------------------------------------------------

    def _go_to(self, stations: Sequence[Station], item: ItemConfig, work: Work) -> Station:
        """Carry it to the first of these bins that can be reached."""
        with self._body.holding():
            work.report(f"carrying {item.id} to the bin", 0.45)
            self._body.carry()
            self._body.drive([one.layout.parking for one in stations], _QUEUE_S)
            return stations[0] if len(stations) == 1 else self._nearest()

    def _deliver(self, item: ItemConfig, held: Held, station: Station, work: Work) -> float:
        """Returns when it was let go of, site time."""
        work.report(f"showing {item.id} to {station.name}", 0.6)
        with self._body.holding():
            compartment = self._present(held, item, station, work.recording.claimant).compartment
        work.report(f"dropping {item.id} into {compartment}", 0.7)
        return self._drop(held, station, compartment, work)

    def _present(self, held: Held, item: ItemConfig, station: Station, claimant: Claimant) -> Classification:
        """Hold the item where the camera looks until the bin says what it is, and that this robot shows it.

        What the bin does not know, or wants to see from another angle, is turned and shown again before its
        word counts, also that its compartment is full; what it takes for somebody else's is shown again, and
        what it names with pictures from before the grasp: these prove nothing.
        Raises NoAnswer, and TaskFailed when the compartment takes no more.
        """
        turn_rad = 0.0
        after_s = 0.0
        for attempt in range(1, _SHOWS + 1):
            # The clock of a fast simulation is heard late: the last answer may be ahead of it.
            after_s = max(after_s, self._clock.now_s())
            station.bin.present(claimant, held.grasped_s)
            self._body.show(held, station.layout.show_point, turn_rad)
            try:
                said = station.bin.wait_for(Classification, after_s, _BIN_ANSWER_WALL_S)
            except NoAnswer:
                if attempt == _SHOWS:
                    raise
                log.warning("the bin did not answer; showing %s again", item.id)
            else:
                after_s = said.shown_s
                if not names(said, claimant):
                    if attempt == _SHOWS:
                        raise NoAnswer(
                            "the bin's statement does not name this robot",
                            number=said.number,
                            named=[one.device for one in said.claimants],
                        )
                    log.warning(
                        "the bin's statement does not name %s; showing the item again", claimant.device
                    )
                elif any(look.taken_s < held.grasped_s for look in said.earlier):
                    if attempt == _SHOWS:
                        raise NoAnswer(
                            "the bin combines pictures from before the grasp",
                            number=said.number,
                            grasped_s=held.grasped_s,
                        )
                    log.warning("the bin combined pictures from before the grasp; showing %s again", item.id)
                elif attempt == _SHOWS or not (said.item_class == UNKNOWN or said.another_angle):
                    if said.full:
                        raise TaskFailed("the compartment is full", compartment=said.compartment)
                    return said
                else:
                    turn_rad = _OTHER_VIEWS_RAD[attempt - 1]
                    log.info("the bin is not sure what %s is; showing another side", item.id)
            self._body.carry()
            self._body.wait(_LOOK_AWAY_S)
        raise AssertionError("unreachable")

    def _drop(self, held: Held, station: Station, compartment: str, work: Work) -> float:
        """Returns when it was let go of, site time."""
        released_s = math.nan

        def releasing() -> None:
            nonlocal released_s
            # The bin says when the weight had settled: later than this, also by a clock a little behind.
            released_s = self._clock.now_s()
            work.recording.note({"event": "releasing", "item": held.item_id, "bin": station.name})

        self._body.place(held, station.layout.compartment(compartment), releasing)
        # Sealed at once: from here on a hole is no loss.
        work.recording.note({"event": "released", "item": held.item_id})
        self._memory.let_go(None)
        self._body.wait(_FALL_S)
        _hold_still(released_s, station)
        try:
            self._body.draw_back()
        except (MotionFailed, Unreachable) as error:  # the item is in the bin all the same
            log.warning("the arm did not retract from the bin: %s", error)
            work.recording.note({"event": "retry", "where": "bin", **error.to_json()})
            self._recover()
        return released_s

    def _finish(self, released_s: float, station: Station, patience_s: float, work: Work) -> None:
        """Wait for the bin's own word, make room at the bin, and be there until what fell has stayed in it.
        Raises TakenOut."""
        work.report("waiting for the bin to confirm", 0.9)
        after = Aftermath(work.task, work.recording, station.bin, self._clock, self._body.wait)
        drop = after.confirmation(released_s, patience_s)
        work.report("driving away from the bin", 0.92)
        try:
            self.tidy()
        except (MotionFailed, Unreachable) as error:
            log.warning("the robot stays at the bin: %s", error)
        work.report("checking that the item stays in the bin", 0.94)
        after.stay(released_s if drop is None else drop.settled_s, drop)

    def _recover(self) -> None:
        """After a failed step: the arm out of the way, whatever is held stays held."""
        try:
            self._body.fold()
        except (MotionFailed, Unreachable) as error:
            log.warning("the arm did not fold: %s", error)


def _hold_still(released_s: float, station: Station) -> None:
    """Until the bin speaks of what fell after `released_s`; it may also stay silent."""
    try:
        station.bin.wait_for(Drop, released_s, _HOLD_WALL_S)
    except NoAnswer as error:
        log.info("%s yet", error)


def ordered(task: Task) -> CleaningParams:
    """What the task says: which item lies where, and into which bin. Raises TaskFailed."""
    try:
        return CleaningParams.model_validate(task.params)
    except ValidationError as error:
        raise TaskFailed(
            "the task's parameters do not name an item and its place", fields=wrong_fields(error)
        ) from error


def release_in(path: Path) -> tuple[float, str] | None:
    """Site time at which the fingers were last opened over a bin, and its name, by the recording at `path`,
    which may be cut off."""
    found = [(time_s, str(one.get("bin"))) for time_s, one in notes(path) if one.get("event") == "releasing"]
    return found[-1] if found else None


def drop_in(path: Path) -> tuple[float, str] | None:
    """When something fell that the robot of this recording had shown, and into which bin: a mind that is not
    ours notes no release."""
    own = recording_of(path)
    fell = [
        (one.after_s, one.device)
        for _, one in statements(path)
        if isinstance(one, Drop) and own in [claimant.recording for claimant in one.claimants]
    ]
    return fell[-1] if fell else None


def tells_of_disposal(path: Path, after_s: float, bin_name: str, for_s: float) -> bool:
    """Whether the recording holds the bin's word that something fell after `after_s` (site time), and what
    came for `for_s` after that."""
    drops = [
        statement.settled_s
        for _, statement in statements(path)
        if isinstance(statement, Drop) and statement.device == bin_name and statement.settled_s > after_s
    ]
    return bool(drops) and last_s(path) >= min(drops) + for_s


def _two_sides(poses: list[Pose2]) -> list[list[Pose2]]:
    """The poses, the first preferred; then those that look from elsewhere than the first."""
    first = poses[0]
    elsewhere = [p for p in poses if abs(wrap(p.yaw_rad - first.yaw_rad)) > math.pi / 3]
    return [poses, elsewhere] if elsewhere else [poses]
