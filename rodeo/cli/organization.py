"""Commands about the organization: tasks, services, wallets, proofs."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.text import Text

from rodeo.bus import Bus, validate
from rodeo.cleaning import doubt_about
from rodeo.cli import words
from rodeo.cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    console,
    errors,
    print_json,
    reports_errors,
    say,
    time_left,
)
from rodeo.cli.layout import Row, lines
from rodeo.cli.words import iec, plain
from rodeo.config import Site
from rodeo.durations import span
from rodeo.errors import BusError, InvalidRequest, MalformedJson, RemoteError
from rodeo.messages import Task
from rodeo.photo_code import photo_code
from services.console.words import count

if TYPE_CHECKING:
    from services.oracle.chain_view import View
    from services.oracle.report import Report

tasks = typer.Typer(help="Post, list, show and cancel tasks.", no_args_is_help=True)
services = typer.Typer(help="What participants offer.", no_args_is_help=True)

STATE_COLOURS = {
    "open": "yellow",
    "assigned": "cyan",
    "submitted": "blue",
    "undecided": "magenta",
    "settled": "green",
    "cancelled": "dim",
    "failed": "red",
}

RESULT_STYLES = {"passed": "green", "FAILED": "bold red", "undecided": "bold yellow", "skipped": "dim"}

ParticipantOption = Annotated[str, typer.Option("--as", help="Whose wallet pays and signs.")]


@tasks.command("create")
@reports_errors
def create(
    kind: Annotated[str, typer.Argument(help="waste_disposal or battery_charging.")],
    reward: Annotated[str, typer.Option(help="Reward in IEC, put into escrow.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
    item: Annotated[str | None, typer.Option(help="The item, by its id in the site file.")] = None,
    params: Annotated[str | None, typer.Option(help="The task's parameters as a JSON object.")] = None,
    description: Annotated[str, typer.Option(help="A sentence for people.")] = "",
    max_attempts: Annotated[int | None, typer.Option(help="Attempts before the reward is refunded.")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Queue it even if every service costs more.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Post a task, for example: rodeo task create waste_disposal --item item1 --reward 100"""
    with connected(site) as (loaded, bus):
        request: dict[str, Any] = {
            "kind": kind,
            "reward_iec": reward,
            "params": _task_params(loaded, item, params),
            "description": description,
            "allow_wait": wait,
        }
        if max_attempts is not None:
            request["max_attempts"] = max_attempts
        if doubt := _doubt(loaded, bus, request["params"]):
            errors.print(f"[bold yellow]warning[/]: {escape(doubt)}", highlight=False, soft_wrap=True)
        reply = bus.query(f"rodeo/{loaded.org}/wallet/{participant}/register_task", request, timeout_s=30)
    if as_json:
        print_json(reply | ({"warning": doubt} if doubt else {}))
    else:
        say(f"Task {reply['task_id']} is posted, and {iec(reward)} are in escrow for it.")


@tasks.command("list")
@reports_errors
def list_tasks(
    site: SiteOption = DEFAULT_SITE,
    state: Annotated[str | None, typer.Option(help="Only tasks in this state.")] = None,
    kind: Annotated[str | None, typer.Option(help="Only tasks of this kind.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=500)] = 50,
    offset: Annotated[int, typer.Option(min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """List tasks."""
    filters = {"state": state, "kind": kind, "limit": limit, "offset": offset}
    with connected(site) as (loaded, bus):
        reply = bus.query(
            f"rodeo/{loaded.org}/state/tasks",
            parameters={name: value for name, value in filters.items() if value is not None},
        )
    if as_json:
        print_json(reply)
        return
    columns = ("id", "kind", "state", "try", "creator", "executor", "reward", "paid")
    rows = [_task_row(task) for task in reply["tasks"]]
    for line in lines(columns, rows, console.width, folds=(1, 4, 5)):
        console.print(line, soft_wrap=True)
    say(f"{len(reply['tasks'])} of {count(reply['total'], 'task')}")


def _task_row(task: dict[str, Any]) -> Row:
    cells = (
        str(task["id"]),
        task["kind"],
        task["state"],
        f"{task['attempt']}/{task['max_attempts']}",
        _party(task, "creator"),
        _party(task, "executor"),
        iec(task["reward_iec"]),
        iec(task["paid_iec"]) if Decimal(task["paid_iec"]) else "",
    )
    return Row(cells, {2: STATE_COLOURS.get(task["state"], "")}, _why(task))


def _why(task: dict[str, Any]) -> str:
    """Why the last attempt did not succeed, where it did not."""
    if task["verdict"] in ("rejected", "undecided") and task["reason"]:
        return str(task["reason"])
    if task["verdict"] == "expired":
        return str(task["reason"] or "the executor handed in no proof in time, or nobody judged it in time")
    return ""


@tasks.command("show")
@reports_errors
def show(task_id: int, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show one task with its times, proof and verdict."""
    with connected(site) as (loaded, bus):
        task = bus.query(f"rodeo/{loaded.org}/state/task/{task_id}")
        left, judged = (None, "") if as_json else (_left(loaded, bus, task), _judged(loaded, bus, task))
    if as_json:
        print_json(task)
        return
    rows = [Row((label, text), {0: "bold"}) for label, text in _told(task, loaded, left, judged) if text]
    for line in lines(("", ""), rows, console.width, folds=(1,))[1:]:
        console.print(line, soft_wrap=True)


def _told(
    task: dict[str, Any], site: Site, left: str | None = None, judged: str = ""
) -> list[tuple[str, str]]:
    """All that is known of a task, in words and in the order in which it happens.

    `left` is how much time there is for what comes next, `judged` the verdict as a sentence.
    """
    from rodeo.dao import is_peoples  # takes its time to import

    def moment(name: str) -> str:
        return "" if task[name] is None else words.moment(task[name], site)

    state = task["state"]
    ended = state in ("settled", "failed", "cancelled")
    due = {"assigned": "execution_deadline", "submitted": "verdict_deadline", "undecided": "audit_deadline"}
    verdict = task["verdict"] or ""
    own = task["reason"] and task["reason"] != verdict
    told = [
        ("task", str(task["id"])),
        ("kind", task["kind"]),
        ("description", task["description"]),
        ("parameters", plain(task["params"])),
        ("state", state),
        ("due by", moment(due[state]) if state in due else ""),
        ("time left", left or ""),
        ("attempt", f"{task['attempt']} of {task['max_attempts']}" if task["attempt"] else ""),
        ("attempts", "" if task["attempt"] else f"none yet, {task['max_attempts']} at most"),
        ("verdict", judged or (f"{verdict}: {task['reason']}" if own else verdict)),
        ("reward", f"{iec(task['reward_iec'])} by {_party(task, 'creator')}"),
        ("executor", _party(task, "executor")),
        ("service", "" if task["service_id"] is None else str(task["service_id"])),
        ("price", iec(task["price_iec"]) if task["price_iec"] is not None else ""),
        ("paid", iec(task["paid_iec"]) if ended else ""),
        ("refunded", iec(task["refunded_iec"]) if ended else ""),
        ("posted", moment("registered")),
        ("assigned", moment("assigned")),
        ("proof handed in", moment("proof_submitted")),
        ("settled", moment("settled")),
        ("time to work", span(task["execution_window_s"])),
        ("time to judge", span(task["verdict_window_s"])),
        ("without a word", f"the {task['at_silence']} wins" if task["at_silence"] else ""),
        ("proof", task["proof_sha256"] or ""),
        ("proof at", task["proof_uri"] or ""),
        ("report", task["report_sha256"] or ""),
        ("report at", task["report_uri"] or ""),
        ("nonce", task["nonce"] or ""),
    ]
    if task["nonce"] and is_peoples(task["kind"]):
        told.append(("photo code", photo_code(task["nonce"])))
    return told


def _judged(site: Site, bus: Bus, task: dict[str, Any]) -> str:
    """The last verdict as a sentence: who gave it, and why; empty while there is none."""
    from rodeo.verdicts import is_peoples_verdict, judge_of, verdict_words  # takes its time to import

    if not task["verdict"]:
        return ""
    transactions = bus.query(f"rodeo/{site.org}/state/transactions", parameters={"task_id": task["id"]})
    kinds = bus.query(f"rodeo/{site.org}/state/organization")["kinds"]
    audited = [one["kind"] for one in kinds if one["review"] == "auditor"]
    by_people = is_peoples_verdict(task["kind"], task["verdict"], task["audit_deadline"], audited)
    return verdict_words(task["verdict"], task["reason"], judge_of(transactions["transactions"]), by_people)


def _left(site: Site, bus: Bus, task: dict[str, Any]) -> str | None:
    """How much time there is for what has to be done next, where there is an end to it."""
    from rodeo.people import running_out_s  # takes its time to import

    ends_s = running_out_s(validate(Task, task))
    return None if ends_s is None else time_left(site, bus, ends_s)


@tasks.command("cancel")
@reports_errors
def cancel(
    task_id: int, site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization"
) -> None:
    """Cancel a task that nobody has been assigned; its reward comes back."""
    with connected(site) as (loaded, bus):
        bus.query(f"rodeo/{loaded.org}/wallet/{participant}/cancel_task", {"task_id": task_id}, timeout_s=30)
    say(f"Task {task_id} is cancelled; its reward is back with {participant}.")


@services.command("list")
@reports_errors
def list_services(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the services on offer."""
    with connected(site) as (loaded, bus):
        reply = bus.query(f"rodeo/{loaded.org}/state/services")
    if as_json:
        print_json(reply)
        return
    rows = [
        Row((str(one["id"]), one["kind"], _party(one, "provider"), iec(one["price_iec"]), one["state"]))
        for one in reply["services"]
    ]
    for line in lines(("id", "kind", "provider", "price", "state"), rows, console.width, folds=(1, 2)):
        console.print(line, soft_wrap=True)


ServiceArgument = Annotated[
    int, typer.Argument(min=1, help="The service, by its number in `rodeo service list`.")
]
ProviderOption = Annotated[str | None, typer.Option("--as", help="Its provider; found if left out.")]


@services.command("price")
@reports_errors
def price(
    service_id: ServiceArgument,
    price: Annotated[str, typer.Argument(help="What a task costs from the next one on, in IEC.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ProviderOption = None,
) -> None:
    """Change what a service costs, for the tasks after the one that it does now."""
    service = _change_service(site, service_id, participant, price_iec=price)
    say(f"Service {service_id} costs {iec(service['price_iec'])} from the next task on.")


@services.command("pause")
@reports_errors
def pause(
    service_id: ServiceArgument, site: SiteOption = DEFAULT_SITE, participant: ProviderOption = None
) -> None:
    """Take no new tasks; the one that is being done goes on."""
    _change_service(site, service_id, participant, state="paused")
    say(f"Service {service_id} is paused; `rodeo service resume {service_id}` ends that.")


@services.command("resume")
@reports_errors
def resume(
    service_id: ServiceArgument, site: SiteOption = DEFAULT_SITE, participant: ProviderOption = None
) -> None:
    """Take tasks again."""
    _change_service(site, service_id, participant, state="active")
    say(f"Service {service_id} takes tasks again.")


@services.command("withdraw")
@reports_errors
def withdraw(
    service_id: ServiceArgument, site: SiteOption = DEFAULT_SITE, participant: ProviderOption = None
) -> None:
    """End an offer for good; what is left of its bond comes back. The task that is being done goes on."""
    _change_service(site, service_id, participant, state="retired")
    say(f"Service {service_id} is withdrawn for good; `rodeo service offer` makes another one.")


def _change_service(site: Path, service_id: int, participant: str | None, **change: str) -> dict[str, Any]:
    """Update the service in its provider's name; returns it as it was, with the change.

    Raises InvalidRequest when there is none, or its provider has no name here.
    """
    with connected(site) as (loaded, bus):
        # They are numbered from 1 and told in that order.
        one_page = {"offset": service_id - 1, "limit": 1}
        services = bus.query(f"rodeo/{loaded.org}/state/services", parameters=one_page)["services"]
        service = next((one for one in services if one["id"] == service_id), None)
        if service is None:
            raise InvalidRequest(
                f"there is no service {service_id}; `rodeo service list` shows them", service_id=service_id
            )
        provider = service["provider_name"]
        if provider is None or participant not in (None, provider):
            raise InvalidRequest(
                f"service {service_id} is not {participant}'s to change"
                if participant
                else f"service {service_id} belongs to somebody whose key is not on this site",
                service_id=service_id,
                provider=provider or service["provider"],
            )
        request = {"service_id": service_id, **change}
        bus.query(f"rodeo/{loaded.org}/wallet/{provider}/update_service", request, timeout_s=30)
    if provider in [robot.name for robot in loaded.robots] and change.get("state") != "retired":
        say(
            f"{provider} sets price and state of its own service again when it looks at it next: "
            f"`rodeo robot pause {provider}` has it take no work, and the site file says its price "
            "(economy.cleaning_reward_iec)."
        )
    return {**service, **change}


@reports_errors
def wallet(
    name: Annotated[str | None, typer.Argument(help="One participant; all by default.")] = None,
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """Show balances."""
    with connected(site) as (loaded, bus):
        reply = bus.query(f"rodeo/{loaded.org}/state/wallets")
    wallets = [entry for entry in reply["wallets"] if name in (None, entry["name"])]
    if not wallets:
        raise InvalidRequest("no such wallet", name=name, known=[entry["name"] for entry in reply["wallets"]])
    if as_json:
        print_json(wallets if name is None else wallets[0])
        return
    rows = [Row((one["name"], iec(one["balance_iec"]), one["address"])) for one in wallets]
    for line in lines(("name", "balance", "address"), rows, console.width, folds=(0,)):
        console.print(line, soft_wrap=True)


@reports_errors
def verify(
    file: Annotated[
        Path, typer.Argument(help="A proof (MCAP), or a ROS 1 or ROS 2 bag.", metavar="FILE", exists=True)
    ],
    site: SiteOption = DEFAULT_SITE,
    offline: Annotated[
        bool, typer.Option("--offline", help="Skip what only the chain knows; do not ask the bridge.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Say of each check its limit, where that comes from, and more."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run the oracle's checks on a proof here and now. Exit status 1 when one fails.

    What only the chain knows (who may sign, which days were posted) is taken as of the block of the verdict,
    if there is one; what came later is a warning. Without a running site that is skipped, with a warning.
    """
    # Imported here: only this command needs MuJoCo and the readers of recordings.
    from services.oracle.chain_view import View
    from services.oracle.verify import verify_file

    loaded = Site.load(site)
    known = View(None, []) if offline else _chain_view(site, file)
    report = verify_file(file, loaded, known.ledger)
    for warning in known.warnings:
        errors.print(f"[bold yellow]warning[/]: {escape(warning)}", highlight=False, soft_wrap=True)
    if as_json:
        print_json(report.model_dump(mode="json") | {"warnings": known.warnings})
    else:
        for line in _check_lines(report, console.width, verbose):
            console.print(line, soft_wrap=True)
        console.print(_conclusion(site, report, offline), highlight=False, soft_wrap=True)
    if not report.accepted:
        raise typer.Exit(1)


def _check_lines(report: Report, width: int, verbose: bool) -> Iterator[Text]:
    """A line for each check; with `verbose` what it compared with follows in full."""
    names = max((len(check.name) for check in report.checks), default=0)
    for check, (name, result, measured, limit, source, about) in zip(
        report.checks, report.rows(), strict=True
    ):
        line = Text(f"{result:9}  ", style=RESULT_STYLES[result]) + Text(f"{name:{names}}  ", style="")
        if not verbose:
            told = "  ".join(text for text in (measured, about) if text)
            line.append(told, style="bold" if check.passed is False else "dim")
            line.truncate(width, overflow="ellipsis")
            line.rstrip()
            yield line
            continue
        line.append(measured)
        yield line
        indent = " " * 11
        against = f"limit {limit}" if limit else ""
        whence = f"from: {source}" if source else ""
        for text in (about, "; ".join(one for one in (against, whence) if one)):
            for part in textwrap.wrap(text, width, initial_indent=indent, subsequent_indent=indent):
                yield Text(part, style="dim")


def _outcome(report: Report) -> str:
    """Why, or how much was asked where nothing failed."""
    if not report.accepted:
        return report.reason
    skipped = sum(check.passed is None for check in report.checks)
    passed = count(len(report.checks) - skipped, "check") + " passed"
    return passed + (f", {skipped} were skipped" if skipped else "")


def _conclusion(site_path: Path, report: Report, offline: bool) -> str:
    """What the checks come to. A person's word is never the oracle's verdict: whoever judged it is named."""
    from rodeo.dao import is_peoples

    if report.kind is None or not is_peoples(report.kind) or report.outcome == "rejected":
        return f"[bold]{report.outcome}[/]: {escape(_outcome(report))}"
    told = "[bold]a person's word[/], sealed as it should be; no machine can tell whether it is true"
    if offline or report.task_id is None:
        return f"{told}: an auditor judges it"
    try:
        with connected(site_path) as (site, bus):
            task = bus.query(f"rodeo/{site.org}/state/task/{report.task_id}")
            same = task["proof_sha256"] == report.proof_sha256
            judged = _judged(site, bus, task) if same else ""
    except (BusError, RemoteError) as error:
        judged = f"who judged it is not known: {error}"
    return f"{told}\n" + (escape(judged) or f"an auditor judges it: `rodeo task review {report.task_id}`")


def _chain_view(site_path: Path, file: Path) -> View:
    """What the running site's bridge says about a proof; if none answers, a warning that says so."""
    from rodeo.dao import ORGANIZATION, Participant
    from services.oracle.chain_view import View, view

    try:
        with connected(site_path) as (site, bus):
            return view(file, site, Participant(bus, site.org, ORGANIZATION))
    except (BusError, RemoteError) as error:
        return View(None, [f"what only the chain knows is skipped: {error}"])


def _doubt(site: Site, bus: Bus, params: dict[str, Any]) -> str:
    """Why the task's item is probably not where it says."""
    item_id = params.get("item_id")
    if not isinstance(item_id, str):
        return ""
    found = bus.query(f"rodeo/{site.org}/state/tasks", parameters={"text": item_id})
    return doubt_about(item_id, found["tasks"])


def _task_params(site: Site, item_id: str | None, params: str | None) -> dict[str, Any]:
    values: dict[str, Any] = {}
    if item_id is not None:
        item = next((item for item in site.items if item.id == item_id), None)
        if item is None:
            raise InvalidRequest("no such item", item=item_id, known=[item.id for item in site.items])
        values = {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
    if params is not None:
        try:
            given = json.loads(params)
        except ValueError as error:
            raise MalformedJson(f"--params is not JSON: {error}") from error
        if not isinstance(given, dict):
            raise MalformedJson("--params is not a JSON object")
        values |= given
    return values


def _party(entry: dict[str, Any], role: str) -> str:
    address = entry.get(role)
    return entry.get(f"{role}_name") or (f"{address[:8]}…" if address else "")
