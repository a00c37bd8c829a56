"""Commands about the site's processes: up, down, status."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Self, TypeVar
from urllib.parse import urlsplit

import typer
from rich.console import Group
from rich.live import Live
from rich.markup import escape

from deploy.launcher import Launcher, log_tail, make_keys, stop_site
from rodeo.bus.messages import Status
from rodeo.bus.origin import check_bus, statuses_at
from rodeo.bus.session import Bus, heard_status
from rodeo.errors import BusUnavailable, ConfigError, RodeoError, WrongBus
from rodeo.host.instance import HEARTBEAT_S, forget_ending, last_ending, lock_holder
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.deploying import deployment_under_way
from rodeo.site.names import bridge_wallets, robot_process
from rodeo.site.processes import processes_of
from rodeo.site.tls import OPERATOR, bus_is_closed, identity, openness
from rodeo_cli.common import (
    CHECKOUT_SITE,
    DEFAULT_SITE,
    INSTALLED_SITE,
    JsonOption,
    SiteOption,
    console,
    errors,
    print_listing,
    reports_errors,
    say,
)
from rodeo_cli.layout import Row as TableRow
from rodeo_cli.layout import lines, printable
from rodeo_cli.progress import NoProgress, Patience, TooSlow, duration, told_by, told_by_loading

LOST_S = 3 * HEARTBEAT_S
"""Age above which a heartbeat no longer describes the process."""
_MOST_PROCESSES = 500
"""Far more than a site has: on an open bus anybody may claim to be another one."""

COLUMNS, FOLDS = ("process", "state", "doing", "progress", "heartbeat"), (2,)
COLOURS = {"ready": "green", "not ready": "yellow", "lost": "red", "down": "red", "gave up": "red"}

_REFRESH_S = 0.25
Key = TypeVar("Key")
_STEP_CHARACTERS = 50
"""Width of a reason in a line of its own, with the time and the process before it."""
_WIDE = 100
"""Characters from which on there is room for a bar."""


class NotUp(RodeoError):
    """The site did not come up."""


@dataclass(frozen=True)
class Row:
    """A row of `rodeo status`: one process."""

    name: str
    state: str
    """ready, not ready, lost (its heartbeat stopped), down, or gave up (no restart cures it)"""
    reason: str = ""
    """Reason why it is not ready, or why it ended."""
    status: Status | None = None
    """Its last heartbeat."""
    here: bool = True
    """It works on this site's data directory, and not elsewhere on the same bus."""

    @property
    def told(self) -> Hashable:
        """Part of the row that counts as progress when it changes."""
        return (self.state, self.reason, None if self.status is None else told_by(self.status))

    @property
    def where(self) -> str:
        """Its state, and whether it is that of a process elsewhere."""
        return self.state if self.here else f"{self.state} elsewhere"


@reports_errors
def up(
    site: SiteOption = DEFAULT_SITE,
    only: Annotated[
        list[str] | None, typer.Option("--only", help="Start only this process; repeatable.")
    ] = None,
    services: Annotated[list[str] | None, typer.Argument(help="More names for --only.")] = None,
    detach: Annotated[bool, typer.Option("--detach", "-d", help="Return when the site is ready.")] = False,
    new_chain: Annotated[
        bool,
        typer.Option("--new-chain", help="Start a new local chain because the old one's file is lost."),
    ] = False,
    new_journal: Annotated[
        bool,
        typer.Option(
            "--new-journal",
            help="Continue without the bridge's lost journal. The bridge treats old request_ids as new.",
        ),
    ] = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Start also where no work is paid because the bus is open.")
    ] = False,
) -> None:
    """Start the site's processes and keep them running until Ctrl-C, or in the background with --detach."""
    names = (*(only or []), *(services or []))
    if site == INSTALLED_SITE:
        say(
            f"There is no {CHECKOUT_SITE} here: starting the installed lab. Its data, keys and logs are in "
            f"{Site.load(site).data_dir}"
        )
    if not anyway:
        _require_paid(site)
    _give_up(site, names, new_chain, new_journal)
    if detach:
        _detach(site, names)
        return
    stop_on_signals()
    try:
        with Launcher(site, names) as launcher:
            try:
                attend(launcher)
            except KeyboardInterrupt:
                console.print("stopping")
    except KeyboardInterrupt:
        pass
    console.print("stopped")


def _require_paid(path: Path) -> None:
    """Raises ConfigError where no work is paid because the bus is open."""
    if (site := Site.load(path)).bus.open:
        from rodeo_cli.site_check import undecided_on_open_bus

        if why := undecided_on_open_bus(site):
            raise ConfigError(f"{why}. --anyway starts it as it is", path=str(path))


def _give_up(path: Path, names: Sequence[str], chain: bool, journal: bool) -> None:
    """Continue without what was lost: the local chain, or the journals of the bridges among `names`."""
    # Imported here: chain and databases take a second, and these two are seldom wanted.
    if chain:
        from deploy.chain.record import give_up_chain

        if (record := give_up_chain(Site.load(path))) is not None:
            told = f"starting a new chain; the record of the old one is kept in {record}"
            console.print(told, soft_wrap=True)
    if journal:
        from services.bridge.continuity import give_up_journal

        site = Site.load(path)
        for name in bridge_wallets(site):
            if not names or name in names:
                give_up_journal(site, name)
        console.print("the bridge continues without the transactions that its journal lost", soft_wrap=True)


@reports_errors
def down(site: SiteOption = DEFAULT_SITE) -> None:
    """Stop every process of the site on this machine."""
    loaded = Site.load(site)
    ended = stop_site(loaded)
    console.print(
        f"stopped: {', '.join(ended)}" if ended else f"no process of {loaded.data_dir} was running",
        soft_wrap=True,
    )


@reports_errors
def status(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show whether each process runs and is ready, and why not. Exit status 1 unless all are ready."""
    loaded = Site.load(site)
    wrong: list[str] = []
    rows = read_rows(loaded, warn=wrong.append)
    bus = {"router": loaded.bus.router, "closed": bus_is_closed(loaded), "problem": "; ".join(wrong)}
    document = {"site": loaded.org, "bus": bus, "processes": [_row_json(loaded, row) for row in rows]}
    print_listing(document, as_json, COLUMNS, map(table_row, rows), folds=FOLDS)
    if not as_json:
        _print_warnings(loaded, rows, wrong)
        if line := _from_elsewhere(loaded, rows):
            say(line)
    if wrong or not all(row.state == "ready" for row in rows):
        raise typer.Exit(1)


def _from_elsewhere(site: Site, rows: list[Row]) -> str:
    """The command by which a laptop shows this console; empty where it is behind a proxy, or off."""
    status = next((row.status for row in rows if row.name == "console" and row.here and row.status), None)
    url = urlsplit(str(status.details.get("http", "")) if status is not None else "")
    if site.console.origin is not None or url.port is None:
        return ""
    here = f"{os.environ.get('USER', 'USER')}@{socket.gethostname()}"
    tunnel = f"ssh -N -L {url.port}:{url.hostname}:{url.port} {here}"
    return f"console: {url.geturl()}; to see it on another computer, run there: {tunnel}"


def _print_warnings(site: Site, rows: list[Row], more: Sequence[str] = ()) -> None:
    """Warnings of the site file and the processes, each once."""
    said = [
        *more,
        openness(site),
        *(text for row in rows if row.status is not None for text in row.status.warnings),
    ]
    for text in dict.fromkeys(said):
        if text:
            console.print(f"[bold red]warning[/]: {escape(text)}", highlight=False, soft_wrap=True)


def read_rows(site: Site, timeout_s: float = 5.0, warn: Callable[[str], None] | None = None) -> list[Row]:
    """Each process's answer now; one that hangs has `timeout_s` of wall time to do so.

    Processes of the same name elsewhere on the bus have rows of their own, before the site's. `warn(text)`
    hears whose bus it is when it is another site's.
    """
    silence = "does not answer on the bus"
    # A router that runs is waited for: on a busy machine it takes its time to answer.
    router_s = timeout_s if lock_holder(site.data_dir / "router") is not None else 0.5
    try:
        with Bus.open(site.bus.router, timeout_s=router_s, identity=identity(site, OPERATOR)) as bus:
            statuses = _ask(bus, site.org, timeout_s)
            if warn is not None:
                try:
                    check_bus(bus, site)
                except WrongBus as error:
                    warn(error.message)
    except BusUnavailable:
        statuses = {}
        silence = f"finds no router at {site.bus.router}"
    rows = []
    for process in processes_of(site):
        name = process.name
        pid = lock_holder(site.data_dir / name)
        heard = [_heard(name, status, here=status.pid == pid) for status in statuses.get(name, [])]
        rows += sorted(heard, key=lambda row: row.here)
        if any(row.here for row in heard):
            continue
        if pid is not None:
            rows.append(Row(name, "not ready", f"process {pid} runs, but {silence}"))
        elif not heard or last_ending(site.data_dir / name) is not None:
            rows.append(_ended(site, name))
    return [*rows, *_minds(site, rows)]


def _minds(site: Site, rows: list[Row]) -> Iterator[Row]:
    """The minds that are ROS 2 nodes, of which the recorders tell whether they are there."""
    for robot in site.robots:
        if robot.mind is not None:
            recorder = robot_process(site, robot.name)
            told = next((row.status for row in rows if row.name == recorder and row.state == "ready"), None)
            if told is None:
                yield Row(
                    robot.mind, "not ready", f"{recorder}, which sees the mind of {robot.name}, is not ready"
                )
            elif told.details.get("mind"):
                yield Row(robot.mind, "ready", f"the mind of {robot.name}")
            else:
                yield Row(robot.mind, "down", f"no node is the mind of {robot.name}")


def _ended(site: Site, name: str) -> Row:
    ending = last_ending(site.data_dir / name)
    if ending is None:
        return Row(name, "down", "not running")
    if ending.gave_up:
        return Row(name, "gave up", ending.reason)
    return Row(name, "down", f"ended: {ending.reason}")


def _ask(bus: Bus, org: str, timeout_s: float) -> dict[str, list[Status]]:
    """Answers of the processes by name; there may be several of one name on the bus."""
    found: dict[str, list[Status]] = {}
    for _, status in statuses_at(bus, topics.STATUS.pattern(org=org), timeout_s):
        found.setdefault(status.process, []).append(status)
    return found


class StatusWatcher:
    """The latest heartbeats, without ever blocking; empty until the router is there.

    A context manager: a session left open keeps its threads, and so the process, alive.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self.bus: Bus | None = None
        """None before a router was there."""
        self._statuses: dict[str, Status] = {}
        self._of_process: dict[tuple[str, int], Status] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        if self.bus is not None:
            self.bus.close()

    def statuses(self) -> dict[str, Status]:
        if self.bus is None:
            try:
                shown = identity(self._site, OPERATOR)
                self.bus = Bus.open(self._site.bus.router, timeout_s=0.0, identity=shown)
            except BusUnavailable:
                return {}
            self.bus.subscribe_json(topics.STATUS.pattern(org=self._site.org), self.hear)
        return dict(self._statuses)

    def heard(self, name: str, pid: int) -> Status | None:
        """The latest of process `pid`: another one elsewhere may have the same name."""
        return self._of_process.get((name, pid))

    def hear(self, key: str, data: dict[str, Any]) -> None:
        """A heartbeat on `key`. Raises InvalidRequest on another process's key."""
        status = heard_status(key, data)
        _put_last(self._of_process, (status.process, status.pid), status)
        _put_last(self._statuses, status.process, status)


def _put_last(known: dict[Key, Status], key: Key, status: Status) -> None:
    """Whoever was not heard for longest is forgotten where there are too many."""
    known.pop(key, None)
    if len(known) >= _MOST_PROCESSES:
        del known[next(iter(known))]
    known[key] = status


def launcher_rows(launcher: Launcher, watcher: StatusWatcher) -> list[Row]:
    """Known states of the launcher's children.

    Heartbeats of others are left out: another site on the same router has processes of the same names.
    """
    watcher.statuses()
    running, problems = launcher.running(), launcher.problems()
    given_up = launcher.given_up()
    starting = "starting"
    if "router" not in running and watcher.bus is None:
        starting += f"; no router at {launcher.site.bus.router}"
    rows = []
    for process in launcher.selected():
        name = process.name
        pid, problem = running.get(name), problems.get(name)
        if name in given_up:
            rows.append(Row(name, "gave up", given_up[name]))
        elif pid is None:
            rows.append(Row(name, "down", problem or ""))
        elif (status := watcher.heard(name, pid)) is not None:
            rows.append(_heard(name, status))
        else:
            rows.append(Row(name, "not ready", f"started again; it {problem}" if problem else starting))
    return rows


def _heard(name: str, status: Status, here: bool = True) -> Row:
    if time.time() - status.time_s > LOST_S:
        return Row(name, "lost", "its heartbeat stopped", status, here)
    return Row(name, "ready" if status.ready else "not ready", status.reason, status, here)


def starting_step(site: Site, rows: list[Row]) -> str:
    """Activity of a site that is being started, as a sentence; empty when every process is ready."""
    waiting = [row for row in rows if row.state != "ready"]
    # The contracts need these two, and all others need the contracts.
    first = next((row for row in waiting if row.name in ("router", "chain")), None)
    if first is None and (deployment := deployment_under_way(site)) is not None:
        return str(deployment)
    for row in filter(None, (first, *waiting)):
        if row.reason and not (row.state == "not ready" and row.reason.startswith("starting")):
            reason = textwrap.shorten(row.reason, _STEP_CHARACTERS, placeholder=" ...")
            said = reason.removeprefix("waiting ")
            return f"{row.name} is waiting {said}" if said != reason else f"{row.name}: {reason}"
        return f"starting {row.name}"
    return ""


def moves(site: Site, rows: list[Row], launcher_pid: int) -> dict[str, Hashable]:
    """Input of a `Patience`: process -> its last report, of a site that `launcher_pid` has started."""
    told: dict[str, Hashable] = {row.name: row.told for row in rows}
    told["contracts"] = str(deployment_under_way(site) or "")
    silent = _children(launcher_pid) - {row.status.pid for row in rows if row.status is not None}
    told["loading"] = told_by_loading(silent)
    return told


def _children(pid: int) -> set[int]:
    try:
        return set(map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()))
    except (FileNotFoundError, ProcessLookupError):
        return set()


def what_hangs(site: Site, rows: list[Row], patience: Patience) -> str:
    """For a wait that was given up: who is at what, since when, and where more is to be read."""
    stuck = [row for row in rows if row.state != "ready"] or [row for row in rows if row.status]
    logs = site.data_dir / "logs"
    told = [
        f"{row.name} ({row.reason or (row.status and row.status.activity) or row.state}, for "
        f"{duration(patience.since_s(row.name))})"
        for row in stuck
    ]
    named = f"{logs / stuck[0].name}.log" if len(stuck) == 1 else f"the logs in {logs}"
    return f"{'; '.join(told)}. See {named}"


def status_table(rows: list[Row]) -> Group:
    """A table of the width of the terminal; what a process does or lacks stands there in full."""
    return Group(*lines(COLUMNS, [table_row(row) for row in rows], console.width, FOLDS))


def table_row(row: Row) -> TableRow:
    colours = {1: COLOURS[row.state], 3: "cyan"}
    if row.status is None:
        return TableRow((row.name, row.where, row.reason, "", ""), colours)
    age = f"{max(0.0, time.time() - row.status.time_s):.1f} s ago"
    if row.status.clock is not None:
        age += f", clock {row.status.clock.off_s:+.2f} s"
    room = 16 if console.is_terminal and console.width >= _WIDE else 0
    doing = row.reason or row.status.activity
    return TableRow((row.name, row.where, doing, bar(row.status.progress, room), age), colours)


def bar(progress: float | None, width: int = 16) -> str:
    """Progress in percent; with a `width` after a bar of that many characters."""
    if progress is None:
        return ""
    if not width:
        return f"{progress:.0%}"
    full = round(progress * width)
    return f"{'━' * full}{'─' * (width - full)} {progress:4.0%}"


def _row_json(site: Site, row: Row) -> dict[str, Any]:
    status = row.status
    pid = lock_holder(site.data_dir / row.name) if status is None else status.pid
    return {
        "process": row.name,
        "up": pid is not None,
        "pid": pid,
        "here": row.here,
        "ready": row.state == "ready",
        "gave_up": row.state == "gave up",
        "reason": row.reason,
        "activity": status and status.activity,
        "warnings": status.warnings if status is not None else [],
        "progress": status and status.progress,
        "last_heartbeat": status and status.time_s,
        "clock": status and status.clock and status.clock.model_dump(),
    }


def stop_on_signals() -> threading.Event:
    """SIGTERM and a closed terminal end the command as Ctrl-C does, which raises KeyboardInterrupt.

    The event is set, too: an exception that Python raises in a callback of foreign code is lost.
    """
    stopped = threading.Event()

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        stopped.set()
        raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)
    return stopped


def attend(launcher: Launcher) -> None:
    """Keep the children running and show how they are, indefinitely."""
    _print_warnings(launcher.site, [])
    with StatusWatcher(launcher.site) as watcher, _display() as show:
        while True:
            launcher.poll()
            show(launcher_rows(launcher, watcher))
            time.sleep(_REFRESH_S)


@contextmanager
def _display() -> Iterator[Callable[[list[Row]], None]]:
    """A live table on a terminal; elsewhere a line for each change of state."""
    if console.is_terminal:
        with Live(console=console, refresh_per_second=4) as live:
            yield lambda rows: live.update(status_table(rows))
        return
    said: dict[str, tuple[str, str]] = {}

    def tell(rows: list[Row]) -> None:
        for row in rows:
            if said.get(row.name) != (row.state, row.reason):
                said[row.name] = row.state, row.reason
                reason = f": {row.reason}" if row.reason else ""
                say(f"{row.name} {row.where}{reason}")

    yield tell


def _detach(site_path: Path, names: tuple[str, ...], patience: Patience | None = None) -> None:
    """Start the site in the background, and return when it is ready. Raises NotUp."""
    patience = patience or Patience()
    launcher = Launcher(site_path, names)
    wanted = {process.name for process in launcher.selected()}
    child = None
    if any(lock_holder(folder) is None for folder in launcher.lock_folders()):
        make_keys(launcher.site)
        launcher.logs.mkdir(parents=True, exist_ok=True)
        for name in wanted:
            if lock_holder(folder := launcher.site.data_dir / name) is None:
                forget_ending(folder)
        with open(launcher.logs / "launcher.log", "ab") as output:
            child = subprocess.Popen(
                # `--anyway`: whoever typed the command was asked already.
                [sys.executable, "-m", "rodeo_cli", "up", "--anyway", "--site", str(site_path), *names],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                env={**os.environ, "TERM": "dumb"},
            )
    said = ""
    while True:
        rows = [row for row in read_rows(launcher.site) if row.name in wanted]
        if reasons := [f"{row.name}: {row.reason}" for row in rows if row.state == "gave up"]:
            console.print(status_table(rows))
            going_on = any(lock_holder(folder) is not None for folder in launcher.lock_folders())
            rest = "; the other processes run until `rodeo down`" if going_on else ""
            raise NotUp(f"restarting would not help: {'; '.join(reasons)}{rest}")
        if child is not None and child.poll() is not None:
            last = "\n".join(log_tail(launcher.site, "launcher"))
            raise NotUp(f"the launcher exited; the end of its log:\n{last}")
        if all(row.state == "ready" and row.here for row in rows):
            console.print(status_table(rows))
            _print_warnings(launcher.site, rows)
            return
        if (step := starting_step(launcher.site, rows)) != said:
            # Not to standard output, which holds the table alone.
            errors.print(escape(printable(said := step)), highlight=False, soft_wrap=True)
        pid = next(filter(None, map(lock_holder, launcher.lock_folders())), 0)
        try:
            patience.look(moves(launcher.site, rows, pid))
        except (NoProgress, TooSlow) as error:
            console.print(status_table(rows))
            raise NotUp(
                f"{error.message} while waiting for {what_hangs(launcher.site, rows, patience)}. The "
                "processes keep trying until `rodeo down`"
            ) from error
        time.sleep(_REFRESH_S)
