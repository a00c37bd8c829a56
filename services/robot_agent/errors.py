"""Errors of the agent.

RodeoError
└── AgentError
    ├── Stopped             the process is asked to end; work is resumed after the next start
    ├── Revoked             the assignment is gone: expired, cancelled or decided
    ├── BodySilent          the body or the motion capture does not report
    ├── MotionFailed        the body could not do a motion
    ├── Unreachable         no arm configuration, or no place to stand, for a pose
    ├── GraspFailed         the item is not in the gripper after grasping
    ├── NoAnswer            another device did not answer in time
    └── TaskFailed          the task cannot be done; the cause says why
"""

from __future__ import annotations

from rodeo.errors import RodeoError


class AgentError(RodeoError):
    """Something kept the agent from doing what it wanted."""


class Stopped(AgentError):
    """The process is asked to end."""


class Revoked(AgentError):
    """The assignment no longer exists, so there is no point in going on."""


class BodySilent(AgentError):
    """No fresh message on a topic that the agent depends on."""


class MotionFailed(AgentError):
    """The body gave up a motion; `details` carry what it said."""


class Unreachable(AgentError):
    """No collision-free arm configuration, or no place to stand, for what is wanted."""


class GraspFailed(AgentError):
    """The fingers closed and the item is not between them."""


class EvidenceHole(AgentError):
    """A stretch of the work is not in the recording, so it would not convince the oracle."""


class NoAnswer(AgentError):
    """Another device on the site did not answer in the time it was given."""


class TaskFailed(AgentError):
    """The task cannot be completed in this attempt."""
