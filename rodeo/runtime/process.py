"""What every process does the same way: one instance, signals, logs, bus, clock, heartbeat, readiness."""

from __future__ import annotations

import argparse
import ctypes
import faulthandler
import gc
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

import zenoh

from rodeo.bus.messages import Status
from rodeo.bus.origin import check_bus, origin_of
from rodeo.bus.session import Bus
from rodeo.errors import (
    BusError,
    BusUnavailable,
    ClockUnavailable,
    ConfigError,
    DiskFull,
    Interrupted,
    KeystoreMissing,
    RemoteError,
    RodeoError,
)
from rodeo.host.clock import Clock, WallClock
from rodeo.host.files import is_full
from rodeo.host.instance import (
    GAVE_UP,
    HEARTBEAT_S,
    PARENT_VARIABLE,
    PREDECESSOR_S,
    forget_ending,
    lock_instance,
    note_ending,
)
from rodeo.host.metrics import BUS_CONNECTED, READY
from rodeo.runtime import disk, logs
from rodeo.runtime.clock_check import WAITING, ClockCheck
from rodeo.runtime.presence import Presence
from rodeo.runtime.serving import Claim, Rivals, Thing
from rodeo.runtime.sim_clock import SimClock
from rodeo.runtime.state import Notices, State
from rodeo.site.config import Site
from rodeo.site.minds import clock_holder
from rodeo.site.tls import identity
from rodeo.text.redaction import redacted, redacted_json

if TYPE_CHECKING:
    from rodeo.signing.keys import Key

log = logging.getLogger(__name__)

Result = TypeVar("Result")

_STANDING_LEASE_S = 60.0
"""Wall time for which a process that holds a simulated clock may stand still and is waited for."""


class Process:
    """A process of the organization, from the lock on its data to its last heartbeat.

    >>> with Process("oracle", site) as process:
    ...     process.wait_clock()
    ...     process.ready()
    ...     process.stop.wait()

    `data_dir` is the process's own folder: what must survive a restart lives there. `open_session` makes
    what stands in for a client session of our own (the router has one). Entering raises AlreadyRunning when
    another instance holds the folder and does not let go of it within PREDECESSOR_S, and BusUnavailable when
    stopped before a router was there.
    """

    def __init__(
        self,
        name: str,
        site: Site,
        stop: threading.Event | None = None,
        open_session: Callable[[], zenoh.Session] | None = None,
    ) -> None:
        self.name = name
        self.site = site
        self.stop = stop or threading.Event()
        self.data_dir: Path = site.data_dir / name
        self._open_session = open_session
        self.bus: Bus
        self.clock: Clock
        folders = disk.written_folders(site, self.data_dir)
        self.disk = disk.Disk(folders, site.disk.min_free_mb, self.stop, self.not_ready)
        self._state = State()
        self._claim: Claim | None = None
        self._rivals = Rivals()
        self._failure: RodeoError | None = None

    def __enter__(self) -> Self:
        self._instance = lock_instance(self.data_dir, PREDECESSOR_S, self.stop)
        forget_ending(self.data_dir)
        self.disk.look()
        if self._open_session is not None:
            self.bus = Bus(self._open_session())
        else:
            shown = identity(self.site, self.name)
            # A local socket ends with its process: who is silent there stands still, and may continue.
            stands = self._holder() is not None and self.site.bus.router.startswith("unixsock")
            lease_s = _STANDING_LEASE_S if stands else None
            self.bus = Bus.open(self.site.bus.router, self.stop, identity=shown, lease_s=lease_s)
            try:
                check_bus(self.bus, self.site, strict=False)
            except BaseException:
                self.bus.close()
                raise
        if self.site.clock.source == "wall":
            self.clock = WallClock()
        else:
            domain_id, end = self.site.bus.domain_id, self.stop
            self.clock = SimClock(self.bus.session, domain_id, self._holder(), starting=True, end=end)
        self.clock_check = ClockCheck(self.site, self.name, self.clock, self.bus)
        looks = self.status, self._look, self._state.hangs
        self._presence = Presence(self.name, self.site, self.bus, self.stop, *looks)
        self._presence.start()
        self.clock_check.ask()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop.set()
        self._presence.close()
        if self._claim is not None:
            self._claim.close()
        self.bus.close()
        os.close(self._instance)
        if self._failure is not None:
            raise self._failure from error

    def _look(self) -> None:
        self.disk.look()
        self.clock_check.ask()

    def fail(self, error: RodeoError) -> None:
        """End the process for `error`, from any thread."""
        log.error("%s: %s", error.code, error)
        self._failure = error
        self.not_ready(str(error))
        self.stop.set()

    # -- one at a time ---------------------------------------------------------------------------------

    def serve_alone(self, things: Iterable[Thing]) -> None:
        """Hold `things` (`rodeo.runtime.serving`) until the end; what the process does for them comes after.

        Whoever still holds one of them is waited for. Raises ServedElsewhere when that continues, and
        Interrupted when stopped before. An elder that turns up later, after a partition, ends the process.
        """

        def wait(reason: str) -> None:
            if self._state.not_ready(reason):
                log.warning("%s", reason)

        self._claim = Claim(self.bus.session, self.site.org, things, lambda: self.bus.connected)
        self._claim.take(self.stop, wait)
        self.not_ready("starting")
        self._claim.watch(self._rivals.heard, self.fail)

    def _holder(self) -> tuple[str, str] | None:
        """How the simulator's clock knows this process, if it waits for it."""
        clock = self.site.clock
        holds = clock_holder(self.name) in clock.holders and not clock.keeps_wall_time
        return (self.site.org, self.name) if holds else None

    @property
    def notices(self) -> Notices:
        return self._state.notices

    # -- readiness and progress ------------------------------------------------------------------------

    def wait_clock(self) -> None:
        """Block until there is a site time. Raises ClockUnavailable when stopped before."""
        if isinstance(self.clock, SimClock):
            self.not_ready("waiting for /clock")
            if not self.clock.wait_ready(self.stop):
                raise ClockUnavailable("stopped while waiting for /clock")
            return
        self.not_ready(WAITING)
        if not self.clock_check.wait_answered(self.stop):
            raise ClockUnavailable("stopped while waiting for the site's time")
        self.not_ready("starting")

    def wait_account(self, name: str) -> Key:
        """Open keystore `name`, waiting until there is one.

        Raises WalletError when it cannot be opened and Interrupted when stopped before.
        """
        # Imported here: not every process signs.
        from rodeo.signing import keystores

        while not self.stop.is_set():
            try:
                return keystores.open_key(self.site, name)
            except KeystoreMissing as error:
                self.not_ready(f"waiting for the keystore {error.details['path']}")
            self.stop.wait(HEARTBEAT_S)
        raise Interrupted("stopped while waiting for a keystore", name=name)

    def ready(self, lapses_s: float | None = None) -> None:
        """`lapses_s` (wall): how soon it must be said again, so that a process that hangs is not ready."""
        if self._state.ready(lapses_s):
            if isinstance(self.clock, SimClock):
                self.clock.started()
            self._presence.publish()

    def not_ready(self, reason: str) -> None:
        self._state.not_ready(reason)

    def activity(self, text: str, progress: float | None = None, **details: Any) -> None:
        """Say what the process is doing, for the terminal and the console.

        A new text is published at once, progress and details with the next heartbeat: at a thousand times
        real time a dock reads its meter, and says so, a thousand times a second.
        """
        if self._state.activity(text, progress, details):
            self._presence.publish()

    def status(self) -> Status:
        connected = self._open_session is not None or self.bus.connected
        said = self._state.now()
        # What else is wrong may well come of the clock.
        reason = "; ".join(filter(None, (self.clock_check.problem, self.disk.problem or said.reason)))
        if not connected:
            reason = f"no router at {self.site.bus.router}"
        ready = said.ready and not reason
        READY.set(ready)
        BUS_CONNECTED.set(connected)
        return Status(
            process=self.name,
            pid=os.getpid(),
            ready=ready,
            reason=redacted(reason),
            metrics_url=self._presence.url,
            activity=redacted(said.activity),
            progress=said.progress,
            since_s=self._state.started_s,
            time_s=time.time(),
            details=redacted_json(said.details),
            warnings=[
                *map(redacted, self.notices.texts()),
                *self._clock_warnings(),
                *self._rivals.warnings(),
            ],
            origin=origin_of(self.site),
            clock=self.clock_check.offset,
        )

    def _clock_warnings(self) -> list[str]:
        warning = self.clock.warning() if isinstance(self.clock, SimClock) else ""
        return [warning] if warning else []


def main(
    name: str,
    run: Callable[[Site, threading.Event], None],
    description: str,
) -> int:
    """The body of every `__main__.py`: arguments -> site -> `run(site, stop)`; returns the exit status."""
    parser = argparse.ArgumentParser(prog=name, description=description)
    parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
    arguments = parser.parse_args()

    def body(stop: threading.Event) -> None:
        site = Site.load(arguments.site)
        with noting_its_end(site.data_dir / name, stop):
            run(site, stop)

    return supervise(name, body)


def main_of_one(
    job: str,
    what: str,
    names: Callable[[Site], Sequence[str]],
    process: Callable[[Site, str], str],
    run: Callable[[Site, str, threading.Event], None],
    description: str,
) -> int:
    """The same for a process of which a site has one for each robot, bin, dock or bridge (`what`): `--<what>
    NAME` says which, by default the first of `names(site)`, and `process(site, name)` is its name then."""
    parser = argparse.ArgumentParser(prog=job, description=description)
    parser.add_argument("--site", type=Path, required=True, help="site file (TOML)")
    parser.add_argument(f"--{what}", dest="name", help=f"which {what} of the site; the first by default")
    arguments = parser.parse_args()

    def body(stop: threading.Event) -> None:
        site = Site.load(arguments.site)
        known = names(site)
        if not known:
            raise ConfigError(f"the site has no {what}")
        name = arguments.name or known[0]
        with noting_its_end(site.data_dir / process(site, name), stop):
            run(site, name, stop)

    return supervise(f"{job} {arguments.name}" if arguments.name else job, body)


@contextmanager
def noting_its_end(data_dir: Path, stop: threading.Event) -> Iterator[None]:
    """Around all that a process does: `rodeo status` then finds in `data_dir` for what error it ended."""
    try:
        yield
    except (BusUnavailable, ClockUnavailable, Interrupted) as error:
        if not stop.is_set():
            note_ending(data_dir, str(error), gave_up=False)
        raise
    except RodeoError as error:
        note_ending(data_dir, f"{error.code}: {error}", gave_up=not error.restart_cures)
        raise
    except Exception as error:
        note_ending(data_dir, repr(error), gave_up=False)
        raise


def is_transient(error: RodeoError) -> bool:
    """Whether the same request may succeed later: bus, disk or responder only cannot serve it now."""
    if isinstance(error, RemoteError):
        return error.passes
    return isinstance(error, BusError | DiskFull)


def repeated(
    work: Callable[[], Result], failed: Callable[[RodeoError], None], stop: threading.Event
) -> Result | None:
    """The result of `work`, which is called again after each error until `stop` is set: then it is None.
    `failed` gets the error, and waits before the next attempt or raises."""
    while not stop.is_set():
        try:
            return work()
        except RodeoError as error:
            failed(error)
    return None


_PR_SET_PDEATHSIG = 1
"""prctl(2) option: the signal that the kernel sends when the thread that started this process ends."""
_LIBC = ctypes.CDLL(None, use_errno=True)
"""Loaded here, as a child may not load anything between fork and exec."""


def outlive_parent() -> None:
    """Take back `die_with`."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, 0)


def die_with(parent: int, number: signal.Signals) -> None:
    """Have the kernel send this process `number` when its parent, process `parent`, ends."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:  # it died before prctl took effect
        os.kill(os.getpid(), number)


def _die_with_parent() -> None:
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is not None:
        die_with(int(parent), signal.SIGTERM)


_M_ARENA_MAX = -8
"""mallopt(3) parameter: by how many arenas threads allocate memory."""
_ARENAS = 2


def share_memory() -> None:
    """Have the C library's threads allocate from _ARENAS arenas, not from eight for each core: what a thread
    has freed serves the next. The interpreter's lock lets one of them allocate at a time anyway."""
    if hasattr(_LIBC, "mallopt"):  # glibc
        _LIBC.mallopt(_M_ARENA_MAX, _ARENAS)


_M_MMAP_THRESHOLD = -3
"""mallopt(3) parameter: from which size on memory is the system's again as soon as it is freed. glibc raises
it to that of what was freed last, up to 32 MB, unless it is set."""
_LARGE_BYTES = 1 << 18


def return_memory() -> None:
    """Have the C library return what is large once it is freed: for a process that needs much now and then.
    A process that needs it all the time takes longer."""
    if hasattr(_LIBC, "mallopt"):  # glibc
        _LIBC.mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)


STOP_S = 6.0
"""Wall time that a process has for its end; a launcher kills one that takes much longer."""


def supervise(name: str, body: Callable[[threading.Event], None], stop_s: float = STOP_S) -> int:
    """Run `body(stop)` with logging and signals set up; returns the process's exit status.

    0 when it ended or was asked to stop; else the reason is in the log, and it is GAVE_UP when a restart
    cannot cure it, 1 when it may. A process that was asked to stop is gone `stop_s` later, whatever it still
    waits for.
    """
    faulthandler.enable()
    share_memory()
    logs.configure(name)
    _die_with_parent()
    stop = threading.Event()
    status = [1]
    ended = 0  # no signal has this number
    # The body runs in a thread of its own and the main thread does nothing but listen for signals. Python
    # handles a signal in the main thread once that wakes up: just before a wait without time-out it would
    # never be seen, and in CPython 3.11 one that interrupts SimpleQueue.get(timeout) can turn the rest of
    # the time-out negative, which waits indefinitely. The C handler itself writes the wake-up descriptor.
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: None)

    def work() -> None:
        try:
            status[0] = _guarded(body, stop)
        finally:
            os.write(writer, bytes([ended]))

    worker = threading.Thread(target=work, name=name)
    worker.start()
    while (received := os.read(reader, 1)[0]) != ended:
        log.info("stopping on %s", signal.Signals(received).name)
        if not stop.is_set():
            stop.set()
            last = threading.Timer(stop_s, _leave, (stop_s,))
            last.daemon = True
            last.start()
    worker.join()
    # The interpreter collects garbage as it ends, for a second in a process that has loaded much.
    gc.freeze()
    return status[0]


def _leave(waited_s: float) -> None:
    """End the process here and now. What must survive a SIGKILL survives this too.

    Closing a Zenoh session waits 10 s for a router that takes nothing, as one does that is stopping itself.
    """
    log.warning(
        "exiting because the shutdown took longer than %.1f s: some messages may not be sent", waited_s
    )
    logging.shutdown()
    os._exit(0)


def _guarded(body: Callable[[threading.Event], None], stop: threading.Event) -> int:
    try:
        body(stop)
    except (BusUnavailable, ClockUnavailable, Interrupted) as error:
        if stop.is_set():
            return 0
        log.error("%s", error)
        return 1
    except RodeoError as error:
        log.error("%s: %s", error.code, error)
        return 1 if error.restart_cures else GAVE_UP
    except Exception as error:
        if is_full(error):
            log.error("disk_full: %s", error)
            return 1
        # The process's outermost frame: said in its log and in its exit status.
        log.exception("failed")
        return 1
    return 0
