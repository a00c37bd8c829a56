"""What robots have seen on the floor, and what people say that it is."""

from __future__ import annotations

from typing import Annotated

import typer

from rodeo.bus import queries
from rodeo.bus.queries import SeenThing
from rodeo.bus.seen import Saying, Seen
from rodeo.bus.session import validate
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    print_listing,
    reports_errors,
    say,
)
from rodeo_cli.formatting import moment
from rodeo_cli.layout import Row

seen = typer.Typer(help="List what robots have seen on the floor, and say what it is.", no_args_is_help=True)


@seen.command("list")
@reports_errors
def list_seen(
    state: Annotated[
        str, typer.Option(help="States: open, posted, dismissed, gone; separated by commas.")
    ] = "open,posted",
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """List the things, the newest first, each with its place and the name of its picture in the store."""
    with connected(site) as (loaded, bus):
        found = queries.ask(bus, loaded.org, queries.SEEN, state=state).things
        rows = [
            Row((str(one.id), _state(one), f"{one.x_m:.2f},{one.y_m:.2f}", one.robot,
                 moment(one.first_s, loaded), _said(one), one.photo))
            for one in found
        ]  # fmt: skip
    print_listing(found, as_json, ("thing", "state", "at", "robot", "seen", "people say", "picture"), rows)


@seen.command("say")
@reports_errors
def say_seen(
    thing: Annotated[int, typer.Argument(help="The thing, by its number in `rodeo seen list`.")],
    what: Annotated[str, typer.Argument(help="confirmed, dismissed, or the class of waste that it is.")],
    site: SiteOption = DEFAULT_SITE,
    who: Annotated[str, typer.Option("--as", help="Who says so.")] = "organization",
) -> None:
    """Say what a thing is. A dismissed one is not proposed again, unless somebody takes that back.

    To have it taken away, post a task about its place: `rodeo task create KIND --at X,Y --photo PICTURE`.
    """
    saying = validate(Saying, {"id": thing, "what": what})
    with connected(site) as (loaded, bus):
        told = Seen(bus, loaded.org, who).say(saying.id, saying.what)
    say(f"Thing {told.id} is {told.state}. {who} said: {what}.")


def _state(one: SeenThing) -> str:
    return one.state if one.task_id is None else f"{one.state}: task {one.task_id}"


def _said(one: SeenThing) -> str:
    return ", ".join(f"{word.who}: {word.what}" for word in one.said)
