"""What can go wrong between a client and a pool.

RodeoError
└── PoolError
    ├── KeysWithinReach     this process could read the site's keys
    ├── PoolFilesMissing    a certificate of the pool, or its key, is not there
    ├── PoolFilesDamaged    a certificate of the pool, or its key, is none, or another's
    ├── PoolUnavailable     nothing answers at the address or can listen there, or it refuses the certificate
    └── NoDashboard         the dashboard needs a package that is not installed
"""

from __future__ import annotations

from rodeo.errors import RodeoError


class PoolError(RodeoError):
    """The pool cannot be used."""


class KeysWithinReach(PoolError):
    """This process could read the site's keys, and a pool's workers can run code in it."""


class PoolFilesMissing(PoolError):
    """A certificate of the pool, or its key, is not there."""


class PoolFilesDamaged(PoolError):
    """A certificate of the pool, or its key, cannot be read, or is not of that authority."""


class PoolUnavailable(PoolError):
    """Nothing answers at the pool's address or can listen there, or it refuses the certificate that was
    shown."""


class NoDashboard(PoolError):
    """The dashboard needs a package that is not installed."""
