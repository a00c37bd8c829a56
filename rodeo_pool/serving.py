"""A pool's scheduler and workers, each until it is asked to stop."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import dask
from distributed import Nanny, Scheduler
from distributed.core import connect
from distributed.diagnostics.plugin import SchedulerPlugin

from rodeo.display.formatting import count
from rodeo_pool.authority import ensure, security
from rodeo_pool.errors import NoDashboard, PoolUnavailable
from rodeo_pool.work import SITE_VARIABLE

PORT = 8786
"""Dask's usual one."""
_LOOPBACK = "127.0.0.1"
_SILENT_S = 30.0
"""A worker without a heartbeat for so long is restarted by its nanny, and its units are given to others."""


@dataclass(frozen=True)
class Pool:
    """A scheduler on this machine, and `workers` beside it.

    Args:
        folder: of the pool's certificates; what is missing there is made.
        site: site file whose lab and store count for the workers.
        host, port: where the scheduler listens; 0 is any free port.
        silent_s: longest time without a worker's heartbeat, s.
    """

    folder: Path
    site: Path
    host: str = _LOOPBACK
    port: int = PORT
    workers: int = 1
    dashboard: bool = False
    silent_s: float = _SILENT_S

    async def serve(self, started: Callable[[str], None], say: Callable[[str], None]) -> None:
        """Call `started` with the pool's address once its workers have joined, then `say` who joins and who
        leaves; ends at a signal.

        Raises NoDashboard, and PoolUnavailable where it cannot listen.
        """
        if self.dashboard and find_spec("bokeh") is None:
            raise NoDashboard("the dashboard needs bokeh: pip install bokeh")
        ensure(self.folder)
        with _settings(self.silent_s, self.dashboard):
            await _until_a_signal(self._serve(started, say))

    async def _serve(self, started: Callable[[str], None], say: Callable[[str], None]) -> None:
        async with (
            await self._scheduler() as scheduler,
            _workers(self.folder, self.site, scheduler.address, self.workers, self.host),
        ):
            started(scheduler.address)
            scheduler.add_plugin(told := _Told(say))
            try:
                await scheduler.finished()
            finally:
                scheduler.remove_plugin(told.name)

    async def _scheduler(self) -> Scheduler:
        scheduler = Scheduler(
            host=self.host,
            port=self.port,
            protocol="tls",
            security=security(self.folder, "scheduler"),
            dashboard=self.dashboard,
            dashboard_address=f"{_LOOPBACK}:{8787 if self.dashboard else 0}",
        )
        try:
            return await scheduler
        except RuntimeError as error:
            raise PoolUnavailable(
                "the pool cannot listen there", host=self.host, port=self.port, reason=str(error.__cause__)
            ) from error


class _Told(SchedulerPlugin):
    """Says who joins and who leaves."""

    name = "told"

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def add_worker(self, scheduler: Scheduler, worker: str) -> None:
        self._say(f"{worker} joined: {count(len(scheduler.workers), 'worker')}.")

    def remove_worker(self, scheduler: Scheduler, worker: str, **_: Any) -> None:
        self._say(f"{worker} left: {count(len(scheduler.workers), 'worker')}.")


async def join(folder: Path, site: Path, address: str, workers: int, started: Callable[[], None]) -> None:
    """Add workers to the pool at `address`, until a signal.

    Raises PoolFilesMissing, and PoolUnavailable where the pool does not answer, or is gone.
    """

    async def work() -> None:
        try:
            comm = await connect(address, **security(folder, "worker").get_connection_args("worker"))
        except (OSError, ValueError) as error:
            raise PoolUnavailable(
                "the pool does not answer, or refuses this certificate", address=address, reason=str(error)
            ) from error
        await comm.close()
        async with _workers(folder, site, address, workers) as nannies:
            started()
            await asyncio.gather(*(one.finished() for one in nannies))
            raise PoolUnavailable("the pool is gone", address=address)

    with _settings(_SILENT_S):
        await _until_a_signal(work())


@asynccontextmanager
async def _workers(
    folder: Path, site: Path, address: str, count: int, host: str | None = None
) -> AsyncIterator[list[Nanny]]:
    async with AsyncExitStack() as stack:
        nannies = [
            Nanny(
                address,
                nthreads=1,  # each unit keeps a core busy, in a process of its own
                security=security(folder, "worker"),
                env={SITE_VARIABLE: str(site.absolute())},
                host=host,
                # Machines may share the folder, but not see each other's locks in it.
                local_directory=str(folder.parent / "work" / socket.gethostname()),
                silence_logs=logging.WARNING,
                dashboard=False,
                dashboard_address=f"{_LOOPBACK}:0",
            )
            for _ in range(count)
        ]
        await asyncio.gather(*map(stack.enter_async_context, nannies))
        yield nannies


async def _until_a_signal(work: Coroutine[Any, Any, None]) -> None:
    task = asyncio.ensure_future(work)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with suppress(asyncio.CancelledError):
        await task


def cores() -> int:
    """How many workers keep this machine busy."""
    return len(os.sched_getaffinity(0))


@contextmanager
def _settings(silent_s: float, dashboard: bool = False) -> Iterator[None]:
    """Dask's own, where the pool needs others."""
    logging.getLogger("distributed").setLevel(logging.WARNING)
    closed: dict[str, Any] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
    with dask.config.set(
        ({} if dashboard else closed)
        | {
            # The client hears of each death, and decides what comes of the job.
            "distributed.scheduler.allowed-failures": 0,
            "distributed.scheduler.no-workers-timeout": f"{2 * silent_s:g}s",
            "distributed.scheduler.worker-ttl": f"{silent_s:g}s",
            "distributed.scheduler.active-memory-manager.start": False,
            "distributed.worker.profile.enabled": False,
            # As soon as 64 kB are free, workers would give them back: a verification faults them in again.
            "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
            # Workers would log a traceback for each message that a scheduler did not take because it ended.
            "distributed.nanny.pre-spawn-environ.DASK_LOGGING": str(
                {"distributed": "warning", "distributed.worker": "critical"}
            ),
        }
    ):
        yield
