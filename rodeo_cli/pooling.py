"""Options of the commands that may use a pool, and the engine that they get."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rodeo.site.config import Site
from rodeo_pool.errors import KeysWithinReach

if TYPE_CHECKING:
    from rodeo.jobs.job import Engine, Work

TLS = Path("out/pool/tls")


def over_tls(given: str | None) -> str | None:
    """The address that was given. Raises BadParameter for one that dask would try without TLS."""
    if given is not None and not given.startswith("tls://"):
        raise typer.BadParameter("the address of a pool is tls://HOST:PORT")
    return given


PoolOption = Annotated[
    str | None,
    typer.Option(
        "--pool",
        callback=over_tls,
        help="Use the workers of the pool at tls://HOST:PORT.",
        metavar="ADDRESS",
    ),
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
    address: str | None,
    site: Site,
    works: Sequence[Work],
    tls: Path = TLS,
    trust: bool = False,
    beside: Path | None = None,
) -> Engine | None:
    """The engine of the pool at `address`; None without one. `beside` is the file of a site whose keys lie
    beside those of `site`.

    Raises KeysWithinReach unless `trust` is set, and other PoolErrors.
    """
    if address is None:
        return None
    folders = [one.data_dir for one in (site, *(() if beside is None else (Site.load(beside),)))]
    for keys in (folder / name for folder in folders for name in ("keys", "tls")):
        if (os.access(keys, os.R_OK) or os.access(keys, os.X_OK)) and not trust:
            raise KeysWithinReach(
                "a pool's workers can run code in this process, which can read the site's keys: use another "
                "user or machine, or --trust-pool",
                keys=str(keys),
            )
    from rodeo_pool.engine import Dask  # takes its time to import

    return Dask(address, tls, {work.name: work for work in works}, site.store.max_bytes)
