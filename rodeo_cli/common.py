"""Shared by the commands: options, output, the connection to the site."""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TextIO, TypeVar

import typer
from pydantic import BaseModel
from rich.console import Console
from rich.markup import escape
from rich.segment import Segment

import deploy
from rodeo.bus import queries
from rodeo.bus.messages import Status
from rodeo.bus.origin import check_bus
from rodeo.bus.session import Bus
from rodeo.errors import BusError, ClockUnavailable, InvalidRequest, QueryTimeout, RemoteError, RodeoError
from rodeo.host.clock import Clock, WallClock
from rodeo.host.files import replace_file, writing
from rodeo.host.instance import HEARTBEAT_S
from rodeo.runtime.logs import Redacting
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.tls import OPERATOR, identity
from rodeo.text.redaction import redacted
from rodeo_cli import formatting
from rodeo_cli.completion import site_names
from rodeo_cli.layout import Row, lines, printable

if TYPE_CHECKING:
    from rodeo.person.pace import Pace

P = ParamSpec("P")
T = TypeVar("T")

PIPE_WIDTH = 1_000_000
"""Characters in a line of a pipe or a file, which have no width: nothing is folded or cut there."""


class _Plain(Console):
    """Shows escapes for what others wrote to steer the terminal."""

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        return super()._render_buffer(
            one if one.control else one._replace(text=printable(one.text)) for one in buffer
        )


def console_on(stream: TextIO | None, stderr: bool = False) -> Console:
    """A console on `stream`: colours and the terminal's width on a terminal, plain whole lines elsewhere.

    FORCE_COLOR and COLUMNS change nothing where there is no terminal: a program reads what is printed there.
    """
    if stream is not None and stream.isatty():
        return _Plain(stderr=stderr)
    return _Plain(stderr=stderr, force_terminal=False, width=PIPE_WIDTH)


console = console_on(sys.stdout)
errors = console_on(sys.stderr, stderr=True)

CHECKOUT_SITE = Path("deploy/sites/lab.toml")
INSTALLED_SITE = Path(deploy.__file__).parent / "sites" / "installed.toml"
DEFAULT_SITE = CHECKOUT_SITE if CHECKOUT_SITE.exists() else INSTALLED_SITE
DEFAULT_SITE_SHOWN = f"{CHECKOUT_SITE}, or without it the installed lab"
"""Default shown by --help: the same text in a checkout and elsewhere."""


def usual_site() -> Path:
    """The site file of a command without --site."""
    return Path(os.environ.get("RODEO_SITE") or DEFAULT_SITE)


SiteOption = Annotated[
    Path,
    typer.Option(
        "--site", envvar="RODEO_SITE", help="Site file.", show_default=DEFAULT_SITE_SHOWN, metavar="FILE"
    ),
]
PARTICIPANTS, ROBOTS, KINDS = (
    site_names(*places, default=DEFAULT_SITE)
    for places in (("organization", "robots.name", "participants.name"), ("robots.name",), ("kinds.name",))
)
"""What a shell completes by the names of the site file."""
ParticipantOption = Annotated[
    str, typer.Option("--as", help="Whose wallet pays and signs.", autocompletion=PARTICIPANTS)
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]

_CONNECT_S = _CLOCK_S = 3.0
_SILENT_S = 30.0
"""Wall time without a heartbeat of the bridge after which a command is given up."""
_LONGEST_S = 3600.0
_ADDRESS = re.compile(r"^0x[0-9a-fA-F]{40}$")

_HINTS = {
    "wrong_bus": "start the site with `rodeo up`, or choose another with --site FILE or RODEO_SITE",
    "bus_unavailable": "start the site with `rodeo up`, or choose another with --site FILE or RODEO_SITE",
    "no_responder": "`rodeo status` shows whether the bridge runs",
    "query_timeout": "`rodeo status` shows whether the bridge runs",
    "bridge_not_ready": "`rodeo status` shows what the bridge waits for",
    "config_error": "set the site file with --site FILE or RODEO_SITE",
    "already_running": "`rodeo status` shows it, `rodeo down` stops it",
    "reward_below_price": "offer more with --reward, or queue the task with --wait",
}
"""Hints by the error's code."""


def reports_errors(command: Callable[P, T]) -> Callable[P, T]:
    """A RodeoError becomes a sentence on stderr, with a hint where there is one, and exit status 1."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        handler = logging.StreamHandler()
        handler.setFormatter(Redacting("%(message)s"))
        logging.basicConfig(level=logging.WARNING, handlers=[handler])
        try:
            with writing(Path("/dev/stdout")):  # other files' writers name them
                return command(*args, **kwargs)
        except RodeoError as error:
            sentence = formatting.explain(error, formatting.options_of(command))
            errors.print(
                f"[bold red]{error.code}[/]: {escape(printable(sentence))}", highlight=False, soft_wrap=True
            )
            if (hint := _HINTS.get(error.code)) is not None:
                errors.print(f"[dim]{hint}[/]", highlight=False, soft_wrap=True)
            raise typer.Exit(1) from error

    return run


@contextmanager
def connected(site_path: Path) -> Iterator[tuple[Site, Bus]]:
    """The site and a bus session on it. Raises ConfigError, BusUnavailable or WrongBus."""
    site = Site.load(site_path)
    with Bus.open(site.bus.router, timeout_s=_CONNECT_S, identity=identity(site, OPERATOR)) as bus:
        check_bus(bus, site)
        try:
            yield site, bus
        except RemoteError as error:
            error.details = _named(bus, site.org, error.details)
            raise


def send_command(site: Site, bus: Bus, participant: str, name: str, /, **request: Any) -> dict[str, Any]:
    """The bridge's reply to a command. It may take its time as long as its heartbeat is heard.

    Raises what `Bus.query` does; QueryTimeout once the bridge has been silent for `_SILENT_S`.
    """
    key = topics.COMMAND.name(org=site.org, participant=participant, command=name)
    reply: Future[dict[str, Any]] = Future()
    heard_s = time.monotonic()

    def on_heartbeat(_key: str, _status: bytes) -> None:
        nonlocal heard_s
        heard_s = time.monotonic()

    def ask() -> None:
        try:
            reply.set_result(bus.query(key, request, timeout_s=_LONGEST_S))
        except Exception as error:  # noqa: BLE001 - raised below, where the reply is waited for
            reply.set_exception(error)

    heartbeats = bus.subscribe_bytes(topics.STATUS.name(org=site.org, process="bridge"), on_heartbeat)
    threading.Thread(target=ask, name="command", daemon=True).start()
    try:
        while not wait([reply], HEARTBEAT_S).done:
            if (silent_s := time.monotonic() - heard_s) > _SILENT_S:
                silent = "the bridge is silent; it may still carry out the command"
                raise QueryTimeout(silent, key=key, silent_s=round(silent_s))
    finally:
        heartbeats.undeclare()
    return reply.result()


def _named(bus: Bus, org: str, details: dict[str, Any]) -> dict[str, Any]:
    """`details` with the names of participants for their addresses, as far as the bridge knows them."""
    if not any(isinstance(value, str) and _ADDRESS.match(value) for value in details.values()):
        return details
    try:
        people = queries.ask(bus, org, queries.PARTICIPANTS, timeout_s=_CONNECT_S).participants
    except (BusError, RemoteError):
        return details  # the error itself is what the caller has to hear of
    names = {one.address: one.name for one in people if one.name}
    return {
        key: names.get(value, value) if isinstance(value, str) else value for key, value in details.items()
    }


def say(sentence: str) -> None:
    """A line for people; whatever stands in it is text, never markup."""
    console.print(escape(printable(sentence)), highlight=False, soft_wrap=True)


def site_pace(site: Site, bus: Bus) -> Pace | None:
    """Speed of the site's time; None if it is unknown."""
    from rodeo.person import pace  # takes its time to import

    details: dict[str, Any] = {}
    if site.clock.source == "sim":
        # A missing answer becomes part of the text: the site's time is unknown.
        with suppress(BusError):
            key = topics.STATUS.name(org=site.org, process="robot_sim")
            details = queries.fitting(Status, bus.query(key), key).details
    return pace.Pace.of(site, details)


def time_left(site: Site, bus: Bus, deadline_s: float) -> str:
    """Time until then, by the site's clock and by the wall's."""
    from rodeo.person import pace  # takes its time to import

    return pace.time_left(site_pace(site, bus), deadline_s)


def write_file(file: Path, content: str | bytes) -> None:
    """Replace a file that the user named. Raises InvalidRequest, and DiskFull."""
    try:
        replace_file(file, content)
    except OSError as error:
        problem = error.strerror or str(error)
        raise InvalidRequest("the file cannot be written", file=str(file), problem=problem) from error


def make_folder(folder: Path) -> None:
    """Make a folder that the user named, if it is not there. Raises InvalidRequest."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = error.strerror or str(error)
        raise InvalidRequest("the folder cannot be made", folder=str(folder), problem=problem) from error


def site_clock(site: Site, bus: Bus) -> Clock:
    """The site's time. Raises ClockUnavailable."""
    from rodeo.runtime.sim_clock import SimClock  # takes its time to import

    if site.clock.source == "wall":
        return WallClock()
    clock = SimClock(bus.session, site.bus.domain_id)
    if not clock.wait_ready(threading.Event(), _CLOCK_S):
        raise ClockUnavailable("nothing publishes the simulation's /clock; is robot_sim running?")
    return clock


def print_listing(
    document: Any,
    as_json: bool,
    columns: Sequence[str],
    rows: Iterable[Row],
    folds: Sequence[int] = (),
    after: str = "",
) -> None:
    """Print what a command found: `document` for programs with `--json`, else `rows` in a table for people.

    `folds` are those of `print_table`, `after` is a sentence below it, or instead of it where there are no
    rows. With `--json`, `rows` are not read.
    """
    if as_json:
        print_json(document)
        return
    found = list(rows)
    if found:
        print_table(columns, found, folds)
    if after or not found:
        say(after or "There are none.")


def print_table(columns: Sequence[str], rows: Iterable[Row], folds: Sequence[int] = ()) -> None:
    """A table for people, as wide as the terminal; `folds` are the columns that give way on a narrow one."""
    for line in lines(columns, list(rows), console.width, folds):
        console.print(line, soft_wrap=True)


def print_facts(document: Any, as_json: bool, facts: Iterable[tuple[str, str]]) -> None:
    """Print one thing: each label with its text, or `document` with `--json`. Empty texts are left out."""
    rows = (Row(fact, {0: "bold"}) for fact in facts if fact[1])
    print_listing(document, as_json, ("", ""), rows, folds=(1,))


def print_json(value: Any) -> None:
    """One JSON document on stdout; a model is written as it was on the bus."""
    sys.stdout.write(redacted(json.dumps(value, indent=2, default=_as_json)) + "\n")
    sys.stdout.flush()


def _as_json(value: Any) -> Any:
    return value.model_dump(mode="json", by_alias=True) if isinstance(value, BaseModel) else str(value)
