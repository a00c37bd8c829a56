"""What a kind of work can ask of a robot, independent of its hardware."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from rodeo.lab.config import DockConfig, ItemConfig, Pose2
from rodeo.robot.memory import Held
from rodeo.robot.perception import Sighting, View

Point = tuple[float, float]
Point3 = tuple[float, float, float]

PATIENCE_S = 300.0
"""Site time for which the robot retries a blocked place. An obstacle may move away; another robot takes this
long to pick something up while planning runs at wall speed."""


class Body(Protocol):
    """A base that drives, an arm with two fingers, and a depth camera at the wrist.

    Places are in the frame `map`: m and rad, z up from the floor. Each method returns when it is done. It
    raises an error of the agent's when the work must end or pause (a behaviour lets it pass), BodySilent when
    the robot stops publishing its state, MotionFailed when the robot gives up a motion, and Unreachable when
    the arm cannot get there.
    """

    def here(self) -> Pose2:
        """Where the base stands."""
        ...

    def drive(self, poses: Sequence[Pose2], patience_s: float = PATIENCE_S) -> None:
        """Drive to the first of `poses` (at least one) that can be reached; retries for `patience_s` of site
        time. Raises Blocked."""
        ...

    def dock(self, at: DockConfig) -> None:
        """Drive onto the dock's contacts, unless the robot stands there. Raises MotionFailed."""
        ...

    def leave(self, parked: Pose2) -> None:
        """Drive away from the narrow place `parked` to make room; stays if there is no path."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait for this much site time."""
        ...

    def fold(self) -> None:
        """Fold the arm, for driving with nothing in the fingers."""
        ...

    def carry(self) -> None:
        """Bring the fingers over the deck, for driving with something in them, or in a narrow place."""
        ...

    def look(self, turn_rad: float = 0.0) -> list[View]:
        """Look at the floor ahead, with the camera turned to the left by `turn_rad`. Raises NoAnswer."""
        ...

    def look_down(self, place: Point, height_m: float, left_m: float = 0.0) -> list[View]:
        """Look at `place`, within reach, from above, with the fingers at `height_m`, `left_m` to the left.
        Raises NoAnswer."""
        ...

    def open_fingers(self) -> None:
        """Open the fingers, unless they are open."""
        ...

    def grasp(self, item: ItemConfig, sighting: Sighting, weighs: bool = False) -> Held:
        """Take the item, which lies ahead as it was seen, and lift it over the deck. Raises GraspFailed.

        With `weighs` the arm does the same lift once without the item before, and tells by the difference
        what the item weighs; only where it `feels`.
        """
        ...

    def feels(self) -> bool:
        """Whether the arm's joints say their torques."""
        ...

    def picture(self) -> bytes:
        """A colour picture from the wrist, now: a sensor_msgs/msg/CompressedImage as CDR. Raises NoAnswer."""
        ...

    def held(self) -> Held | None:
        """The object between the fingers, as measured by the fingers."""
        ...

    def holding(self) -> AbstractContextManager[None]:
        """Within this, each method also raises GraspFailed when the fingers have closed on nothing."""
        ...

    def show(self, held: Held, point: Point3, turn_rad: float = 0.0) -> None:
        """Hold the middle of `held` at `point`, the fingers turned by `turn_rad` about the vertical."""
        ...

    def place(self, held: Held, point: Point3, releasing: Callable[[], None]) -> None:
        """Lower `held` until its lower end is 2 cm above `point`, call `releasing`, and open the fingers."""
        ...

    def draw_back(self) -> None:
        """Retract the arm after placing something, without a pause: straight up, then over the deck."""
        ...

    def put_back(self, held: Held) -> None:
        """Put the held object back on the floor where it was taken, and fold the arm."""
        ...
