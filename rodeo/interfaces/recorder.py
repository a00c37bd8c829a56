"""What a mind that is a ROS 2 node asks of its robot's recorder, and what it is answered."""

from __future__ import annotations

from pydantic import Field

from rodeo.bus.messages import Id, Instant, Message
from rodeo.interfaces.problem import Problem
from rodeo.site import topics


class StartRecording(Message):
    """Record an attempt from now on. The response comes when motion capture lists the recording and has shown
    the robot and what the task is about: what is moved before proves nothing."""

    task_id: Id
    """The task, which is assigned to the robot."""
    attempt: int = Field(ge=1, lt=2**32)
    """The attempt, counted from 1."""


class RecordingStarted(Message):
    """The response of StartRecording."""

    problem: Problem | None
    recording: str
    """Digest of the recording's first seal, as the bin's and motion capture's statements name it."""
    resumed: bool
    """Whether an interrupted recording continues, because something had been done for good. Else the work
    begins anew, from what is seen."""


class Present(Message):
    """Tell a bin that this robot shows it something next. Send it before the item is held into view; the
    response comes when the bin has said what it is."""

    bin: str = Field(min_length=1, max_length=64)
    """The bin, by its name on the site."""
    grasped: Instant
    """When the fingers closed on the item, on the site's clock."""


class Presented(Message):
    """The response of Present: what the bin stated of what this robot showed."""

    problem: Problem | None
    item_class: str
    """The class, unknown if the bin cannot tell."""
    compartment: str
    """Where the item belongs."""
    full: bool
    """Whether that compartment takes no more."""
    another_angle: bool
    """Whether the bin would like to see the item from another side: turn it, and present it again."""


class StopRecording(Message):
    """End the recording once it holds what a proof of this kind of work needs, such as the bin's word on the
    drop, and that the item stays there; seal it and store it. Sent again, it is answered the same."""

    task_id: Id
    attempt: int = Field(ge=1, lt=2**32)
    failure: str = Field(default="", max_length=1000)
    """Why the work was given up; the recording then ends at once. Empty: the work is done."""


class RecordingStopped(Message):
    """The response of StopRecording: what submit_proof takes."""

    problem: Problem | None
    proof_uri: str
    proof_sha256: str
    missing: str
    """What the recording lacks, if anything: the oracle judges it as it is."""


class RobotOrders(Message):
    """What operators ordered, which holds until they order something else."""

    paused: bool
    """Finish the attempt, and take no new work. Nothing else can be recorded."""
    stopped: bool
    """The body stands still and rejects goals."""
    charge: bool
    """Buy a charge now. Holds until the robot has posted a task for one."""
    cancelled: bool
    """Give up the attempt that is being recorded: StopRecording, with the failure."""


SERVICES: dict[str, tuple[type[Message], type[Message]]] = {
    topics.START_RECORDING.key: (StartRecording, RecordingStarted),
    topics.PRESENT.key: (Present, Presented),
    topics.STOP_RECORDING.key: (StopRecording, RecordingStopped),
}
"""Service -> its request and its response."""
