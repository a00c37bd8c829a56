"""The chain process: the backend that the site file names, on the site's clock, with a heartbeat."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from deploy.chain.anvil import STATE_FILE, Anvil
from deploy.chain.errors import AnvilFailed, ChainStoreUnwritable
from deploy.chain.local_chain import LocalChain
from deploy.chain.methods import MINING, Methods
from deploy.chain.record import check_not_lost
from deploy.chain.server import RpcServer
from deploy.chain.store import Store
from rodeo.errors import ClockUnavailable
from rodeo.host.clock import Clock, WallClock
from rodeo.host.instance import HEARTBEAT_S, PREDECESSOR_S, lock_instance
from rodeo.runtime.process import Process
from rodeo.site.config import Site

log = logging.getLogger(__name__)


class SiteTime:
    """The site's time in whole seconds, None until it is known; the chain serves before it is."""

    def __init__(self, site: Site) -> None:
        self._clock: Clock | None = WallClock() if site.clock.source == "wall" else None

    def follow(self, clock: Clock) -> None:
        self._clock = clock

    def hold(self) -> AbstractContextManager[None]:
        """Work in this context takes no site time, on a site whose clock waits for its chain."""
        return nullcontext() if self._clock is None else self._clock.hold()

    def now_s(self) -> int | None:
        try:
            return None if self._clock is None else int(self._clock.now_s())
        except ClockUnavailable:
            return None


def run(site: Site, stop: threading.Event) -> None:
    """Serve the site's chain until `stop`.

    Raises WrongGenesis, ChainStoreCorrupted, ChainLost, AnvilFailed, AlreadyRunning or PortUnavailable.
    """
    backend = _BACKENDS[site.chain.backend]
    folder = site.data_dir / "chain" / site.chain.backend
    site_time = SiteTime(site)
    backend(site, folder, site_time, stop)


def _run_embedded(site: Site, folder: Path, site_time: SiteTime, stop: threading.Event) -> None:
    check_not_lost(site, folder / "chain.sqlite")
    lock_instance(folder, PREDECESSOR_S, stop)
    store = Store(folder / "chain.sqlite")
    local_chain = LocalChain(store, site.chain.id, site.clock.begin_s(), site_time.now_s)
    log.info("chain %d at block %d on %s", site.chain.id, local_chain.head.block_number, site.chain.shown_url)
    methods = Methods(local_chain)

    def answer(method: str, params: Sequence[Any]) -> Any:
        # Who only reads waits for the answer itself.
        with site_time.hold() if method in MINING else nullcontext():
            return methods(method, params)

    with RpcServer(site.chain.url, answer) as server:

        def block_number() -> int:
            if store.failure is not None:
                server.do(store.try_to_write)
            return local_chain.head.block_number

        _keep_heartbeat(site, site_time, stop, block_number, stop.wait)
    store.close()


def _run_anvil(site: Site, folder: Path, site_time: SiteTime, stop: threading.Event) -> None:
    check_not_lost(site, folder / STATE_FILE)
    with Anvil(site.chain.url, folder, site.chain.id, site.clock.begin_s(), site_time.now_s) as anvil:
        log.info("anvil, chain %d at block %d on %s", site.chain.id, anvil.block_number(), site.chain.url)
        _keep_heartbeat(site, site_time, stop, anvil.block_number, lambda: anvil.wait(stop))


def _run_external(site: Site, _folder: Path, site_time: SiteTime, stop: threading.Event) -> None:
    log.info("the site uses an external chain at %s; no local chain is started", site.chain.shown_url)


_BACKENDS: dict[str, Callable[[Site, Path, SiteTime, threading.Event], None]] = {
    "eth-tester": _run_embedded,
    "anvil": _run_anvil,
    "external": _run_external,
}


def _keep_heartbeat(
    site: Site,
    site_time: SiteTime,
    stop: threading.Event,
    block_number: Callable[[], int],
    wait: Callable[[], object],
) -> None:
    """Join the bus when there is one, for the clock and the heartbeat, while `wait()` runs.

    The chain is not ready while `block_number()` raises AnvilFailed or ChainStoreUnwritable.
    """

    def beat() -> None:
        with Process("chain", site, stop) as process:
            site_time.follow(process.clock)
            process.ready()
            while not stop.wait(HEARTBEAT_S):
                try:
                    process.activity("serving blocks", block=block_number())
                    process.ready()
                except (AnvilFailed, ChainStoreUnwritable) as error:
                    # Anvil is busy; whether it has ended is watched by `wait`.
                    process.not_ready(str(error))

    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="presence") as background:
        presence = background.submit(beat)
        # A chain whose clock has failed must not continue stamping blocks.
        presence.add_done_callback(lambda _: stop.set())
        try:
            wait()
        finally:
            stop.set()
    presence.result()
