"""`rodeo init`: a site file of one's own, with ports that no other site of this machine has."""

from __future__ import annotations

import re
import sys
import zlib
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import Annotated, TypeVar

import typer

from rodeo.display.formatting import count as counted
from rodeo.errors import ConfigError, InvalidRequest
from rodeo.host.listeners import is_free
from rodeo.site.config import Site
from rodeo_cli.common import make_folder, reports_errors, say, write_file

Value = TypeVar("Value", str, int)

SITE_FILE = "site.toml"
_TEMPLATE = Path(__file__).with_name("new_site.toml")
_POSES = ((1.4, 1.3), (2.6, 3.4), (1.4, 2.6))
"""Where robots stand: each leaves the way to bin and dock free."""
_FIRST_PORT, _PORTS = 20_000, 4_000
"""Triples of ports below those that systems give to outgoing connections. A folder's path chooses one, so
that two sites that do not run now seldom clash later."""
_NAME = re.compile(r"[a-z][a-z0-9-]*")
_PERSON = re.compile(r"[a-z][a-z0-9_-]*")


@reports_errors
def init(
    folder: Annotated[Path, typer.Argument(help="Folder of the new site.", metavar="DIR")],
    name: Annotated[
        str | None, typer.Option(help="Name of the organization. By default the folder's name.")
    ] = None,
    robots: Annotated[int | None, typer.Option(help="How many robots.", min=1, max=len(_POSES))] = None,
    person: Annotated[
        str | None, typer.Option(help="Name of a person who works there, too; empty for nobody.")
    ] = None,
    real_time: Annotated[
        bool | None, typer.Option("--real-time/--fast", help="Simulate in real time, or ten times as fast.")
    ] = None,
) -> None:
    """Write a commented site file for a site of your own, with free ports, and print what to do next.

    On a terminal it asks for what no option says. The site is simulated and needs nothing else.
    """
    path = folder / SITE_FILE
    if path.exists():
        raise InvalidRequest("there is a site already: choose another folder", file=str(path))
    asks = sys.stdin.isatty()
    usual = re.sub(r"[^a-z0-9-]+", "-", folder.resolve().name.lower()).strip("-") or "lab"
    org = _answer(asks, "Name of the organization", name, usual if usual[0].isalpha() else f"site-{usual}")
    count = _answer(asks, f"How many robots, 1 to {len(_POSES)}", robots, 1)
    worker = _answer(asks, "Name of a person who works there, too (empty for nobody)", person, "")
    slow = real_time
    if slow is None:
        slow = asks and typer.confirm("Simulate in real time (otherwise ten times as fast)?", default=False)
    _require(bool(_NAME.fullmatch(org)), "--name", org, "small letters, digits and -")
    _require(1 <= count <= len(_POSES), "--robots", str(count), f"1 to {len(_POSES)}")
    _require(
        not worker or bool(_PERSON.fullmatch(worker)), "--person", worker, "small letters, digits, _ and -"
    )
    text = site_text(path, org, count, worker, slow)
    site = _loaded(text)
    make_folder(folder)
    write_file(path, text)
    say(f"{path}: {org}, {counted(count, 'robot')}, console on port {site.console.port}")
    say("Start it, post a task and look at it:")
    for line in (
        f"export RODEO_SITE={path.resolve()}",
        "rodeo up --detach",
        *([f"rodeo task create {site.demo.kind} --item-id item1 --reward 100"] if site.demo else []),
        "rodeo status",
    ):
        say(f"    {line}")


def _loaded(text: str) -> Site:
    """The site that `text` describes, before its file is written: an invalid file would block the next try.
    Raises InvalidRequest."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / SITE_FILE
        path.write_text(text)
        try:
            return Site.load(path)
        except ConfigError as error:
            fields = error.details.get("fields", {"site": error.message})
            raise InvalidRequest("no site can be made of this", fields=fields) from error


def site_text(path: Path, org: str, robots: int, person: str, real_time: bool) -> str:
    """The new site file."""
    console, bin_, chain = free_ports(path)
    stand = "\n".join(
        f'[[robots]]\nname = "panther{number}"\npose = {{ x_m = {x_m}, y_m = {y_m} }}  '
        "# where it stands in a new world, and waits\n"
        for number, (x_m, y_m) in enumerate(_POSES[:robots], 1)
    )
    people = f'[[participants]]  # people and programs with a wallet\nname = "{person}"\n' if person else ""
    filled = Template(_TEMPLATE.read_text()).substitute(
        file=SITE_FILE,
        org=org,
        speed="1.0" if real_time else "10.0",
        # While one of several robots charges, another may be given a task: nobody must miss it.
        idle_speed="1.0" if real_time else "400.0" if robots == 1 else "10.0",
        console_port=console,
        bin_port=bin_,
        chain_port=chain,
        robots=stand,
        people=people,
    )
    return re.sub(r"\n{3,}", "\n\n", filled)


def free_ports(path: Path) -> tuple[int, int, int]:
    """Three ports on which nothing listens, the same for the same folder while they are free.

    Raises InvalidRequest where there are none.
    """
    chosen = zlib.crc32(str(path.resolve()).encode())
    for attempt in range(_PORTS):
        first = _FIRST_PORT + 3 * ((chosen + attempt) % _PORTS)
        if all(is_free(port) for port in range(first, first + 3)):
            return first, first + 1, first + 2
    raise InvalidRequest("no three ports are free", first=_FIRST_PORT, last=_FIRST_PORT + 3 * _PORTS)


def _answer(asks: bool, question: str, given: Value | None, usual: Value) -> Value:
    if given is not None or not asks:
        return usual if given is None else given
    answer: Value = typer.prompt(question, default=usual, type=type(usual), show_default=usual != "")
    return answer


def _require(fits: bool, option: str, value: str, wanted: str) -> None:
    if not fits:
        raise InvalidRequest(f"{option} takes {wanted}", given=value)
