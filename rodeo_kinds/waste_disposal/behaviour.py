"""How to dispose of one item: find it, take it, show it to the bin, drop it where the bin says.

What to do next follows from what is perceived (the camera sees it, the fingers feel it), not from what was
done, so a slipped grasp and a restarted process need no code of their own.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from rodeo.bus.messages import Task
from rodeo.errors import wrong_fields
from rodeo.lab.config import ItemConfig, Pose2
from rodeo.lab.drop import RECORDED_AFTER_DROP_S
from rodeo.lab.items import NotGraspable
from rodeo.robot.behaviour import Behaviour, Done, Estimate, Irrevocable, Robot, Work
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
from rodeo.robot.recording import last_s, notes, recording_of, statements
from rodeo.witness.statement import Drop
from rodeo_kinds.waste_disposal.aftermath import Aftermath
from rodeo_kinds.waste_disposal.delivery import BIN_ANSWER_WALL_S, Delivery, Station
from rodeo_kinds.waste_disposal.found import FOUND
from rodeo_kinds.waste_disposal.grasping import Grasping
from rodeo_kinds.waste_disposal.params import CleaningParams, unprovable
from rodeo_kinds.waste_disposal.scouting import Scouting

log = logging.getLogger(__name__)

_PICKS = 4
_DELIVERIES = 4
_BIN_RECALL_WALL_S = 4.0


class WasteDisposal(Behaviour):
    """Disposes of items. `dispose` may be called again at any moment after an interruption."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._items = robot.site.items
        self._body, self._floor, self._memory = robot.body, robot.floor, robot.memory
        self._grasping, self._scouting = Grasping(robot), Scouting(robot)
        self.delivery = Delivery(robot)
        self.stations = self.delivery.stations

    # -- what the mind asks ----------------------------------------------------------------------------

    def weigh(self, task: Task | None, here: Pose2) -> Estimate:
        """For the way over the item to the bin; without a task over the farthest item.

        Raises TaskFailed where the site has no such item or bin, where nobody can look at the place, and
        where what lies there has no name and this robot or site cannot prove what it did with that.
        """
        if task is None:
            places, stations = [(item.pose.x_m, item.pose.y_m) for item in self._items], self.stations
        else:
            params = ordered(task)
            if self.item(params.item_id) is None:
                self._require_senses()
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
        drop = after.confirmation(presented_s, BIN_ANSWER_WALL_S)
        if drop is None:
            raise NoAnswer("the bin did not confirm that anything fell", bin=name)
        after.stay(drop.settled_s, drop)

    def finish(self, done: Irrevocable, work: Work) -> None:
        station = next((one for one in self.stations if one.name == done.where), None)
        if station is None:
            raise TaskFailed("no such bin on this site", bin=done.where)
        self.confirm(done.done_s, station, work)

    def tidy(self) -> None:
        self.delivery.make_room()

    def look_around(self) -> None:
        """Only where a robot could be paid for taking away what nobody listed."""
        if not unprovable(self.robot.site, {}):
            self._scouting.look_around()

    # -- the work --------------------------------------------------------------------------------------

    def item(self, item_id: str) -> ItemConfig | None:
        """None for no name: whatever lies at the place. Raises TaskFailed when the site has no such item."""
        if not item_id:
            return None
        for item in self._items:
            if item.id == item_id:
                return item
        raise TaskFailed("no such item on this site", item=item_id)

    def _require_senses(self) -> None:
        if wrong := unprovable(self.robot.site, {}):
            raise TaskFailed("nobody could prove here what became of something without markers", **wrong)
        if not self._body.feels():
            raise TaskFailed("the arm's joints do not say their torques, so nothing can be weighed")

    def dispose(self, item_id: str, place: Point, stations: Sequence[Station], work: Work) -> None:
        """Bring the item, or without a name whatever lies there, which is within PLACE_LIMIT_M of `place`,
        into the first bin of these that can be reached, and see that it stays.

        Raises TaskFailed with the last cause when the limits on retries are used up, and when the item is
        not there.
        """
        item = self.item(item_id)
        item_id = item_id or FOUND
        picks = deliveries = 0
        while True:
            held = self._body.held()
            if held is not None and held.item_id != item_id:
                raise TaskFailed("the gripper holds another item", item=item_id, held=held.item_id)
            try:
                if held is None:
                    picks += 1
                    self._grasping.take(item, place, self._where_to_look(item, place, picks), work)
                else:
                    deliveries += 1
                    station = self.delivery.go_to(stations, held, work)
                    released_s = self.delivery.deliver(held, station, work)
                    self.delivery.finish(released_s, station, BIN_ANSWER_WALL_S, work)
                    return
            except NotFound as error:
                what, (x_m, y_m) = item_id if item else "anything to take", place
                raise TaskFailed(
                    f"{what} was not found near x {x_m:.2f} y {y_m:.2f}: {error.message}",
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
                self.delivery.recover()

    def _where_to_look(self, item: ItemConfig | None, place: Point, picks: int) -> Point:
        """Where the task says; after a grasp that failed, where the item was last."""
        known = None if item is None or picks == 1 else self._memory.place(item.id)
        return known or place

    def confirm(self, released_s: float, station: Station, work: Work) -> None:
        """Ask the bin about an item that was released at `released_s`, before an interruption.

        Raises TaskFailed when something was taken out since: the item may be anywhere.
        """
        try:
            # The bin has already published what fell before this call, or will never publish it.
            self.delivery.finish(released_s, station, _BIN_RECALL_WALL_S, work)
        except TakenOut as error:
            raise TaskFailed(f"gave up: {error.message}", cause=error.code, **error.details) from error


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
