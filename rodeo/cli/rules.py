"""Commands about the organization itself: its rules, members, devices and treasury."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from rodeo import topics
from rodeo.cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    console,
    print_json,
    reports_errors,
    say,
)
from rodeo.cli.layout import Row, lines
from rodeo.cli.organization import ParticipantOption
from rodeo.cli.words import iec, moment
from rodeo.durations import span
from rodeo.errors import InvalidRequest
from rodeo.messages import Policy, RoleName
from services.console.words import count

rules = typer.Typer(
    help="The organization's rules, members, devices and treasury: for whoever has the role on its contract.",
    no_args_is_help=True,
)

AccountArgument = Annotated[str, typer.Argument(help="A participant's name or an address.")]
RoleArgument = Annotated[str, typer.Argument(help=f"{', '.join(get_args(RoleName))}.")]
AmountArgument = Annotated[str, typer.Argument(help="In IEC.")]


@rules.command("show")
@reports_errors
def show(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show the rules, the treasury and who holds which role."""
    with connected(site) as (loaded, bus):
        state = bus.query(topics.STATE.name(org=loaded.org, what="organization"))
    if as_json:
        print_json(state)
        return
    terms = state["terms"]
    told = [
        ("address", state["address"]),
        ("treasury", iec(state["treasury_iec"])),
        ("policy", state["policy"]),
        (
            "terms of new services",
            f"bond {iec(terms['bond_iec'])}, penalty {iec(terms['penalty_iec'])}, "
            + (
                f"suspended after {count(terms['max_failures'], 'failure')}"
                if terms["max_failures"]
                else "never suspended"
            ),
        ),
        ("open to", "members" if state["members_only"] else "everybody"),
        *((kind["kind"], _kind_in_words(kind)) for kind in state["kinds"]),
        *(
            (_ROLES.get(role, role), ", ".join(one["name"] or one["address"] for one in holders))
            for role, holders in sorted(state["roles"].items())
        ),
    ]
    for line in lines(("", ""), [Row(one, {0: "bold"}) for one in told], console.width, folds=(1,))[1:]:
        console.print(line, soft_wrap=True)


_ROLES = {
    "DEFAULT_ADMIN_ROLE": "administrators",
    "OPERATOR_ROLE": "operators",
    "TREASURER_ROLE": "treasurers",
    "ORACLE_ROLE": "oracles",
    "AUDITOR_ROLE": "auditors",
    "MEMBER_ROLE": "members",
}
"""Holders of a role that the contract knows by this name."""


def _kind_in_words(kind: dict[str, Any]) -> str:
    if not kind["allowed"]:
        return "not accepted"
    told = f"judged by {'an auditor' if kind['review'] == 'auditor' else 'the oracle'}"
    if kind["min_window_s"]:
        told += f"; at least {span(kind['min_window_s'])} to work"
    if kind["review"] == "oracle" and kind["audit_window_s"]:
        told += f"; where it cannot decide, auditors have {span(kind['audit_window_s'])}"
        told += f", then the {kind['silence']} wins"
    return told


@rules.command("policy")
@reports_errors
def policy(
    name: Annotated[str, typer.Argument(help=f"{', '.join(get_args(Policy))}.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Say how a service is chosen for a task."""
    _send(site, participant, "set_policy", f"Services are now chosen by {name}.", policy=name)


@rules.command("kind")
@reports_errors
def kind(
    name: Annotated[str, typer.Argument(help="The kind of task.")],
    allowed: Annotated[bool, typer.Option("--allow/--disallow")] = True,
    review: Annotated[
        str | None,
        typer.Option(help="Who judges it, which must be said to allow it: auditor (people), or oracle."),
    ] = None,
    min_window_s: Annotated[
        int | None, typer.Option("--min-window", help="Shortest execution window, in seconds.")
    ] = None,
    audit_window_s: Annotated[
        int | None,
        typer.Option("--audit-window", help="For auditors, when the oracle could not decide, in seconds."),
    ] = None,
    at_silence: Annotated[
        str | None, typer.Option(help="Who wins when the auditors do not answer: executor or creator.")
    ] = None,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Accept a kind of work, or no longer. Nobody judges it unless you say who."""
    if allowed and review is None:
        raise InvalidRequest(
            f"say who judges {name}: --review auditor for people, or --review oracle where it has checks",
            kind=name,
        )
    fields = {
        "kind": name,
        "allowed": allowed,
        "review": review,
        "min_window_s": min_window_s,
        "audit_window_s": audit_window_s,
        "at_silence": at_silence,
    }
    accepted = f"judged by the {review}" if allowed else "no longer accepted"
    _send(
        site,
        participant,
        "allow_kind",
        f"{name} is {'accepted and ' if allowed else ''}{accepted}.",
        **fields,
    )


@rules.command("terms")
@reports_errors
def terms(
    bond: Annotated[str, typer.Option(help="Locked until the service retires, in IEC.")] = "0",
    penalty: Annotated[str, typer.Option(help="What a failed attempt takes from the bond, in IEC.")] = "0",
    max_failures: Annotated[int, typer.Option(help="Failures in a row that suspend; 0 for none.")] = 0,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Say what services agree to that are offered from now on."""
    fields = {"bond_iec": bond, "penalty_iec": penalty, "max_failures": max_failures}
    _send(site, participant, "set_terms", "Services offered from now on agree to these terms.", **fields)


@rules.command("members-only")
@reports_errors
def members_only(
    enabled: Annotated[bool, typer.Option("--on/--off")] = True,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let only members offer services and post tasks, or everybody."""
    who = "Only members may" if enabled else "Everybody may"
    _send(site, participant, "set_members_only", f"{who} offer services and post tasks now.", enabled=enabled)


@rules.command("admit")
@reports_errors
def admit(
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Make somebody a member."""
    _send(site, participant, "admit", f"{account} is a member now.", account=account)


@rules.command("dismiss")
@reports_errors
def dismiss(
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """End a membership."""
    _send(site, participant, "dismiss", f"{account} is no member any more.", account=account)


@rules.command("grant")
@reports_errors
def grant(
    role: RoleArgument,
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Give somebody a role."""
    _send(site, participant, "grant_role", f"{account} is {role} now.", role=role, account=account)


@rules.command("revoke")
@reports_errors
def revoke(
    role: RoleArgument,
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Take a role back."""
    _send(site, participant, "revoke_role", f"{account} is {role} no more.", role=role, account=account)


@rules.command("suspend")
@reports_errors
def suspend(
    service_id: int, site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization"
) -> None:
    """Give a service no more tasks."""
    _send(
        site,
        participant,
        "suspend_service",
        f"Service {service_id} gets no more tasks until it is reinstated.",
        service_id=service_id,
    )


@rules.command("reinstate")
@reports_errors
def reinstate(
    service_id: int, site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization"
) -> None:
    """Let a suspended service return: paused, until its provider activates it."""
    _send(
        site,
        participant,
        "reinstate_service",
        f"Service {service_id} may return: it is paused until its provider activates it.",
        service_id=service_id,
    )


@rules.command("deposit")
@reports_errors
def deposit(
    amount: AmountArgument, site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization"
) -> None:
    """Pay into the treasury from the account of whose key signs."""
    _send(site, participant, "deposit", f"{amount} IEC are in the treasury now.", amount_iec=amount)


@rules.command("withdraw")
@reports_errors
def withdraw(
    amount: AmountArgument,
    to: Annotated[str, typer.Option(help="A participant's name or an address.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Pay out of the treasury."""
    _send(
        site,
        participant,
        "withdraw",
        f"{amount} IEC of the treasury are {to}'s now.",
        to=to,
        amount_iec=amount,
    )


@rules.command("devices")
@reports_errors
def devices(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the keys that sign evidence."""
    with connected(site) as (loaded, bus):
        reply = bus.query(topics.STATE.name(org=loaded.org, what="devices"))
    if as_json:
        print_json(reply)
        return
    rows = []
    for one in reply["devices"]:
        gone = "" if one["revoked"] is None else f"revoked: {one['revoked_because']}"
        cells = (one["role"], one["name"], one["owner_name"] or one["owner"], one["address"])
        rows.append(Row(cells, note=gone))
    for line in lines(("role", "name", "owner", "address"), rows, console.width, folds=(2, 1)):
        console.print(line, soft_wrap=True)


@rules.command("roots")
@reports_errors
def roots(
    device: Annotated[str | None, typer.Option(help="Address of a key; all by default.")] = None,
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """List what devices signed on a day, as it was fixed on chain."""
    parameters = {} if device is None else {"device": device}
    with connected(site) as (loaded, bus):
        reply = bus.query(topics.STATE.name(org=loaded.org, what="roots"), parameters=parameters)
        known = bus.query(topics.STATE.name(org=loaded.org, what="devices"))["devices"]
    if as_json:
        print_json(reply)
        return
    if not reply["roots"]:
        say("No root of a day is on chain yet.")
        return
    names = {one["address"]: f"{one['role']} {one['name']}" for one in known}
    rows = [
        Row((moment(one["day"] * 86_400, loaded)[:10], names.get(one["device"], one["device"]), one["root"]),
            note=one["uri"])
        for one in reply["roots"]
    ]  # fmt: skip
    day = "day (UTC)" if loaded.clock.source == "wall" else "day of the simulated time"
    for line in lines((day, "device", "root"), rows, console.width, folds=(0, 1, 2)):
        console.print(line, soft_wrap=True)


@rules.command("register-device")
@reports_errors
def register_device(
    address: Annotated[str, typer.Argument(help="Of the key that signs evidence.")],
    role: Annotated[str, typer.Option(help="What it is: robot, bin, meter, mocap.")],
    owner: Annotated[str, typer.Option(help="A participant's name or an address.")],
    name: Annotated[str, typer.Option(help="Which one it is on its site, for example panther1 or dock1.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let a key sign evidence. Revoke the key that has this role and name first, if there is one."""
    _send(
        site,
        participant,
        "register_device",
        f"{address} signs as {role} {name} of {owner} from now on.",
        device=address,
        role=role,
        owner=owner,
        name=name,
    )


@rules.command("revoke-device")
@reports_errors
def revoke_device(
    address: Annotated[str, typer.Argument(help="Of the key that signs evidence.")],
    reason: Annotated[
        str,
        typer.Option(
            help="superseded: another key takes over; compromised: somebody else may have signed with it."
        ),
    ],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Reject everything that a key signs from now on; of what it signed before, the reason decides."""
    _send(
        site,
        participant,
        "revoke_device",
        f"Nothing that {address} signs from now on counts.",
        device=address,
        reason=reason,
    )


def _send(site: Path, participant: str, command: str, done: str, **fields: Any) -> None:
    """Do it, and say the sentence `done` when it is. Fields that are None are left out."""
    request = {name: value for name, value in fields.items() if value is not None}
    with connected(site) as (loaded, bus):
        key = topics.COMMAND.name(org=loaded.org, participant=participant, command=command)
        bus.query(key, request, timeout_s=30)
    say(done)
