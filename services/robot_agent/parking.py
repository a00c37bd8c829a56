"""Getting out of narrow places: in front of the bin and on the dock."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from rodeo.lab.config import Pose2
from services.robot_agent.body import Body, Checkpoint
from services.robot_agent.errors import MotionFailed
from services.robot_agent.navigation import Floor, Point

log = logging.getLogger(__name__)


def leave(body: Body, floor: Floor, parked: Pose2, items: Iterable[Point], checkpoint: Checkpoint) -> None:
    """Drive clear of a parking place for whoever comes next.

    A courtesy, not part of the work: when there is no way out the robot stays, and says so.
    """
    for pose in floor.ways_out(parked, items):
        try:
            body.navigate(pose, checkpoint)
            return
        except MotionFailed as error:
            log.info("not that way: %s", error)
    log.warning("no way to drive clear of x %.2f y %.2f; staying", parked.x_m, parked.y_m)
