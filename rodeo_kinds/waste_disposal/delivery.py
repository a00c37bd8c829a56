"""How to bring what is held into a bin: show it, drop it where the bin says, wait for the bin's word."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

from rodeo.lab.layout import BinLayout
from rodeo.robot.behaviour import Robot, Work
from rodeo.robot.bin import SmartBin, names
from rodeo.robot.errors import (
    MotionFailed,
    NoAnswer,
    TaskFailed,
    Unreachable,
)
from rodeo.robot.memory import Held
from rodeo.vision.classification import UNKNOWN
from rodeo.witness.statement import Claimant, Classification, Drop
from rodeo_kinds.waste_disposal.aftermath import Aftermath

log = logging.getLogger(__name__)

_SHOWS = 3
_QUEUE_S = 900.0
"""Site time for which the robot tries to reach the bin: other robots use it one after another."""
_FALL_S = 0.6
"""From opening the fingers until the item lies in the compartment."""
_HOLD_WALL_S = 5.0
"""How long the arm is held still for the bin to speak: what is missing from a recording while nothing moves
is no loss."""
_LOOK_AWAY_S = 1.5
_OTHER_VIEWS_RAD = (0.6, -0.6)
"""How far the gripper turns for the next views of what the bin does not know."""
_AT_BIN_M = 0.5
"""Nearer than this to its parking place the robot is in the way of others."""
BIN_ANSWER_WALL_S = 20.0


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


class Delivery:
    """Brings items to the bins of a site."""

    def __init__(self, robot: Robot) -> None:
        self._body, self._memory, self._clock = robot.body, robot.memory, robot.clock
        self.stations = [Station(robot.bins[one.name], BinLayout(one)) for one in robot.site.bins]

    def make_room(self) -> None:
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

    def go_to(self, stations: Sequence[Station], held: Held, work: Work) -> Station:
        """Carry it to the first of these bins that can be reached."""
        with self._body.holding():
            work.report(f"carrying {held.item_id} to the bin", 0.45)
            self._body.carry()
            self._body.drive([one.layout.parking for one in stations], _QUEUE_S)
            return stations[0] if len(stations) == 1 else self._nearest()

    def deliver(self, held: Held, station: Station, work: Work) -> float:
        """Returns when it was let go of, site time."""
        work.report(f"showing {held.item_id} to {station.name}", 0.6)
        with self._body.holding():
            compartment = self._present(held, station, work.recording.claimant).compartment
        work.report(f"dropping {held.item_id} into {compartment}", 0.7)
        return self._drop(held, station, compartment, work)

    def _present(self, held: Held, station: Station, claimant: Claimant) -> Classification:
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
                said = station.bin.wait_for(Classification, after_s, BIN_ANSWER_WALL_S)
                after_s = said.shown_s
                _require_ours(said, held, claimant)
            except NoAnswer as error:
                if attempt == _SHOWS:
                    raise
                log.warning("%s; showing %s again", error.message, held.item_id)
            else:
                if attempt == _SHOWS or not (said.item_class == UNKNOWN or said.another_angle):
                    if said.full:
                        raise TaskFailed("the compartment is full", compartment=said.compartment)
                    return said
                turn_rad = _OTHER_VIEWS_RAD[attempt - 1]
                log.info("the bin is not sure what %s is; showing another side", held.item_id)
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
            self.recover()
        return released_s

    def finish(self, released_s: float, station: Station, patience_s: float, work: Work) -> None:
        """Wait for the bin's own word, make room at the bin, and be there until what fell has stayed in it.
        Raises TakenOut."""
        work.report("waiting for the bin to confirm", 0.9)
        after = Aftermath(work.task, work.recording, station.bin, self._clock, self._body.wait)
        drop = after.confirmation(released_s, patience_s)
        work.report("driving away from the bin", 0.92)
        try:
            self.make_room()
        except (MotionFailed, Unreachable) as error:
            log.warning("the robot stays at the bin: %s", error)
        work.report("checking that the item stays in the bin", 0.94)
        after.stay(released_s if drop is None else drop.settled_s, drop)

    def recover(self) -> None:
        """After a failed step: the arm out of the way, whatever is held stays held."""
        try:
            self._body.fold()
        except (MotionFailed, Unreachable) as error:
            log.warning("the arm did not fold: %s", error)


def _require_ours(said: Classification, held: Held, claimant: Claimant) -> None:
    """Raises NoAnswer where the bin speaks of another robot, or of what it saw before."""
    if not names(said, claimant):
        named = [one.device for one in said.claimants]
        raise NoAnswer("the bin's statement does not name this robot", number=said.number, named=named)
    if any(look.taken_s < held.grasped_s for look in said.earlier):
        raise NoAnswer(
            "the bin combines pictures from before the grasp", number=said.number, grasped_s=held.grasped_s
        )


def _hold_still(released_s: float, station: Station) -> None:
    """Wait until the bin publishes what fell after `released_s`, or has published nothing for
    `_HOLD_WALL_S`."""
    try:
        station.bin.wait_for(Drop, released_s, _HOLD_WALL_S)
    except NoAnswer as error:
        log.info("%s yet", error)
