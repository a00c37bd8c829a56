"""A robot whose way is blocked waits, and makes way where another robot may be waiting for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.lab.config import Pose2
from rodeo.lab.layout import dock_parking
from rodeo.robot.memory import Memory
from rodeo.site.config import Site
from tests.support.site import LAB
from tests.unit.robot.fakes import KinematicBody, ManualClock, RayCamera, manipulator

SITE = Site.load(LAB)
GOAL = Pose2(x_m=5.0, y_m=1.0)
TRIES = 8


def several(site: Site) -> Site:
    return site.model_copy(
        update={
            "robots": [
                site.robots[0],
                site.robots[0].model_copy(update={"name": "panther2", "namespace": "panther2"}),
            ]
        }
    )


@pytest.mark.parametrize(("site", "moves"), [(SITE, False), (several(SITE), True)])
def test_only_a_robot_that_is_not_alone_makes_way(site: Site, moves: bool, tmp_path: Path) -> None:
    body = KinematicBody(site, ManualClock())
    hands = manipulator(site, body, RayCamera(body), Memory(site, tmp_path / "memory.json"))
    body.blocked = TRIES
    hands.drive([GOAL])
    *asides, last = body.drives
    assert last == GOAL
    assert bool(asides) == moves
    # It neither stays indefinitely nor leaves each time: robots that block each other must not do the same.
    assert len(asides) < TRIES


def test_a_robot_that_cannot_dock_makes_way_for_who_leaves_the_dock(tmp_path: Path) -> None:
    site = several(SITE)
    body = KinematicBody(site, ManualClock())
    hands = manipulator(site, body, RayCamera(body), Memory(site, tmp_path / "memory.json"))
    body.blocked = 1
    hands.dock(site.docks[0])
    aside, parked = body.drives
    assert parked == dock_parking(site.docks[0]) != aside
