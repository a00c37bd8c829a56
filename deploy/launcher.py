"""Starts a site's processes on this machine, keeps them running and stops what it started.

Every process may start alone and in any order; the launcher only adds what a site needs once: keystores for
a local chain, and the contracts on it. On a chain elsewhere that costs money, and is done by hand.
"""

from __future__ import annotations

import logging
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from rodeo.errors import RodeoError
from rodeo.host.instance import (
    GAVE_UP,
    LAUNCHER,
    PARENT_VARIABLE,
    forget_ending,
    last_ending,
    lock_holder,
    lock_instance,
)
from rodeo.site.config import Site
from rodeo.site.deploying import forget_deployment
from rodeo.site.processes import ProcessEntry, processes_of
from rodeo.site.tls import wants_certificates

log = logging.getLogger(__name__)

_STOP_S = 8.0
"""Wall time that a process has to end by itself after SIGTERM."""

_FIRST_PAUSE_S = 0.5
"""Wall time before a process that ended is started again; doubled each time, up to LONGEST_PAUSE_S."""

LONGEST_PAUSE_S = 5.0
"""Short enough that a process is back soon after what it lacks is there."""

_STEADY_S = 30.0
"""A process that ran this long (wall) is healthy: its next restart is prompt again."""


class LaunchFailed(RodeoError):
    """A one-time step of the start ended with an error; its log's last lines are in the message."""


class AllGaveUp(RodeoError):
    """Every process has ended for a reason that no restart cures."""


class UnknownProcess(RodeoError):
    """The name is not in the process table."""


@dataclass
class _Child:
    process: ProcessEntry
    popen: subprocess.Popen[bytes]
    started_s: float
    delay_s: float = _FIRST_PAUSE_S
    restart_at_s: float | None = None
    problem: str = ""
    """Reason of its last end."""
    gave_up: bool = False
    """It is not started again."""


@dataclass
class Launcher:
    """A site's processes as children of this one. Use as a context manager; call `poll` now and then.

    Entering returns at once: processes become ready, and contracts are deployed, while `poll` is called.

    Children die with this process even when it is killed. `only` names the processes to start, all by
    default. `python` runs them. `environment` is added to this process's own for what is started from now on.
    """

    site_path: Path
    only: tuple[str, ...] = ()
    python: str = sys.executable
    environment: dict[str, str] = field(default_factory=dict)
    children: dict[str, _Child] = field(default_factory=dict, init=False)
    _deployment: subprocess.Popen[bytes] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.site = Site.load(self.site_path)
        known = [process.name for process in processes_of(self.site)]
        unknown = [name for name in self.only if name not in known]
        if unknown:
            raise UnknownProcess(f"this site has no such process: {', '.join(unknown)}", known=known)
        self.logs = self.site.data_dir / "logs"

    def __enter__(self) -> Self:
        self._locks = [lock_instance(folder) for folder in self.lock_folders()]
        self.logs.mkdir(parents=True, exist_ok=True)
        try:
            forget_deployment(self.site)
            make_keys(self.site)
            if self.site.chain.backend != "external" and not self.only:
                # First, because most others wait for it; it waits for the chain by itself.
                with _signals_held():
                    self._deployment = self._spawn("contracts", "deploy.contracts")
            for process in self.selected():
                self._start(process)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *_raised: object) -> None:
        self.stop()
        for lock in self._locks:
            os.close(lock)

    def lock_folders(self) -> list[Path]:
        """Folders whose locks show this launcher to `stop_site` and to a second launcher."""
        folder = self.site.data_dir / LAUNCHER
        return [folder / name for name in self.only] or [folder]

    def selected(self) -> Iterator[ProcessEntry]:
        return (p for p in processes_of(self.site) if not self.only or p.name in self.only)

    def running(self) -> dict[str, int]:
        """The process id of each child that has not ended."""
        return {
            name: child.popen.pid
            for name, child in self.children.items()
            if child.restart_at_s is None and not child.gave_up
        }

    def problems(self) -> dict[str, str]:
        """Reasons why children ended by themselves, the last of each."""
        return {name: child.problem for name, child in self.children.items() if child.problem}

    def given_up(self) -> dict[str, str]:
        """The children that are not started again, and for what reason."""
        return {name: child.problem for name, child in self.children.items() if child.gave_up}

    def poll(self) -> None:
        """Start again what ended and may do better then.

        Raises LaunchFailed when the contracts could not be deployed, and AllGaveUp when no child is left.
        """
        if self._deployment is not None and self._deployment.poll() not in (None, 0):
            last = "\n".join(log_tail(self.site, "contracts"))
            raise LaunchFailed(f"cannot deploy the contracts:\n{last}")
        now_s = time.monotonic()
        for name, child in self.children.items():
            if child.gave_up:
                continue
            if child.restart_at_s is not None:
                if now_s >= child.restart_at_s:
                    self._restart(name, child)
            elif (status := child.popen.poll()) is not None:
                child.problem = self._ending(name, child.popen.pid, status)
                if status == GAVE_UP:
                    child.gave_up = True
                    continue
                if now_s - child.started_s > _STEADY_S:
                    child.delay_s = _FIRST_PAUSE_S
                child.restart_at_s = now_s + child.delay_s
        if self.children and all(child.gave_up for child in self.children.values()):
            reasons = "; ".join(f"{name}: {reason}" for name, reason in self.given_up().items())
            raise AllGaveUp(f"restarting would not help: {reasons}")

    def stop(self) -> None:
        """End every child: SIGTERM in reverse order of the table, SIGKILL for those that stay."""
        with _signals_held():
            running = {name: child.popen for name, child in reversed(self.children.items())}
            if self._deployment is not None:
                running["contracts"] = self._deployment
            for popen in running.values():
                if popen.poll() is None:
                    popen.terminate()
            deadline_s = time.monotonic() + _STOP_S
            for name, popen in running.items():
                try:
                    popen.wait(max(0.0, deadline_s - time.monotonic()))
                except subprocess.TimeoutExpired:
                    log.warning("%s did not stop in %.0f s; killing it", name, _STOP_S)
                    popen.kill()
                    popen.wait()
            self.children.clear()

    def _start(self, process: ProcessEntry) -> None:
        if lock_holder(folder := self.site.data_dir / process.name) is None:
            forget_ending(folder)
        with _signals_held():
            popen = self._spawn(process.name, process.module, process.arguments)
            self.children[process.name] = _Child(process, popen, time.monotonic())

    def _restart(self, name: str, child: _Child) -> None:
        delay_s = min(2 * child.delay_s, LONGEST_PAUSE_S)
        with _signals_held():
            popen = self._spawn(name, child.process.module, child.process.arguments)
            self.children[name] = _Child(
                child.process, popen, time.monotonic(), delay_s, problem=child.problem
            )

    def _ending(self, name: str, pid: int, status: int) -> str:
        if status < 0:
            return f"ended on {signal.Signals(-status).name}"
        ending = last_ending(self.site.data_dir / name)
        if ending is not None and ending.pid == pid:
            reason = ending.reason
        else:
            # What stands before the process's own name is the time.
            (last,) = log_tail(self.site, name, lines=1) or [""]
            reason = last.partition(f" {name}: ")[2] or last
        return reason if status == GAVE_UP else f"exited with status {status}: {reason}"

    def _spawn(self, name: str, module: str, arguments: tuple[str, ...] = ()) -> subprocess.Popen[bytes]:
        with open(self.logs / f"{name}.log", "ab") as output:
            return subprocess.Popen(
                [self.python, "-m", module, "--site", str(self.site_path), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                # A session of its own: Ctrl-C reaches the launcher alone, which stops the rest in order.
                start_new_session=True,
                env={**os.environ, **self.environment, PARENT_VARIABLE: str(os.getpid())},
            )


def make_keys(site: Site) -> None:
    """Make what is missing: wallets of a local chain, certificates of a bus that asks for them."""
    if site.chain.backend != "external":
        # Imported here: the curves behind wallets take half a second, and most commands need none.
        from rodeo.signing.wallets import ensure_wallets

        ensure_wallets(site)
    if wants_certificates(site):
        # Imported here: a bus without certificates needs no cryptography.
        from deploy.certificates import ensure_certificates

        ensure_certificates(site)


def log_tail(site: Site, name: str, lines: int = 12) -> list[str]:
    """The last lines of a process's log."""
    text = (site.data_dir / "logs" / f"{name}.log").read_text(errors="replace")
    return text.splitlines()[-lines:]


@contextmanager
def _signals_held() -> Iterator[None]:
    """Ctrl-C and its like wait until the end of the block.

    They must neither come between a child's start and the note of it, nor interrupt the stopping of the rest.
    """
    received: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, lambda number, _frame: received.append(number)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if received:
        signal.raise_signal(received[0])


def stop_site(site: Site) -> list[str]:
    """End launchers and processes of `site`, whoever started them; returns the names of the ended."""
    processes = [process.name for process in reversed(processes_of(site))]
    names = [LAUNCHER, *(f"{LAUNCHER}/{name}" for name in processes), *processes]
    held = [name for name in names if lock_holder(site.data_dir / name) is not None]
    for name in held:
        # Asked again: the launcher has ended its children.
        if (pid := lock_holder(site.data_dir / name)) is not None:
            _end(name, pid)
    return held


def _end(name: str, pid: int) -> None:
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        os.kill(pid, signal.SIGTERM)
        # A pidfd becomes readable when the process has ended. The launcher stops its children first.
        if not select.select([descriptor], [], [], 2 * _STOP_S)[0]:
            log.warning("%s did not stop in %.0f s; killing it", name, 2 * _STOP_S)
            os.kill(pid, signal.SIGKILL)
            select.select([descriptor], [], [], _STOP_S)
    finally:
        os.close(descriptor)
