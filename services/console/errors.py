"""Errors of the console.

RodeoError
├── LoginRefused            name and password do not belong together, or the account is disabled
├── TooManyAttempts         the login is closed to this address for a while
├── NotLoggedIn             no session, or one that has ended; no token, or one that was revoked
├── Forbidden               the person does not have a role that may do this
└── RequestError
    ├── AccountExists
    ├── UnknownAccount
    ├── WeakPassphrase
    ├── UnknownFile         the task has no such file
    └── RobotUnavailable    the robot's agent does not answer
"""

from __future__ import annotations

from rodeo.errors import RequestError, RodeoError


class LoginRefused(RodeoError):
    """Name and passphrase do not belong together, or the account is disabled; which of them is not said."""


class TooManyAttempts(RodeoError):
    """The login is closed to this address for `retry_after_s`."""


class NotLoggedIn(RodeoError):
    """There is no session or token, or it has ended."""


class Forbidden(RodeoError):
    """The person has none of the roles that may do this."""


class AccountsDamaged(RodeoError):
    """The accounts' file is no whole database."""

    restart_cures = False


class AccountExists(RequestError):
    """There is an account of this name already."""


class UnknownAccount(RequestError):
    """There is no account or token of this name."""


class WeakPassphrase(RequestError):
    """The passphrase is too short to protect anything."""


class UnknownFile(RequestError):
    """The task has no such file."""


class RobotUnavailable(RequestError):
    """The robot's agent does not answer."""
