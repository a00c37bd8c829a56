"""Errors of a robot at work.

RodeoError
└── AgentError
    ├── Stopped             the process is asked to end; work is resumed after the next start
    ├── Halted              an operator stopped the robot; work is resumed as after a restart
    ├── Cancelled           an operator gave up the attempt
    ├── JournalBroken       a file that the agent keeps is not what it wrote
    ├── CapReached          buying more would exceed the daily spending cap
    ├── Revoked             the task is no longer assigned to this robot: expired, cancelled or decided
    ├── BodySilent          the body or the motion capture does not report
    ├── MotionFailed        the body could not do a motion
    │   └── Blocked         nowhere to stand could be reached, for as long as the robot has patience
    ├── Unreachable         no arm configuration, or no place to stand, for a pose
    ├── NotFound            the item is not where it should be
    ├── GraspFailed         the item is not in the gripper after grasping
    ├── EvidenceHole        a stretch of the work is not in the recording
    │   └── WrongClock      a computer of the robot does not stamp with the site's time
    ├── NoAnswer            another device did not answer in time
    ├── TakenOut            what was dropped did not stay in the bin
    └── TaskFailed          the task cannot be done; the cause says why
"""

from __future__ import annotations

from rodeo.errors import RodeoError


class AgentError(RodeoError):
    """Something kept the agent from doing what it wanted."""


class Stopped(AgentError):
    """The process is asked to end."""


class Halted(AgentError):
    """An operator stopped the robot."""


class Cancelled(AgentError):
    """An operator gave up the attempt."""


class JournalBroken(AgentError):
    """A file that must survive restarts cannot be read; starting without it could do things twice."""

    restart_cures = False


class CapReached(AgentError):
    """The wallet has spent what the site file allows within 24 hours."""


class Revoked(AgentError):
    """The assignment no longer exists, so there is no point in going on."""


class BodySilent(AgentError):
    """No fresh message on a topic that the agent depends on."""


class MotionFailed(AgentError):
    """The body gave up a motion; `details` carry what it said."""


class Blocked(MotionFailed):
    """None of the places to stand could be reached, and waiting did not help."""


class Unreachable(AgentError):
    """No collision-free arm configuration, or no place to stand, for what is wanted."""


class NotFound(AgentError):
    """The camera sees no such item near the place that was named."""


class GraspFailed(AgentError):
    """The fingers closed and the item is not between them."""


class EvidenceHole(AgentError):
    """A stretch of the work is not in the recording, so it would not convince the oracle."""


class NoAnswer(AgentError):
    """Another device on the site did not answer in the time it was given."""


class WrongClock(EvidenceHole):
    """A computer of the robot does not stamp with the site's time."""


class TakenOut(AgentError):
    """The bin states that weight left the compartment after the drop: the work would not be paid."""


class TaskFailed(AgentError):
    """The task cannot be completed in this attempt."""
