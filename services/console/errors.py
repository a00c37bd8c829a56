"""Errors of the console; those of accounts are in `rodeo.access.errors`.

RodeoError
├── TooManyAttempts         the login is closed to this address for a while
├── Forbidden               the person does not have a role that may do this
├── TooManyStreams          an account, or all together, read too many streams of events
└── RequestError
    ├── UnknownFile         the task has no such file
    ├── InvalidEventId      a stream cannot continue after what is no id
    ├── UnknownEventId      a stream cannot continue after an event that is not there
    └── RobotUnavailable    the robot's agent does not answer
"""

from __future__ import annotations

from rodeo.errors import RequestError, RodeoError


class TooManyAttempts(RodeoError):
    """The login is closed to this address for `retry_after_s`."""


class Forbidden(RodeoError):
    """The person has none of the roles that may do this."""


class TooManyStreams(RodeoError):
    """As many streams of events are `open` as the `limit` says."""


class InvalidEventId(RequestError):
    """This is no id of a server-sent event."""


class UnknownEventId(RequestError):
    """The event is of another chain, of a former index, or not there yet."""


class UnknownFile(RequestError):
    """The task has no such file."""


class RobotUnavailable(RequestError):
    """The robot's agent does not answer."""
