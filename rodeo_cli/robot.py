"""Orders to robots: pause, resume, charge, cancel, stop, and how they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from rodeo.bus import queries
from rodeo.robot.decisions import KEPT, Decided, Explain, Explained
from rodeo.site import topics
from rodeo_cli.common import (
    DEFAULT_SITE,
    ROBOTS,
    JsonOption,
    SiteOption,
    connected,
    print_facts,
    print_listing,
    reports_errors,
    say,
)
from rodeo_cli.formatting import moment
from rodeo_cli.layout import Row
from rodeo_cli.robot_words import facts, taken

robots = typer.Typer(help="Give orders to robots and show their state.", no_args_is_help=True)

NameArgument = Annotated[
    str,
    typer.Argument(help="The robot, by its name in the site file.", metavar="NAME", autocompletion=ROBOTS),
]

ORDERS = {
    "pause": "Finish the current attempt, then take no new work. The order holds across restarts.",
    "resume": "Take work again. Also ends a stop.",
    "charge": "Buy a charge now.",
    "cancel": "Give up the current attempt. The robot folds its arm and reports the failure on chain.",
    "stop": "Stand still at once, until resumed. The order holds across restarts.",
}


def _ask(site: Path, name: str, order: str) -> dict[str, Any]:
    with connected(site) as (loaded, bus):
        robot = loaded.robot(name).name
        return bus.query(topics.ROBOT_ORDER.name(org=loaded.org, robot=robot, order=order), timeout_s=10)


def _command(order: str) -> Callable[..., None]:
    def command(name: NameArgument, site: SiteOption = DEFAULT_SITE) -> None:
        say(taken(name, order, _ask(site, name, order)))

    return command


for _order, _help in ORDERS.items():
    robots.command(_order, help=_help)(reports_errors(_command(_order)))


@robots.command("state")
@reports_errors
def state(name: NameArgument, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show the robot's state and the orders that hold."""
    answer = _ask(site, name, "state")
    print_facts(answer, as_json, facts(dict(answer)))


@robots.command("explain")
@reports_errors
def explain(
    name: NameArgument,
    task: Annotated[int | None, typer.Option(help="Only decisions with this task.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=KEPT, help="Show the newest decisions.")] = 20,
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """Show what the robot decided, in which situation and why. A decision holds until the next one."""
    with connected(site) as (loaded, bus):
        robot = loaded.robot(name).name
        key = topics.ROBOT_ORDER.name(org=loaded.org, robot=robot, order="explain")
        wanted = Explain(task_id=task, limit=limit).model_dump(exclude_none=True)
        found = queries.fitting(Explained, bus.query(key, parameters=wanted, timeout_s=10), key).decisions
    rows = (Row((moment(one.time_s, loaded), one.intent, one.reason, _situation(one))) for one in found)
    about = "" if task is None else f" with task {task}"
    after = "" if found else f"{name} keeps no decision{about}: it keeps at least the newest {KEPT}."
    print_listing(found, as_json, ("time", "decision", "why", "situation"), rows, folds=(2, 3), after=after)


def _situation(one: Decided) -> str:
    """The situation of a decision, without its usual parts."""
    said = [f"battery {one.soc:.0%}"]
    if one.task_id is not None:
        said.append(f"task {one.task_id}{', begun' if one.begun else ''}")
    if one.charge_id is not None:
        said.append(f"charging task {one.charge_id} is {one.charge_state}")
    said += [
        text
        for so, text in (
            (not one.battery_suffices, "the battery lasts for no work"),
            (one.paused, "paused"),
            (one.charge_ordered, "a charge is ordered"),
            (one.off_duty, "off duty"),
            (one.explored_enough, "explored enough"),
        )
        if so
    ]
    return "; ".join(said)
