"""What lies on the floor and nobody listed: an exploring robot reports it to the organization.

The organization keeps what robots saw. The robot asks it before each look, so it needs no memory of its own.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from rodeo.bus.queries import SeenThing
from rodeo.bus.seen import SightReport
from rodeo.errors import RemoteError
from rodeo.kinds import SAME_PLACE_M
from rodeo.lab.layout import footprint
from rodeo.person import photos
from rodeo.person.statement import BadPhoto
from rodeo.robot.behaviour import Robot
from rodeo.robot.body import Point
from rodeo.robot.errors import MotionFailed, NoAnswer, Unreachable
from rodeo.robot.perception import Array, Cluster, View, cloud, clusters, is_bare, stands_free
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo_kinds.waste_disposal import KIND
from rodeo_kinds.waste_disposal.found import FOUND
from rodeo_kinds.waste_disposal.grasping import FAR_MISFIT_M, LISTED_M, LOOK_TURNS_RAD, NEAR_MISFIT_M

log = logging.getLogger(__name__)

_SWEEP_RAD = (0.0, 1.2, -1.2)
"""Turns of the waist from which the floor ahead and to both sides is seen."""
_SIGHT_M = 2.0
"""From the robot's centre: farther off, the smallest things are a picture element or two."""
_OWN_M = 0.05
"""What is nearer to the robot's footprint may be the robot."""
_OPEN_M = 0.08
"""Nearer to what the plan shows, a thing may be its edge."""
_TALLEST_M = 0.2
_BESIDE_M = 0.3
"""Nearer to something tall that no plan shows, a thing may be a person's foot."""
_STILL_M = 0.06
"""What is farther off at the second look has moved, or was never there."""
_SECOND_LOOKS = 3
"""Things at one stop that are worth another look."""
_OTHER_SIZE_M = 0.05
"""What differs by more, seen from a distance, may be something else than what a person dismissed."""
_AGAIN_S = 3600.0
"""Site time after which the robot says that a known thing still lies there."""
_BLIND_S = 3600.0
"""Site time for which a robot whose camera shows nothing does not try again."""


class Scouting:
    """Looks around where an exploring robot has come to."""

    def __init__(self, robot: Robot) -> None:
        self._body, self._floor, self._memory = robot.body, robot.floor, robot.memory
        self._site, self._seen, self._clock = robot.site, robot.seen, robot.clock
        self._blind_until_s = -math.inf

    def look_around(self) -> None:
        """Withdraw what is gone, and report what is new once it was seen from nearby, too.

        Raises what ends exploring, what the organization answers, and StoreUnavailable.
        """
        if self._clock.now_s() < self._blind_until_s:
            return
        known = self._seen.things(state="open,posted,dismissed")
        told: list[Callable[[], object]] = []
        try:
            views = [view for turn in _SWEEP_RAD for view in self._body.look(turn)]
            found = self._clusters(views)
            told += self._compared(known, found, views)
            for one in self._new(found, known, FAR_MISFIT_M)[:_SECOND_LOOKS]:
                told += self._look_again(one.centre_m, known)
        except NoAnswer as error:
            log.info("exploring without looking: %s", error)
            self._blind_until_s = self._clock.now_s() + _BLIND_S
        except (MotionFailed, Unreachable) as error:
            log.info("cannot look from here: %s", error)
        self._body.fold()  # whatever the organization answers
        for tell in told:
            try:
                tell()
            except RemoteError as error:
                if error.passes:
                    raise
                log.warning("the organization does not want to know: %s", error)

    def _clusters(self, views: Sequence[View]) -> list[Cluster]:
        """What stands on the open floor and is not the robot, the nearest first."""
        base = self._body.here()
        here, own = (base.x_m, base.y_m), footprint(base).grown(_OWN_M)

        def free(x_m: Array, y_m: Array) -> Any:
            return self._floor.is_open(x_m, y_m) & ~own.contains(x_m, y_m)

        found = clusters(cloud(views), here, _SIGHT_M, free)
        return sorted(found, key=lambda one: math.dist(one.centre_m, here))

    def _compared(
        self, known: Sequence[SeenThing], found: Sequence[Cluster], views: Sequence[View]
    ) -> Iterator[Callable[[], object]]:
        """What to tell the organization of what it knows: which still lies there, and which is gone."""
        for thing in known:
            place = thing.x_m, thing.y_m
            if any(math.dist(one.centre_m, place) < SAME_PLACE_M for one in found):
                if self._clock.now_s() - thing.last_s > _AGAIN_S:
                    again = SightReport(**thing.model_dump(include=set(SightReport.model_fields)))
                    yield partial(self._seen.report, again)
            elif is_bare(place, views):
                yield partial(self._seen.gone, thing.id)

    def _new(self, found: Sequence[Cluster], known: Sequence[SeenThing], misfit_m: float) -> list[Cluster]:
        """What a gripper could take, that is no item of the site and that the organization does not know."""
        items = [(item.pose.x_m, item.pose.y_m) for item in self._site.items]
        items += self._memory.lying(but=FOUND)
        return [
            one
            for one in found
            if one.excess_m <= misfit_m
            and one.height_m <= _TALLEST_M
            and one.tower_m > _BESIDE_M
            and self._floor.clearance_m(*one.centre_m) >= _OPEN_M
            and all(math.dist(one.centre_m, place) > LISTED_M for place in items)
            and not any(_is(one, thing) for thing in known)
        ]

    def _look_again(self, place: Point, known: Sequence[SeenThing]) -> Iterator[Callable[[], object]]:
        """Report what lies at `place` if it still does when seen from nearby, all of it in sight."""
        others = [*self._memory.lying(but=FOUND), *((thing.x_m, thing.y_m) for thing in known)]
        self._body.fold()
        try:
            self._body.drive(self._floor.lookouts(place, others, self._body.here()), patience_s=0)
        except (MotionFailed, Unreachable) as error:
            log.info("cannot look at x %.2f y %.2f from nearby: %s", *place, error)
            return
        looks = [self._body.look(turn) for turn in LOOK_TURNS_RAD]
        found = self._clusters([view for look in looks for view in look])
        for one in self._new(found, known, NEAR_MISFIT_M):
            if math.dist(one.centre_m, place) <= _STILL_M and any(
                stands_free(one, view) for view in looks[-1]
            ):
                yield partial(self._report, one, self._body.picture())

    def _report(self, one: Cluster, picture: bytes) -> None:
        (x_m, y_m), size_m = one.centre_m, [one.length_m, one.width_m, one.height_m]
        try:
            photo = photos.keep(
                self._site, types.deserialize(picture, topics.WRIST_IMAGE.type).data.tobytes()
            )
        except BadPhoto as error:
            log.warning("the wrist camera sends no photos: %s", error)
            return
        self._seen.report(SightReport(kind=KIND.name, x_m=x_m, y_m=y_m, size_m=size_m, photo=photo))


def _is(one: Cluster, thing: SeenThing) -> bool:
    """Whether it is the thing that the organization knows; a dismissed one only while it has its size."""
    if math.dist(one.centre_m, (thing.x_m, thing.y_m)) >= SAME_PLACE_M:
        return False
    sizes_m = zip(sorted((one.length_m, one.width_m, one.height_m)), sorted(thing.size_m), strict=True)
    return thing.state != "dismissed" or all(abs(a - b) <= _OTHER_SIZE_M for a, b in sizes_m)
