"""What the commands share: options, output, the connection to the site."""

from __future__ import annotations

import json
import logging
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

import typer
from rich.console import Console
from rich.markup import escape

from rodeo import topics
from rodeo.bus import Bus
from rodeo.cli import words
from rodeo.config import Site
from rodeo.errors import BusError, RemoteError, RodeoError
from rodeo.origin import check_bus
from rodeo.tls import OPERATOR, identity

P = ParamSpec("P")
T = TypeVar("T")

console = Console()
errors = Console(stderr=True)

SiteOption = Annotated[
    Path, typer.Option("--site", envvar="RODEO_SITE", help="Site file.", show_default=True, metavar="FILE")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]
DEFAULT_SITE = Path("deploy/sites/lab.toml")

_CONNECT_S = 3.0
_ADDRESS = re.compile(r"^0x[0-9a-fA-F]{40}$")

_HINTS = {
    "wrong_bus": "`rodeo up` starts the site; --site FILE or RODEO_SITE names another",
    "bus_unavailable": "`rodeo up` starts the site; --site FILE or RODEO_SITE names another",
    "no_responder": "`rodeo status` tells whether the bridge is there",
    "bridge_not_ready": "`rodeo status` tells what is missing",
    "config_error": "--site FILE or RODEO_SITE names the site file",
    "already_running": "`rodeo status` shows it, `rodeo down` stops it",
    "reward_below_price": "offer more with --reward, or say --wait to queue the task until somebody takes it",
}
"""What to do about an error, by its code."""


def reports_errors(command: Callable[P, T]) -> Callable[P, T]:
    """A RodeoError becomes a sentence on stderr, with a hint where there is one, and exit status 1."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        logging.basicConfig(level=logging.WARNING, format="%(message)s")
        try:
            return command(*args, **kwargs)
        except RodeoError as error:
            sentence = words.explain(error, words.options_of(command))
            errors.print(f"[bold red]{error.code}[/]: {escape(sentence)}", highlight=False, soft_wrap=True)
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


def _named(bus: Bus, org: str, details: dict[str, Any]) -> dict[str, Any]:
    """`details` with the names of participants for their addresses, as far as the bridge knows them."""
    if not any(isinstance(value, str) and _ADDRESS.match(value) for value in details.values()):
        return details
    try:
        reply = bus.query(topics.STATE.name(org=org, what="participants"), timeout_s=_CONNECT_S)
    except (BusError, RemoteError):
        return details  # the error itself is what the caller has to hear of
    names = {one["address"]: one["name"] for one in reply["participants"] if one["name"]}
    return {
        key: names.get(value, value) if isinstance(value, str) else value for key, value in details.items()
    }


def say(sentence: str) -> None:
    """A line for people; whatever stands in it is text, never markup."""
    console.print(escape(sentence), highlight=False, soft_wrap=True)


def time_left(site: Site, bus: Bus, deadline_s: float) -> str:
    """How much time there is until then, by the site's clock and by the wall's."""
    from rodeo import people  # takes its time to import

    details: dict[str, Any] = {}
    if site.clock.source == "sim":
        # Silence is said in the text: nobody tells the site's time.
        with suppress(BusError):
            details = bus.query(topics.STATUS.name(org=site.org, process="robot_sim"))["details"]
    return people.time_left(people.Pace.of(site, details), deadline_s)


def print_json(value: Any) -> None:
    json.dump(value, sys.stdout, indent=2, default=str)
    sys.stdout.write("\n")
