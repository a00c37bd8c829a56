"""Commands about the organization: tasks, services, wallets, proofs."""

from __future__ import annotations

import json
import textwrap
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.text import Text

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, SignedRequest, Task
from rodeo.bus.session import Bus, DaoEvents, decode_json, validate
from rodeo.display.formatting import (
    count,
    known_in_words,
    namers_in_words,
    passed_in_words,
    span,
    tries_in_words,
)
from rodeo.errors import BusError, InvalidRequest, MalformedJson, RemoteError
from rodeo.judging.verdicts import (
    NO_REPORT,
    WORDS,
    is_peoples_verdict,
    judge_of,
    standing_words,
    verdict_words,
    void_words,
)
from rodeo.money.rewards import Rise
from rodeo.person.photo_code import photo_code
from rodeo.site.config import Site
from rodeo_cli import formatting
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    console,
    errors,
    print_facts,
    print_json,
    print_listing,
    reports_errors,
    say,
    send_command,
    site_clock,
    site_pace,
    time_left,
    write_file,
)
from rodeo_cli.formatting import iec, plain
from rodeo_cli.layout import Row, printable

if TYPE_CHECKING:
    from rodeo.checks.report import Report
    from services.oracle.chain_view import View

tasks = typer.Typer(help="Post, list, show and cancel tasks.", no_args_is_help=True)
services = typer.Typer(help="List and change the services that participants offer.", no_args_is_help=True)

STATE_COLOURS = {
    "open": "yellow",
    "assigned": "cyan",
    "submitted": "blue",
    "ruled": "magenta",
    "settled": "green",
    "cancelled": "dim",
    "failed": "red",
}

RESULT_STYLES = {"passed": "green", "FAILED": "bold red", "undecided": "bold yellow", "skipped": "dim"}

ParticipantOption = Annotated[str, typer.Option("--as", help="Whose wallet pays and signs.")]
SignOption = Annotated[
    Path | None,
    typer.Option(
        "--sign",
        metavar="FILE",
        dir_okay=False,
        help="Only sign, into this file. Whoever sends it with `rodeo task relay` pays the gas.",
    ),
]
ValidOption = Annotated[
    int, typer.Option("--valid", help="Seconds of block time for which what is signed may be sent.")
]
SignedArgument = Annotated[
    Path, typer.Argument(metavar="FILE", exists=True, dir_okay=False, help="A signed request.")
]


@tasks.command("create", context_settings={"ignore_unknown_options": True, "allow_extra_args": True})
@reports_errors
def create(
    context: typer.Context,
    kind: Annotated[str, typer.Argument(help="A kind of work that the organization accepts.")],
    reward: Annotated[str, typer.Option(help="Reward in IEC, put into escrow.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
    params: Annotated[str | None, typer.Option(help="The task's parameters as a JSON object.")] = None,
    description: Annotated[str, typer.Option(help="Description for people.")] = "",
    max_attempts: Annotated[int | None, typer.Option(help="Attempts before the reward is refunded.")] = None,
    rules_sha256: Annotated[
        str | None,
        typer.Option(
            "--rules",
            help="Hash of the rules by which it is judged, among the kind's current ones "
            "(`rodeo kind show`). By default the newest.",
        ),
    ] = None,
    service: Annotated[
        int | None,
        typer.Option(help="The only service that may do it. By default the policy chooses."),
    ] = None,
    provider: Annotated[
        str | None,
        typer.Option(
            help="The only provider that may do it, with any of its services: a name or an address."
        ),
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Queue it even if every service costs more.")] = False,
    up_to: Annotated[
        str | None,
        typer.Option(
            "--reward-up-to",
            help="Stay, and raise the reward up to this (IEC) while nobody takes the task.",
        ),
    ] = None,
    rise: Annotated[float, typer.Option(help="Part of the reward that each rise adds.")] = 0.1,
    rise_every: Annotated[float, typer.Option(help="Seconds of site time between two rises.")] = 3600.0,
    sign: SignOption = None,
    valid_s: ValidOption = 86_400,
    as_json: JsonOption = False,
) -> None:
    """Post a task, for example: rodeo task create KIND --reward 100

    Each parameter of the kind is an option of its own; `rodeo kind show KIND` lists them. To raise the
    reward, the task is posted again under another number.
    """
    if sign is not None and up_to is not None:
        raise InvalidRequest("the reward of a task that is only signed cannot rise: leave --reward-up-to out")
    rises = None if up_to is None else validate(Rise, {"up_to_iec": up_to, "by": rise, "every_s": rise_every})
    with connected(site) as (loaded, bus):
        request: dict[str, Any] = {
            "kind": kind,
            "reward_iec": reward,
            "params": _task_params(loaded, kind, context.args, params),
            "description": description,
            "allow_wait": wait,
        }
        if max_attempts is not None:
            request["max_attempts"] = max_attempts
        if rules_sha256 is not None:
            request["rules_sha256"] = rules_sha256
        if service is not None:
            request["service_id"] = service
        if provider is not None:
            request["provider"] = provider
        if doubt := _doubt(loaded, bus, kind, request["params"]):
            errors.print(f"[bold yellow]warning[/]: {escape(doubt)}", highlight=False, soft_wrap=True)
        if sign is not None:
            sign_into(loaded, bus, participant, "register_task", request, valid_s, sign, as_json)
            return
        reply = send_command(loaded, bus, participant, "register_task", **request)
        if not as_json:
            say(f"Task {reply['task_id']} is posted, and {iec(reward)} are in escrow for it.")
        if rises is not None:
            reply["task_id"] = _raised(loaded, bus, participant, int(reply["task_id"]), rises, as_json)
    if as_json:
        print_json(reply | ({"warning": doubt} if doubt else {}))


def _raised(site: Site, bus: Bus, participant: str, task_id: int, rises: Rise, quiet: bool) -> int:
    """Raise the task's reward until somebody has taken it or it is the highest; the task's number then."""
    from rodeo.dao import Participant  # takes its time to import

    tell = (lambda _sentence: None) if quiet else say
    creator, clock, heard = Participant(bus, site.org, participant), site_clock(site, bus), threading.Event()

    def on_event(_event: DaoEvent) -> None:
        heard.set()
        clock.notify()

    with DaoEvents(bus, site.org, on_event, clock=clock):
        while (reward := rises.after((task := creator.task(task_id)).reward_iec)) is not None:
            if task.state != "open":
                tell(f"Task {task_id} waits no more.")
                return task_id
            until_s = task.registered + rises.every_s
            if clock.wait_for(heard.is_set, until_s=until_s):
                heard.clear()
                continue
            task_id = creator.raise_reward(task_id, reward)
            tell(f"Nobody took it: task {task_id} is posted instead, for {iec(reward)}.")
    tell(f"Task {task_id} has the highest reward now.")
    return task_id


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
    filters: dict[str, Any] = {"state": state, "kind": kind, "limit": limit, "offset": offset}
    with connected(site) as (loaded, bus):
        reply = queries.ask(bus, loaded.org, queries.TASKS, **filters)
    columns = ("id", "kind", "state", "try", "creator", "executor", "reward", "paid")
    shown = f"{len(reply.tasks)} of {count(reply.total, 'task')}"
    print_listing(
        reply, as_json, columns, (_task_row(one, loaded) for one in reply.tasks), folds=(1, 4, 5), after=shown
    )


def _task_row(task: Task, site: Site) -> Row:
    cells = (
        str(task.id),
        task.kind,
        task.state,
        f"{task.attempts_counted}/{task.max_attempts}",
        _party(task.creator_name, task.creator),
        _party(task.executor_name, task.executor),
        iec(task.reward_iec),
        iec(task.paid_iec) if task.paid_iec else "",
    )
    return Row(cells, {2: STATE_COLOURS.get(task.state, "")}, _why(task, site))


def _named_provider(task: Task) -> list[tuple[str, str]]:
    if task.requested_provider is None:
        return []
    return [("named provider", _party(task.requested_provider_name, task.requested_provider))]


def _why(task: Task, site: Site) -> str:
    """What stands on the last attempt, or why it did not succeed, where it did not."""
    if stands := _standing(task, site):
        return stands
    if task.verdict in (None, "accepted"):
        return ""
    if task.verdict in ("expired", "abandoned"):
        return task.reason or "the executor submitted no proof in time"
    if task.verdict == "void":
        return void_words(task.fault, task.reason)
    return f"{WORDS.get(task.verdict, task.verdict)}: {task.reason or NO_REPORT}"


@tasks.command("show")
@reports_errors
def show(task_id: int, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show one task with its times, proof and verdict."""
    with connected(site) as (loaded, bus):
        task = queries.ask(bus, loaded.org, queries.TASK, id=task_id)
        left, judged = (None, "") if as_json else (_left(loaded, bus, task), _judged(loaded, bus, task))
    print_facts(task, as_json, () if as_json else _told(task, loaded, left, judged))


def _told(task: Task, site: Site, left: str | None = None, judged: str = "") -> list[tuple[str, str]]:
    """All that is known of a task, in words and in the order in which it happens.

    `left` is how much time there is for what comes next, `judged` the verdict as a sentence.
    """
    from rodeo.kinds import kinds_of  # takes its time to import

    def moment(time_s: float | None) -> str:
        return "" if time_s is None else formatting.moment(time_s, site)

    state = task.state
    ended = state in ("settled", "failed", "cancelled")
    unaccepted = state == "assigned" and not task.accepted
    due = {
        "assigned": None if unaccepted else task.execution_deadline,
        "submitted": task.verdict_deadline,
    }
    told = [
        ("task", str(task.id)),
        ("kind", task.kind),
        ("description", task.description),
        ("parameters", plain(task.params)),
        ("state", state),
        ("stands", _standing(task, site)),
        ("accept or give back by", moment(task.grace_ends_s) if unaccepted else ""),
        ("due by", moment(due.get(state))),
        ("time left", left or ""),
        ("attempt", tries_in_words(task) if task.attempt else ""),
        ("attempts", "" if task.attempt else f"none yet, {task.max_attempts} at most"),
        ("verdict", judged),
        ("reward", f"{iec(task.reward_iec)} by {_party(task.creator_name, task.creator)}"),
        ("executor", _party(task.executor_name, task.executor)),
        ("not offered again to", passed_in_words(task)),
        ("service", "" if task.service_id is None else str(task.service_id)),
        *([] if task.requested_service_id is None else [("named service", str(task.requested_service_id))]),
        *_named_provider(task),
        ("price", iec(task.price_iec) if task.price_iec is not None else ""),
        ("paid", iec(task.paid_iec) if ended else ""),
        ("refunded", iec(task.refunded_iec) if ended else ""),
        ("posted", moment(task.registered)),
        ("assigned", moment(task.assigned)),
        ("proof submitted", moment(task.proof_submitted)),
        ("settled", moment(task.settled)),
        ("time to work", f"{span(task.execution_window_s)}, the first {span(task.grace_s)} to give it back"),
        ("time to judge", span(task.verdict_window_s)),
        ("can be replaced until", moment(task.case_end) if not ended else ""),
        ("rules", task.rules_sha256 or ""),
        ("proof", task.proof_sha256 or ""),
        ("proof at", task.proof_uri or ""),
        ("report", task.report_sha256 or ""),
        ("report at", task.report_uri or ""),
        ("nonce", task.nonce or ""),
    ]
    if task.nonce and kinds_of(site).by_people(task.kind):
        told.append(("photo code", photo_code(task.nonce)))
    return told


def _standing(task: Task, site: Site) -> str:
    """A ruling that is not done yet: nobody may learn of it too late to challenge or replace it."""
    if task.standing is None:
        return ""
    until = formatting.moment(task.standing.until, site)
    return standing_words(task, iec(task.standing.amount_iec), until)


def _judged(site: Site, bus: Bus, task: Task) -> str:
    """The last verdict as a sentence: who gave it, and why; empty while there is none."""
    if not task.verdict:
        return ""
    transactions = queries.ask(bus, site.org, queries.TRANSACTIONS, task_id=task.id).transactions
    judge = judge_of(transactions)
    return verdict_words(task.verdict, task.reason, judge, is_peoples_verdict(task, judge), task.fault)


def _left(site: Site, bus: Bus, task: Task) -> str | None:
    """How much time there is for what has to be done next, where there is an end to it."""
    from rodeo.person.pace import running_out_s  # takes its time to import

    ends_s = running_out_s(task)
    return None if ends_s is None else time_left(site, bus, ends_s)


@tasks.command("relay")
@reports_errors
def relay(
    file: SignedArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: Annotated[str, typer.Option("--as", help="Whose wallet pays the gas.")] = "organization",
    as_json: JsonOption = False,
) -> None:
    """Send what somebody else has signed with --sign, and pay the gas for it. It can be sent once."""
    signed = _signed(file)
    with connected(site) as (loaded, bus):
        reply = send_command(loaded, bus, participant, "relay", signed=signed)
    if as_json:
        print_json(reply)
        return
    posted = f": task {reply['task_id']} is posted" if "task_id" in reply else ""
    say(f"{participant} sent it in block {reply['block']}{posted}.")


@tasks.command("allow-payments")
@reports_errors
def allow_payments(
    participant: Annotated[str, typer.Option("--as", help="The participant.")],
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Let the contracts take rewards and bonds from a wallet, of any amount.

    The first payment does it, too. It is needed before `create --sign` where the token takes no permits.
    """
    with connected(site) as (loaded, bus):
        send_command(loaded, bus, participant, "allow_payments")
    say(f"The contracts may take payments from {participant}.")


@tasks.command("revoke")
@reports_errors
def revoke(
    file: SignedArgument,
    participant: Annotated[str, typer.Option("--as", help="Who signed it.")],
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Make void what was signed with --sign, and was not sent yet. This costs its signer gas."""
    from rodeo.chain.signed_requests import SAID  # takes its time to import

    typed = _signed(file)["request"]["typed_data"]
    kind = SAID.get(str(typed.get("primaryType")))
    if kind is None:
        raise InvalidRequest(
            "not a request that can be sent for somebody", file=str(file), known=sorted(SAID)
        )
    nonce = validate(kind, typed.get("message")).nonce
    with connected(site) as (loaded, bus):
        send_command(loaded, bus, participant, "revoke_request", nonce=nonce)
    say(f"Nobody can send what is in {file} any more.")


def sign_into(
    site: Site,
    bus: Bus,
    participant: str,
    command: str,
    request: dict[str, Any],
    valid_s: int,
    file: Path,
    as_json: bool = False,
) -> None:
    """Have the participant's wallet sign, and write what `relay` takes into `file`."""
    if not file.absolute().parent.is_dir():
        raise InvalidRequest("there is no such folder to write into", file=str(file))
    signed = send_command(site, bus, participant, "sign", command=command, request=request, valid_s=valid_s)
    write_file(file, json.dumps(signed, indent=2) + "\n")
    if as_json:
        print_json(signed)
    elif signed["request"]["signature"] is None:
        say(
            f"The bridge does not have {participant}'s key: sign each `typed_data` in {file} with the wallet,"
        )
        say("and write the results as `signature`.")
    else:
        say(f"{participant} signed it. Send it within {span(valid_s)}: rodeo task relay {file} --as SENDER")


def _signed(file: Path) -> dict[str, Any]:
    """What a file of `_sign` says. Raises MalformedJson or InvalidRequest."""
    return validate(SignedRequest, decode_json(file.read_bytes())).model_dump(mode="json")


@services.command("list")
@reports_errors
def list_services(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the services on offer."""
    with connected(site) as (loaded, bus):
        reply = queries.ask(bus, loaded.org, queries.SERVICES)
        dated = any(one.rests_until or one.bond_locked_until for one in reply.services)
        pace = site_pace(loaded, bus) if dated and not as_json else None
    now_s = None if pace is None else pace.now_s
    rows = (
        Row(
            (str(one.id), one.kind, _party(one.provider_name, one.provider), iec(one.price_iec), one.state),
            note=_service_note(one, loaded, now_s),
        )
        for one in reply.services
    )
    print_listing(reply, as_json, ("id", "kind", "provider", "price", "state"), rows, folds=(1, 2))


def _service_note(service: queries.Offer, site: Site, now_s: float | None) -> str:
    told = [known_in_words(service, lambda time_s: formatting.moment(time_s, site), now_s)]
    if service.stood_back:
        told.append("stands back: its provider rests, or works or waits with another service")
    if namers := namers_in_words(service):
        told.append(namers)
    if not service.agrees:
        told.append(
            "gets only tasks under the judge before: its provider has not agreed to the present one "
            f"(`rodeo service agree {service.id}`)"
        )
    if service.set_aside_iec:
        told.append(f"{iec(service.set_aside_iec)} of its bond are set aside until its cases end")
    return "; ".join(told)


ServiceArgument = Annotated[
    int, typer.Argument(min=1, help="The service, by its number in `rodeo service list`.")
]
ProviderOption = Annotated[str | None, typer.Option("--as", help="Its provider; looked up by default.")]


@services.command("price")
@reports_errors
def price(
    service_id: ServiceArgument,
    price: Annotated[str, typer.Argument(help="Price of each future task, in IEC.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ProviderOption = None,
) -> None:
    """Change a service's price. A task in progress keeps the old price."""
    service = change_service(site, service_id, participant, price_iec=price)
    say(f"Service {service_id} will cost {iec(service['price_iec'])} from its next task on.")


@services.command("pause")
@reports_errors
def pause(
    service_id: ServiceArgument, site: SiteOption = DEFAULT_SITE, participant: ProviderOption = None
) -> None:
    """Take no new tasks. A task in progress continues."""
    change_service(site, service_id, participant, state="paused")
    say(f"Service {service_id} is paused. Resume it with `rodeo service resume {service_id}`.")


@services.command("resume")
@reports_errors
def resume(
    service_id: ServiceArgument, site: SiteOption = DEFAULT_SITE, participant: ProviderOption = None
) -> None:
    """Take tasks again."""
    change_service(site, service_id, participant, state="active")
    say(f"Service {service_id} takes tasks again.")


@services.command("withdraw")
@reports_errors
def withdraw(
    service_id: ServiceArgument, site: SiteOption = DEFAULT_SITE, participant: ProviderOption = None
) -> None:
    """End an offer for good and refund the rest of its bond. A task in progress continues.

    Whoever is paid for the provider's work may do this, too, for instance when the provider's key is lost.
    """
    change_service(site, service_id, participant, state="retired")
    say(f"Service {service_id} is withdrawn for good. Offer a new one with `rodeo service offer`.")


def change_service(
    site: Path,
    service_id: int,
    participant: str | None,
    command: str = "update_service",
    **change: str | int,
) -> dict[str, Any]:
    """Send a command about the service in its provider's name; returns it as it was, with the change. Another
    participant can only retire it, if it is paid for the provider's work.

    Raises InvalidRequest when there is none, or its provider has no name here.
    """
    with connected(site) as (loaded, bus):
        # They are numbered from 1 and told in that order.
        one_page = {"offset": service_id - 1, "limit": 1}
        services = queries.ask(bus, loaded.org, queries.SERVICES, **one_page).services
        service = next((one for one in services if one.id == service_id), None)
        if service is None:
            raise InvalidRequest(
                f"there is no service {service_id}; `rodeo service list` shows them", service_id=service_id
            )
        provider = service.provider_name
        retires = participant is not None and change.get("state") == "retired"
        if not retires and (provider is None or participant not in (None, provider)):
            raise InvalidRequest(
                f"service {service_id} belongs to another participant than {participant}"
                if participant
                else f"service {service_id} belongs to a provider whose key is not on this site",
                service_id=service_id,
                provider=provider or service.provider,
            )
        request = {"service_id": service_id, **change}
        send_command(loaded, bus, participant or provider or "", command, **request)
    managed = command == "update_service" and change.get("state") != "retired"
    if provider in [robot.name for robot in loaded.robots] and managed:
        say(
            f"{provider} manages its own service and will soon overwrite this change. To stop it from taking "
            f"work, run `rodeo robot pause {provider}`. To change its price, set price_iec of its kind in "
            "the site file."
        )
    return service.model_dump(mode="json") | change


@services.command("payout")
@reports_errors
def payout(
    address: Annotated[str, typer.Argument(help="Who is paid from now on: an address or a participant.")],
    participant: Annotated[str, typer.Option("--as", help="The participant that was paid until now.")],
    site: SiteOption = DEFAULT_SITE,
    provider: Annotated[
        str | None, typer.Option(help="Whose payments; by default those of the participant itself.")
    ] = None,
) -> None:
    """Have payments for a provider's work, its bonds and stakes go to another address.

    A provider can do this once. From then on only the address that is paid can name the next one, so that
    whoever steals the provider's key cannot take what it earns. Nobody undoes a mistake in the address.
    """
    from rodeo.dao import Participant  # takes its time to import

    whose = provider or participant
    with connected(site) as (loaded, bus):
        Participant(bus, loaded.org, participant).set_payout(address, whose)
        paid = queries.ask(bus, loaded.org, queries.WALLET, account=whose)
    if paid.payout is None:
        say(f"{whose} is paid itself.")
        return
    say(f"{_party(paid.payout_name, paid.payout)} is paid for what {whose} does, and alone can change this.")


@reports_errors
def wallet(
    name: Annotated[str | None, typer.Argument(help="One participant; all by default.")] = None,
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """Show balances."""
    with connected(site) as (loaded, bus):
        known = queries.ask(bus, loaded.org, queries.WALLETS).wallets
    wallets = [one for one in known if name in (None, one.name)]
    if not wallets:
        raise InvalidRequest("no such wallet", name=name, known=[one.name for one in known])
    rows = (
        Row(
            (
                one.name,
                iec(one.balance_iec),
                one.address,
                "itself" if one.payout is None else _party(one.payout_name, one.payout),
            )
        )
        for one in wallets
    )
    document = wallets if name is None else wallets[0]
    print_listing(document, as_json, ("name", "balance", "address", "is paid"), rows, folds=(0,))


@reports_errors
def verify(
    file: Annotated[
        Path, typer.Argument(help="A proof (MCAP), or a ROS 1 or ROS 2 bag.", metavar="FILE", exists=True)
    ],
    site: SiteOption = DEFAULT_SITE,
    offline: Annotated[
        bool, typer.Option("--offline", help="Do not ask the bridge. Skip the checks that need the chain.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Show each check's limit, the source of the limit, and more."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Run the oracle's checks on a proof here and now. Exit status 1 when one fails.

    What only the chain knows (who may sign, which days were posted) is taken as of the block of the verdict,
    if there is one; what came later is a warning. Without a running site that is skipped, with a warning.
    """
    # Imported here: only this command needs MuJoCo and the readers of recordings.
    from rodeo.checks.verify import verify_file
    from services.oracle.chain_view import View

    loaded = Site.load(site)
    known = View(None, []) if offline else _chain_view(site, file)
    report = verify_file(file, loaded, known.chain_record)
    task = known.chain_record and known.chain_record.task
    if task and task.rules_sha256 != report.rules_sha256:
        named = task.rules_sha256 or "none"
        known.warnings.append(
            f"the task is judged by the rules {named}; installed here are {report.rules_sha256}"
        )
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
            told = printable("  ".join(text for text in (measured, about) if text))
            line.append(told, style="bold" if check.passed is False else "dim")
            line.truncate(width, overflow="ellipsis")
            line.rstrip()
            yield line
            continue
        line.append(printable(measured))
        yield line
        indent = " " * 11
        against = f"limit {limit}" if limit else ""
        whence = f"from: {source}" if source else ""
        for text in (about, "; ".join(one for one in (against, whence) if one)):
            for part in textwrap.wrap(
                printable(text), width, initial_indent=indent, subsequent_indent=indent
            ):
                yield Text(part, style="dim")


def _outcome(report: Report) -> str:
    """Why, or how much was asked where nothing failed."""
    if not report.accepted:
        return printable(report.reason)
    skipped = sum(check.passed is None for check in report.checks)
    passed = count(len(report.checks) - skipped, "check") + " passed"
    return passed + (f", {skipped} were skipped" if skipped else "")


def _conclusion(site_path: Path, report: Report, offline: bool) -> str:
    """What the checks come to. A person's word is never the oracle's verdict: whoever judged it is named."""
    from rodeo.kinds import kinds_of

    kinds = kinds_of(Site.load(site_path))
    if report.kind is None or not kinds.by_people(report.kind) or report.outcome == "rejected":
        return f"[bold]{report.outcome}[/]: {escape(_outcome(report))}"
    told = "[bold]a person's statement[/] with a valid seal; software cannot check whether it is true"
    if offline or report.task_id is None:
        return f"{told}: an auditor judges it"
    try:
        with connected(site_path) as (site, bus):
            task = queries.ask(bus, site.org, queries.TASK, id=report.task_id)
            same = task.proof_sha256 == report.proof_sha256
            judged = _judged(site, bus, task) if same else ""
    except (BusError, RemoteError) as error:
        judged = f"cannot find out who judged it: {error}"
    return f"{told}\n" + (escape(judged) or f"an auditor judges it: `rodeo task review {report.task_id}`")


def _chain_view(site_path: Path, file: Path) -> View:
    """What the running site's bridge says about a proof; if none answers, a warning that says so."""
    from rodeo.dao import ORGANIZATION, Participant
    from services.oracle.chain_view import View, view

    try:
        with connected(site_path) as (site, bus):
            return view(file, site, Participant(bus, site.org, ORGANIZATION))
    except (BusError, RemoteError) as error:
        return View(None, [f"skipping the checks that need the chain: {error}"])


def _doubt(site: Site, bus: Bus, kind: str, params: dict[str, Any]) -> str:
    """Why the task can probably not be done as it says."""
    from rodeo.dao import ORGANIZATION, Participant
    from rodeo.kinds import kinds_of

    return Participant(bus, site.org, ORGANIZATION).doubt(kinds_of(site).get(kind), params)


def _task_params(site: Site, name: str, flags: Sequence[str], params: str | None) -> dict[str, Any]:
    """The task's parameters: the JSON object, what the options say, and what follows from both."""
    from rodeo.kinds import kinds_of

    values: dict[str, Any] = {}
    if params is not None:
        try:
            values = json.loads(params)
        except ValueError as error:
            raise MalformedJson(f"--params is not JSON: {error}") from error
        if not isinstance(values, dict):
            raise MalformedJson("--params is not a JSON object")
    kinds = kinds_of(site)
    kind = kinds.get(name)
    if kind is None and flags:
        raise InvalidRequest(
            "the site file lists no such kind, so its parameters are unknown: give them with --params",
            name=name,
            given=list(flags),
            listed=sorted(kinds),
        )
    values |= _flags(flags, {} if kind is None else kind.schema.get("properties", {}))
    if kind is None:
        return values
    values = kind.complete(site, values)
    if wrong := kind.wrong_params(site, values):
        raise InvalidRequest("the task's parameters are not valid", fields=wrong)
    return values


def _flags(flags: Sequence[str], properties: dict[str, Any]) -> dict[str, Any]:
    """`--item-id item1` as {"item_id": "item1"}, each value of the type that the schema says."""
    values: dict[str, Any] = {}
    rest = list(flags)
    while rest:
        flag, given, value = rest.pop(0).partition("=")
        name = flag.removeprefix("--").replace("-", "_")
        if not flag.startswith("--") or name not in properties:
            known = ["--" + one.replace("_", "-") for one in properties]
            raise InvalidRequest("this kind has no such parameter", given=flag, known=known)
        if not given:
            if not rest:
                raise InvalidRequest("this parameter needs a value", given=flag)
            value = rest.pop(0)
        values[name] = value if properties[name].get("type") == "string" else _json_value(flag, value)
    return values


def _json_value(flag: str, text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        raise InvalidRequest(
            "this parameter's value does not fit its kind's schema", given=flag, value=text
        ) from None


def _party(name: str | None, address: str | None) -> str:
    return name or (f"{address[:8]}…" if address else "")
