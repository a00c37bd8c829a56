"""Orders to robots: pause, resume, charge, cancel, stop, and how they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from rodeo import topics
from rodeo.cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    console,
    print_json,
    reports_errors,
)

robots = typer.Typer(help="Order robots, and see how they are.", no_args_is_help=True)

NameArgument = Annotated[str, typer.Argument(help="The robot, by its name in the site file.", metavar="NAME")]

ORDERS = {
    "pause": "Take no new work; an attempt under way is finished first. Holds across restarts.",
    "resume": "Take work again, and let go of a stop.",
    "charge": "Buy a charge now.",
    "cancel": "Give up the attempt under way: the arm is folded and the failure goes on chain.",
    "stop": "Stand still at once, until resumed. Holds across restarts.",
}


def _ask(site: Path, name: str, order: str) -> dict[str, Any]:
    with connected(site) as (loaded, bus):
        robot = loaded.robot(name).name
        return bus.query(topics.ROBOT_ORDER.name(org=loaded.org, robot=robot, order=order), timeout_s=10)


def _command(order: str) -> Callable[..., None]:
    def command(name: NameArgument, site: SiteOption = DEFAULT_SITE) -> None:
        state = _ask(site, name, order)
        console.print(f"{name}: {order} ordered; {escape(str(state['activity']))}", highlight=False)

    return command


for _order, _help in ORDERS.items():
    robots.command(_order, help=_help)(reports_errors(_command(_order)))


@robots.command("state")
@reports_errors
def state(name: NameArgument, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """How the robot is and which orders hold."""
    answer = _ask(site, name, "state")
    if as_json:
        print_json(answer)
        return
    table = Table(box=None, show_header=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for key, value in answer.items():
        if value is not None:
            table.add_row(key, escape(str(value)))
    console.print(table)
