"""Errors of the robot plane.

RodeoError
└── Ros2Error
    ├── UnknownType             no such interface in the type store
    ├── MalformedMessage        bytes that are not a message of the type
    ├── ServiceUnavailable      nobody serves the name and type
    ├── ServiceTimeout          somebody may serve it, no answer in time
    ├── ServiceFailed           the server answered with an error
    └── ActionError
        ├── ActionServerUnavailable
        ├── ActionServerLost    the server went away, or came back without the goal
        ├── GoalRejected
        ├── GoalAborted         carries the result
        ├── GoalCanceled        carries the result
        └── GoalTimeout
"""

from __future__ import annotations

from typing import Any

from rodeo.errors import RodeoError


class Ros2Error(RodeoError):
    """Something on the robot plane did not work."""


class UnknownType(Ros2Error):
    """The interface type is neither in the ROS 2 Jazzy store nor among our declarations."""

    machines = False


class MalformedMessage(Ros2Error):
    """The bytes are not a CDR message of the type they claim to be."""

    machines = False


class ServiceUnavailable(Ros2Error):
    """No server for this service name and type."""


class ServiceTimeout(Ros2Error):
    """The service did not answer within the time given (wall seconds)."""


class ServiceFailed(Ros2Error):
    """The server answered with an error instead of a response."""


class ActionError(Ros2Error):
    """An action did not end in success."""


class ActionServerUnavailable(ActionError):
    """No server for this action name and type."""


class ActionServerLost(ActionError):
    """The server disappeared with the goal, or no longer knows it."""


class GoalRejected(ActionError):
    """The server did not accept the goal."""


class GoalTimeout(ActionError):
    """The goal did not end within the time given (wall seconds); it may still be running."""


class _GoalEnded(ActionError):
    """A goal that ended without success, with what the server returned."""

    def __init__(self, message: str, result: Any, **details: Any) -> None:
        super().__init__(message, **details)
        self.result = result


class GoalAborted(_GoalEnded):
    """The server gave up; `.result` says why."""


class GoalCanceled(_GoalEnded):
    """The goal was cancelled; `.result` is what was reached."""
