"""Commands that run a pool: machines that do the jobs of audits and studies."""

from __future__ import annotations

import asyncio
import socket
from typing import Annotated, Any

import typer

from rodeo.display.formatting import count
from rodeo.site.config import Site
from rodeo_cli.common import DEFAULT_SITE, SiteOption, reports_errors, say
from rodeo_cli.pooling import TLS, TlsOption, over_tls

pool = typer.Typer(help="Run a pool of machines for audits and studies.", no_args_is_help=True)


def _number(least: int) -> Any:
    return typer.Option(min=least, max=256, help="Number of workers.", show_default="one for each core")


@pool.command()
@reports_errors
def start(
    workers: Annotated[int | None, _number(0)] = None,
    host: Annotated[str, typer.Option(help="Address of this machine to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 is any free one.")] = 8786,
    tls: TlsOption = TLS,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Serve dask's dashboard on this machine, on port 8787.")
    ] = False,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Start a pool's scheduler and workers on this machine, until Ctrl-C.

    The first start makes the pool's certificates. Whoever has one can run code on every machine of the pool.
    """
    from rodeo_pool.serving import Pool, cores

    Site.load(site)  # workers would only fail at their first job
    number = cores() if workers is None else workers

    def started(address: str) -> None:
        say(f"The pool at {address} has {count(number, 'worker')}. Ctrl-C stops it.")
        files = f"ca.pem, worker.pem and worker.key of {tls}"
        say(f"Another machine joins with {files}: rodeo pool worker {address}")

    asyncio.run(Pool(tls, site, host, port, number, dashboard).serve(started, say))


@pool.command()
@reports_errors
def worker(
    address: Annotated[
        str,
        typer.Argument(callback=over_tls, help="The pool's address, tls://HOST:PORT.", metavar="ADDRESS"),
    ],
    workers: Annotated[int | None, _number(1)] = None,
    tls: TlsOption = TLS,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Let this machine work for a pool, until Ctrl-C.

    It judges proofs by the lab of its own site file, and reads them from that file's store with credentials
    of its own.
    """
    from rodeo_pool.serving import cores, join

    Site.load(site)
    number = cores() if workers is None else workers
    joined = f"{count(number, 'worker')} of {socket.gethostname()} joined {address}."
    asyncio.run(join(tls, site, address, number, lambda: say(joined)))
