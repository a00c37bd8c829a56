"""Errors of accounts.

RodeoError
├── LoginRefused            name and password do not belong together, or the account is disabled
├── NotLoggedIn             no session, or one that has ended; no token, or one that was revoked
├── AccountsDamaged         the accounts' file is no whole database
└── RequestError
    ├── AccountExists
    ├── UnknownAccount
    └── WeakPassphrase
"""

from __future__ import annotations

from rodeo.errors import RequestError, RodeoError


class LoginRefused(RodeoError):
    """Wrong name or passphrase, or a disabled account; the error does not reveal which."""


class NotLoggedIn(RodeoError):
    """There is no session or token, or it has ended."""


class AccountsDamaged(RodeoError):
    """The accounts' file is no whole database."""

    restart_cures = False


class AccountExists(RequestError):
    """There is an account of this name already."""


class UnknownAccount(RequestError):
    """There is no account or token of this name."""


class WeakPassphrase(RequestError):
    """The passphrase is too short to protect anything."""
