"""Commands about tasks."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.markup import escape
from typer.core import CompletionItem, TyperCommand

from rodeo.bus import queries
from rodeo.bus.session import Bus, DaoEvents, validate
from rodeo.display.formatting import (
    count,
)
from rodeo.errors import InvalidRequest
from rodeo.host.clocked import ClockedEvent
from rodeo.money.rewards import Rise
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    KINDS,
    JsonOption,
    ParticipantOption,
    SiteOption,
    connected,
    errors,
    print_facts,
    print_json,
    print_listing,
    reports_errors,
    say,
    send_command,
    site_clock,
)
from rodeo_cli.completion import PARAMETERS, site_names
from rodeo_cli.formatting import iec, worth
from rodeo_cli.signing import SignedArgument, SignOption, ValidOption, sign_into, signed_in
from rodeo_cli.task_params import task_params
from rodeo_cli.task_words import facts_on, row

tasks = typer.Typer(help="Post, list, show and cancel tasks.", no_args_is_help=True)


RulesOption = Annotated[
    str | None,
    typer.Option(
        "--rules",
        help="Hash of the rules by which it is judged, among the kind's current ones "
        "(`rodeo kind show`). By default the newest.",
    ),
]
ServiceOption = Annotated[
    int | None, typer.Option(help="The only service that may do it. By default the policy chooses.")
]
NamedProviderOption = Annotated[
    str | None,
    typer.Option(help="The only provider that may do it, with any of its services: a name or an address."),
]
AtOption = Annotated[
    str | None,
    typer.Option(
        help="Where on the map: x,y in m, such as 3.2,1.4. Without an item it is about whatever lies there."
    ),
]
UpToOption = Annotated[
    str | None,
    typer.Option(
        "--reward-up-to", help="Stay, and raise the reward up to this (IEC) while nobody takes the task."
    ),
]


class _Create(TyperCommand):
    """Completes the values of the kind's parameters, which are no options of the command itself."""

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        if ctx.args and (place := PARAMETERS.get(ctx.args[-1])):
            names = site_names(place, default=DEFAULT_SITE)(ctx, incomplete)
            return [CompletionItem(name) for name in names]
        found = super().shell_complete(ctx, incomplete)
        if incomplete.startswith("-"):
            found += [CompletionItem(one) for one in PARAMETERS if one.startswith(incomplete)]
        return found


@tasks.command(
    "create",
    cls=_Create,
    context_settings={"ignore_unknown_options": True, "allow_extra_args": True},
)
@reports_errors
def create(
    context: typer.Context,
    kind: Annotated[
        str, typer.Argument(help="A kind of work that the organization accepts.", autocompletion=KINDS)
    ],
    reward: Annotated[str, typer.Option(help="Reward in IEC, put into escrow.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
    params: Annotated[str | None, typer.Option(help="The task's parameters as a JSON object.")] = None,
    at: AtOption = None,
    description: Annotated[str, typer.Option(help="Description for people.")] = "",
    max_attempts: Annotated[int | None, typer.Option(help="Attempts before the reward is refunded.")] = None,
    rules_sha256: RulesOption = None,
    service: ServiceOption = None,
    provider: NamedProviderOption = None,
    wait: Annotated[bool, typer.Option("--wait", help="Queue it even if every service costs more.")] = False,
    up_to: UpToOption = None,
    rise: Annotated[float, typer.Option(help="Part of the reward that each rise adds.")] = 0.1,
    rise_every: Annotated[float, typer.Option(help="Seconds of site time between two rises.")] = 3600.0,
    sign: SignOption = None,
    valid_s: ValidOption = 86_400,
    as_json: JsonOption = False,
) -> None:
    """Post a task, for example: rodeo task create KIND --reward 100

    Each parameter of the kind is an option of its own, with the name of a file for a photo; `rodeo kind show
    KIND` lists them. To raise the reward, the task is posted again under another number.
    """
    if sign is not None and up_to is not None:
        raise InvalidRequest("the reward of a task that is only signed cannot rise: leave --reward-up-to out")
    rises = None if up_to is None else validate(Rise, {"up_to_iec": up_to, "by": rise, "every_s": rise_every})
    with connected(site) as (loaded, bus):
        request: dict[str, Any] = {
            "kind": kind,
            "reward_iec": reward,
            "params": task_params(loaded, kind, context.args, params, at),
            "description": description,
            "allow_wait": wait,
        }
        optional = {
            "max_attempts": max_attempts,
            "rules_sha256": rules_sha256,
            "service_id": service,
            "provider": provider,
        }
        request |= {name: value for name, value in optional.items() if value is not None}
        if doubt := _doubt(loaded, bus, kind, request["params"]):
            errors.print(f"[bold yellow]warning[/]: {escape(doubt)}", highlight=False, soft_wrap=True)
        if sign is not None:
            sign_into(loaded, bus, participant, "register_task", request, valid_s, sign, as_json)
            return
        reply = send_command(loaded, bus, participant, "register_task", **request)
        if not as_json:
            say(f"Task {reply['task_id']} is posted, and {worth(reward, loaded)} are in escrow for it.")
        if rises is not None:
            reply["task_id"] = _raised(loaded, bus, participant, int(reply["task_id"]), rises, as_json)
    if as_json:
        print_json(reply | ({"warning": doubt} if doubt else {}))


def _raised(site: Site, bus: Bus, participant: str, task_id: int, rises: Rise, quiet: bool) -> int:
    """Raise the task's reward until somebody has taken it or it is the highest; the task's number then."""
    from rodeo.dao import Participant  # takes its time to import

    tell = (lambda _sentence: None) if quiet else say
    creator, clock = Participant(bus, site.org, participant), site_clock(site, bus)
    heard = ClockedEvent(clock)
    with DaoEvents(bus, site.org, lambda _event: heard.set(), clock=clock):
        while (reward := rises.after((task := creator.task(task_id)).reward_iec)) is not None:
            if task.state != "open":
                tell(f"Task {task_id} waits no more.")
                return task_id
            until_s = task.registered + rises.every_s
            if heard.wait(until_s=until_s):
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
        reply, as_json, columns, (row(one, loaded) for one in reply.tasks), folds=(1, 4, 5), after=shown
    )


@tasks.command("show")
@reports_errors
def show(task_id: int, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show one task with its times, proof and verdict."""
    with connected(site) as (loaded, bus):
        task = queries.ask(bus, loaded.org, queries.TASK, id=task_id)
        told = () if as_json else facts_on(loaded, bus, task)
    print_facts(task, as_json, told)


@tasks.command("relay")
@reports_errors
def relay(
    file: SignedArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: Annotated[str, typer.Option("--as", help="Whose wallet pays the gas.")] = "organization",
    as_json: JsonOption = False,
) -> None:
    """Send what somebody else has signed with --sign, and pay the gas for it. It can be sent once."""
    signed = signed_in(file)
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
    """Revoke a request that was signed with --sign and not sent yet. This costs its signer gas."""
    from rodeo.chain.signed_requests import SAID  # takes its time to import

    typed = signed_in(file)["request"]["typed_data"]
    kind = SAID.get(str(typed.get("primaryType")))
    if kind is None:
        raise InvalidRequest(
            "not a request that can be sent for somebody", file=str(file), known=sorted(SAID)
        )
    nonce = validate(kind, typed.get("message")).nonce
    with connected(site) as (loaded, bus):
        send_command(loaded, bus, participant, "revoke_request", nonce=nonce)
    say(f"Nobody can send what is in {file} any more.")


def _doubt(site: Site, bus: Bus, kind: str, params: dict[str, Any]) -> str:
    """Reason why the task can probably not be done as posted."""
    from rodeo.dao import ORGANIZATION, Participant
    from rodeo.kinds import kinds_of

    return Participant(bus, site.org, ORGANIZATION).doubt(kinds_of(site).get(kind), params)
