"""What can go wrong between a client and a pool.

RodeoError
└── PoolError
    ├── PoolFilesMissing    a certificate of the pool, or its key, is not there
    ├── PoolUnavailable     nothing answers at the address, or it refuses this client's certificate
    └── NoDashboard         the dashboard needs a package that is not installed
"""

from __future__ import annotations

from rodeo.errors import RodeoError


class PoolError(RodeoError):
    """The pool cannot be used."""


class PoolFilesMissing(PoolError):
    """A certificate of the pool, or its key, is not there."""


class PoolUnavailable(PoolError):
    """Nothing answers at the pool's address, or it refuses the certificate that was shown."""


class NoDashboard(PoolError):
    """The dashboard needs a package that is not installed."""
