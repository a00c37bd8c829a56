"""What the robot shows to a bin: the mind's word on it is checked and signed, and the bin answers."""

from __future__ import annotations

from collections.abc import Mapping

from rodeo.host.clock import Clock
from rodeo.robot.bin import SmartBin, names
from rodeo.robot.errors import BodySilent, NoAnswer
from rodeo.robot.ros_body import RosBody, holds_something
from rodeo.witness.statement import Classification
from services.robot_recorder.errors import NothingGrasped, NothingRecorded, UnknownBin
from services.robot_recorder.takes import Take, Takes

_SHOW_WALL_S = 60.0
"""Wall time for the mind to hold the item into view, and for the bin to speak of it."""
_OTHERS = 16
"""Statements about what others show that are passed over meanwhile."""
_AHEAD_S = 1.0
"""A mind may hear the clock before its recorder does."""


class Showing:
    """Presents the robot to bins."""

    def __init__(self, takes: Takes, bins: Mapping[str, SmartBin], body: RosBody, clock: Clock) -> None:
        self._takes, self._bins, self._body, self._clock = takes, bins, body, clock

    def present(self, bin_name: str, grasped_s: float) -> Classification:
        """What the bin says of what the robot shows it next. Raises RequestError, BodySilent, NoAnswer."""
        take = self._takes.running
        if take is None:
            raise NothingRecorded("nothing is being recorded: what is shown now proves nothing")
        if (one := self._bins.get(bin_name)) is None:
            raise UnknownBin("no such bin on this site", bin=bin_name, bins=sorted(self._bins))
        now_s = self._clock.now_s()
        self._check_grasp(take, grasped_s, now_s)
        claimant = take.recording.claimant
        one.present(claimant, grasped_s)
        take.presented = bin_name, now_s
        after_s = now_s
        for _ in range(_OTHERS):
            said = one.wait_for(Classification, after_s, _SHOW_WALL_S)
            after_s = said.shown_s
            # A statement with pictures from before the grasp proves nothing.
            if names(said, claimant) and all(look.taken_s >= grasped_s for look in said.earlier):
                return said
        raise NoAnswer("the bin speaks of what others show it", bin=bin_name)

    def _check_grasp(self, take: Take, grasped_s: float, now_s: float) -> None:
        """Raises NothingGrasped and BodySilent. Whether it is the item, motion capture tells."""
        if grasped_s > now_s + _AHEAD_S or (grasped_s < take.begun_s and not take.resumed):
            raise NothingGrasped(
                "the grasp is not in the recording", grasped_s=grasped_s, begun_s=take.begun_s, now_s=now_s
            )
        gripper_m = self._body.recent_gripper_m()
        if gripper_m is None:
            raise BodySilent("the body does not say where its fingers are")
        if not holds_something(gripper_m):
            raise NothingGrasped("nothing is between the fingers", gripper_m=round(gripper_m, 4))
