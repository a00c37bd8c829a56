"""Threads that answer requests, and one that asks again until the bridge answers."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import zenoh

from rodeo.errors import RodeoError
from rodeo.runtime.process import is_transient

log = logging.getLogger(__name__)

MOST_WAITING = 256
"""Requests that wait for a thread; further ones are refused."""

RETRY_S = 1.0
"""Wall time before something that is away is asked again."""


class Busy(RodeoError):
    """Too many requests of this participant wait."""


def passes(error: RodeoError) -> bool:
    """Whether only the bridge, the chain, the disk or this process cannot now."""
    return isinstance(error, Busy) or is_transient(error)


def mined_in_vain(error: RodeoError) -> bool:
    """Whether a transaction failed: the same request has this answer from now on."""
    return error.code == "transaction_failed"


class Workers:
    """Threads for what one participant asks."""

    def __init__(self, name: str, threads: int) -> None:
        self._threads = ThreadPoolExecutor(threads, thread_name_prefix=name)
        self._room = threading.BoundedSemaphore(threads + MOST_WAITING)
        self.stop = threading.Event()

    def submit(self, work: Callable[[], None]) -> None:
        """Have `work` done by a thread. Raises Busy."""
        if not self._room.acquire(blocking=False):
            raise Busy("too many requests wait: send this one again later", most=MOST_WAITING)
        try:
            self._threads.submit(self._work, work)
        except RuntimeError:
            # The threads have ended: a client of a process that stops hears that nobody answers.
            log.debug("stopping; did not answer")

    def _work(self, work: Callable[[], None]) -> None:
        try:
            work()
        except zenoh.ZError as error:
            log.info("did not answer, because this process is leaving the bus: %s", error)
        except Exception:
            log.exception("a request failed")
        finally:
            self._room.release()

    def close(self) -> None:
        self.stop.set()
        self._threads.shutdown(wait=False, cancel_futures=True)


class Follower:
    """A thread that does pieces of work, each again until what is away has answered. Close it before the
    bus."""

    def __init__(self) -> None:
        self._waiting: dict[bytes, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="follower", daemon=True)
        self._thread.start()

    def soon(self, key: bytes, work: Callable[[], None]) -> None:
        """Have `work` done, once if it is asked for again before."""
        with self._changed:
            self._waiting[key] = work
            self._changed.notify()

    def later(self, key: bytes, work: Callable[[], None]) -> None:
        """The same, after about `RETRY_S`."""
        with self._changed:
            self._waiting[key] = work

    def _run(self) -> None:
        while not self._stop.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._stop.is_set(), RETRY_S)
                now, self._waiting = self._waiting, {}
            for key, work in now.items():
                if not self._stop.is_set() and not self._done(work):
                    with self._changed:
                        self._waiting.setdefault(key, work)
            if self._waiting:
                self._stop.wait(RETRY_S)

    def _done(self, work: Callable[[], None]) -> bool:
        try:
            work()
        except RodeoError as error:
            if passes(error):
                log.info("trying again: %s", error)
                return False
            log.error("%s: %s", error.code, error)
        except Exception:
            if not self._stop.is_set():
                log.exception("following a goal failed")
        return True

    def close(self) -> None:
        self._stop.set()
        with self._changed:
            self._changed.notify()
        self._thread.join(timeout=2.0)
