"""Errors of the console; those of accounts are in `rodeo.access.errors`.

RodeoError
├── TooManyAttempts         the login is closed to this address for a while
├── Forbidden               the person does not have a role that may do this
└── RequestError
    ├── UnknownFile         the task has no such file
    └── RobotUnavailable    the robot's agent does not answer
"""

from __future__ import annotations

from rodeo.errors import RequestError, RodeoError


class TooManyAttempts(RodeoError):
    """The login is closed to this address for `retry_after_s`."""


class Forbidden(RodeoError):
    """The person has none of the roles that may do this."""


class UnknownFile(RequestError):
    """The task has no such file."""


class RobotUnavailable(RequestError):
    """The robot's agent does not answer."""
