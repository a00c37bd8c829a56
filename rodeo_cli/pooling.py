"""Options of the commands that may use a pool, and the engine that they get."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rodeo.errors import ConfigError
from rodeo.site.config import Site

if TYPE_CHECKING:
    from rodeo.jobs.job import Engine, Work

TLS = Path("out/pool/tls")

PoolOption = Annotated[
    str | None,
    typer.Option("--pool", help="Use the workers of the pool at tls://HOST:PORT.", metavar="ADDRESS"),
]
TlsOption = Annotated[
    Path,
    typer.Option(
        "--pool-tls", envvar="RODEO_POOL_TLS", help="Folder of the pool's certificates.", metavar="FOLDER"
    ),
]
TrustOption = Annotated[
    bool, typer.Option("--trust-pool", help="Use a pool although this user can read the site's keys.")
]


def engine(
    address: str | None, site: Site, works: Sequence[Work], tls: Path = TLS, trust: bool = False
) -> Engine | None:
    """The engine of the pool at `address`; None without one.

    Raises ConfigError where this process could read the site's keys and `trust` is not set; PoolError.
    """
    if address is None:
        return None
    for keys in (site.data_dir / "keys", site.data_dir / "tls"):
        if (os.access(keys, os.R_OK) or os.access(keys, os.X_OK)) and not trust:
            raise ConfigError(
                "a pool's workers can run code in this process, which can read the site's keys: use another "
                "user or machine, or --trust-pool",
                keys=str(keys),
            )
    from rodeo_pool.engine import Dask  # takes its time to import

    return Dask(address, tls, {work.name: work for work in works}, site.store.max_bytes)
