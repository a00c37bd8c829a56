"""What a kind of work can have a robot do, whatever the robot is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from rodeo.lab.config import DockConfig, ItemConfig, Pose2
from rodeo.robot.memory import Held
from rodeo.robot.perception import Sighting, View

Checkpoint = Callable[[], None]
"""Called at least every 0.1 s while something is waited for; raises what should end the wait."""

Point = tuple[float, float]
Point3 = tuple[float, float, float]

PATIENCE_S = 300.0
"""Site time for which a place that cannot be reached is tried again: who stands in the way may move on, and
another robot takes this long to pick something up while planning goes at wall speed."""


class Body(Protocol):
    """A base that drives, an arm with two fingers, and a depth camera at the wrist.

    Places are in the frame `map`: m and rad, z up from the floor. Each method returns when it is done. It
    raises what `checkpoint` raises, BodySilent when the robot tells nothing of itself any more, MotionFailed
    when the robot gives up a motion, and Unreachable when the arm cannot get there.
    """

    def here(self, checkpoint: Checkpoint) -> Pose2:
        """Where the base stands."""
        ...

    def drive(self, poses: Sequence[Pose2], checkpoint: Checkpoint, patience_s: float = PATIENCE_S) -> None:
        """To the first of `poses` (at least one) that can be reached; tries again for `patience_s` of site
        time. Raises Blocked."""
        ...

    def dock(self, at: DockConfig, checkpoint: Checkpoint) -> None:
        """Onto the dock's contacts, unless the robot stands there. Raises MotionFailed."""
        ...

    def leave(self, parked: Pose2, checkpoint: Checkpoint) -> None:
        """Away from the narrow place `parked`, for whoever comes next; stays where there is no way out."""
        ...

    def wait(self, seconds: float, checkpoint: Checkpoint) -> None:
        """Let so much site time pass."""
        ...

    def fold(self, checkpoint: Checkpoint) -> None:
        """The arm, for driving with nothing in the fingers."""
        ...

    def carry(self, checkpoint: Checkpoint) -> None:
        """Bring the fingers over the deck, for driving with something in them, or in a narrow place."""
        ...

    def look(self, checkpoint: Checkpoint, turn_rad: float = 0.0) -> list[View]:
        """At the floor ahead, the camera turned to the left by `turn_rad`. Raises NoAnswer."""
        ...

    def look_down(
        self, place: Point, checkpoint: Checkpoint, height_m: float, left_m: float = 0.0
    ) -> list[View]:
        """At `place`, within the arm's reach, from above: the fingers at `height_m`, `left_m` to the left.
        Raises NoAnswer."""
        ...

    def open_fingers(self, checkpoint: Checkpoint) -> None:
        """Unless they are open."""
        ...

    def grasp(self, item: ItemConfig, sighting: Sighting, checkpoint: Checkpoint) -> Held:
        """Take the item, which lies ahead as it was seen, and lift it over the deck. Raises GraspFailed."""
        ...

    def held(self, checkpoint: Checkpoint) -> Held | None:
        """What is between the fingers, as the fingers feel it."""
        ...

    def holding(self, checkpoint: Checkpoint) -> Checkpoint:
        """`checkpoint` that also raises GraspFailed when the fingers have closed on nothing."""
        ...

    def show(self, held: Held, point: Point3, checkpoint: Checkpoint, turn_rad: float = 0.0) -> None:
        """Hold the middle of `held` at `point`, the fingers turned by `turn_rad` about the vertical."""
        ...

    def place(self, held: Held, point: Point3, checkpoint: Checkpoint, releasing: Callable[[], None]) -> None:
        """Lower `held` until its lower end is 2 cm above `point`, call `releasing`, and open the fingers."""
        ...

    def draw_back(self, checkpoint: Checkpoint) -> None:
        """From where something was placed, without a pause: straight up, then over the deck."""
        ...

    def put_back(self, held: Held, checkpoint: Checkpoint) -> None:
        """Lay what is held on the floor where it was taken, for whoever takes it next, and fold the arm."""
        ...
