"""Commands about the organization itself: its rules, members, devices and treasury."""

from __future__ import annotations

from collections import Counter
from decimal import Decimal
from typing import Annotated, get_args

import typer

from rodeo import queries
from rodeo.config import Site
from rodeo.durations import span
from rodeo.errors import InvalidRequest
from rodeo.kinds import KindError, installed, kinds_of, load
from rodeo.messages import LIVE_STATES, Policy, RoleName
from rodeo_cli import budget_votes
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    print_facts,
    print_listing,
    reports_errors,
    say,
)
from rodeo_cli.formatting import iec, moment
from rodeo_cli.layout import Row
from rodeo_cli.proposals import register, send
from rodeo_cli.tasks import ParticipantOption
from services.console.formatting import count, quorum_in_words, voids_in_words, windows_in_words

organization = typer.Typer(
    help="Show and change the organization's rules, members, devices and treasury.",
    no_args_is_help=True,
)

AccountArgument = Annotated[str, typer.Argument(help="A participant's name or an address.")]
RoleArgument = Annotated[str, typer.Argument(help=f"{', '.join(get_args(RoleName))}.")]
JudgeArgument = Annotated[str, typer.Argument(help="The oracle's name, or the address of its key.")]
StakedArgument = Annotated[
    str, typer.Argument(metavar="JUDGE", help="The judge's name, or the address of its key.")
]
"""An oracle, or who decides about challenges."""
SeatSignature = Annotated[str, typer.Option(help="The key's own signature: `sign-seat` makes it.")]
_COMMITTEES = ("OracleCommittee", "DisputeCommittee", "AppealCommittee")
AmountArgument = Annotated[str, typer.Argument(help="In IEC.")]


@organization.command("show")
@reports_errors
def show(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show the rules, the treasury and who holds which role."""
    with connected(site) as (loaded, bus):
        state = queries.ask(bus, loaded.org, queries.ORGANIZATION)
    terms = state.terms
    told = [
        ("address", state.address),
        ("treasury", iec(state.treasury_iec)),
        ("policy", state.policy),
        (
            "terms of new services",
            f"bond {iec(terms.bond_iec)}, penalty {iec(terms.penalty_iec)}, "
            + (
                f"suspended after {count(terms.max_failures, 'failure')}"
                if terms.max_failures
                else "never suspended"
            ),
        ),
        ("decided by", _decides_in_words(state)),
        ("open to", "members" if state.members_only else "everybody"),
        *(("suspended provider", one.name or one.address) for one in state.suspended_providers),
        ("new tasks", _pause_in_words(state, loaded)),
        *(
            (f"budget of {_ROLES[role]}", f"{iec(one.amount_iec)} in {span(one.period_s)}")
            for role, one in sorted(state.budgets.items())
        ),
        *((kind.kind, _kind_in_words(kind)) for kind in state.kinds),
        ("void attempts", voids_in_words(state.voids)),
        *(
            (
                f"judge in seat {one.seat}",
                f"{one.name or 'unnamed'}, for {one.owner_name or one.owner}, {one.key}"
                + _stake_in_words(one, state.stake_needed(one), loaded)
                + ("" if any(one.seat in kind.seats for kind in state.kinds) else ", judges nothing"),
            )
            for one in state.judges
        ),
        *(
            (
                f"judge of {'challenges' if number == 0 else 'the appeal'} in seat {one.seat}",
                f"{one.name or 'unnamed'}, {one.key}"
                + _stake_in_words(one, committee.stake_needed(one), loaded)
                + ("" if any(one.seat in kind.seats for kind in committee.kinds) else ", judges nothing"),
            )
            for number, committee in enumerate(state.committees)
            for one in committee.judges
        ),
        *(
            (_ROLES.get(role, role), ", ".join(_holder(one, state) for one in holders) or "nobody")
            for role, holders in sorted(state.roles.items())
        ),
    ]
    print_facts(state, as_json, told)


@organization.command("list")
@reports_errors
def list_(
    site: SiteOption = DEFAULT_SITE,
    newest: Annotated[int, typer.Option(min=1, help="How many to list, the newest.")] = 50,
    as_json: JsonOption = False,
) -> None:
    """List the organizations of this release on the site's chain, by its node.

    Anybody may found one, under any name: whom to trust follows from the founder's address.
    """
    # Imported here: what speaks to a node takes a second to load.
    from eth_utils import to_checksum_address

    from rodeo.chain.client import connect, require_chain
    from rodeo.chain.deployment import Deployment
    from rodeo.chain.errors import NotDeployed
    from rodeo.chain.registry import Registry, known_address

    loaded = Site.load(site)
    w3 = connect(loaded.chain.url)
    require_chain(w3, loaded.chain)
    try:
        own: Deployment | None = Deployment.load(loaded.data_dir, loaded.chain.id)
    except NotDeployed:
        own = None
    address = (own and own.registry) or loaded.chain.registry or known_address()
    registry = Registry(w3, to_checksum_address(address))
    found = registry.organizations(newest) if registry.is_there else []
    entries = [
        {
            "name": one.name,
            "number": one.number,
            "founder": one.founder,
            "address": one.address,
            "founded_in_block": one.founded_in,
            "own": own is not None and own.contracts["Organization"] == one.address,
        }
        for one in found
    ]
    rows = [
        Row(
            (
                f"{one.name} ({one.number})" if one.number else one.name,
                one.address,
                one.founder,
                str(one.founded_in),
                "yes" if entry["own"] else "",
            )
        )
        for one, entry in zip(found, entries, strict=True)
    ]
    columns = ("name", "address", "founder", "block", "this site's")
    more = registry.count - len(found) if found else 0
    after = f"and {count(more, 'older one')}: list more with --newest" if more else ""
    after = after or ("" if found else f"no organization was founded at the registry {registry.address}")
    print_listing(
        {"registry": registry.address, "organizations": entries}, as_json, columns, rows, (1, 2), after
    )


def _holder(one: queries.Holder, state: queries.Organization) -> str:
    """The holder of a role: a participant, a contract of the organization, or an address."""
    contracts = state.contracts.model_dump(by_alias=True)
    name = one.name or next((name for name, address in contracts.items() if address == one.address), None)
    return name or one.address


def _decides_in_words(state: queries.Organization) -> str:
    """The party that decides about the organization, and how long everybody can see it coming."""
    if state.decided_by == "vote":
        return f"the members, by vote, {span(state.delay_s)} after a vote"
    return f"the administrator, {f'{span(state.delay_s)} after a proposal' if state.delay_s else 'at once'}"


_ROLES = {
    "DEFAULT_ADMIN_ROLE": "administrators",
    "OPERATOR_ROLE": "operators",
    "TREASURER_ROLE": "treasurers",
    "ORACLE_ROLE": "oracles",
    "AUDITOR_ROLE": "auditors",
    "MEMBER_ROLE": "members",
    "GUARDIAN_ROLE": "guardians",
    "ALLOCATOR_ROLE": "pay shares",
    "PROPOSER_ROLE": "may propose",
    "CANCELLER_ROLE": "may cancel proposals",
}
"""Holders of a role that the contract, or its timelock, knows by this name."""


def _pause_in_words(state: queries.Organization, site: Site) -> str:
    """Empty where new tasks were never paused: nothing to tell."""
    return f"none before {moment(state.paused_until_s, site)}" if state.paused_until_s else ""


def _stake_in_words(judge: queries.Judge, needed: Decimal, site: Site) -> str:
    """Empty where it neither has nor needs one."""
    told = f", stake {iec(judge.stake_iec)}" if judge.stake_iec or needed else ""
    if judge.stake_iec < needed:
        told += f" of {iec(needed)}, so that its votes do not count"
    if judge.leaving_iec:
        told += f", {iec(judge.leaving_iec)} leave after {moment(judge.leaving_until_s, site)}"
    return told


def _kind_in_words(kind: queries.KindRules) -> str:
    if not kind.allowed:
        return "not accepted"
    names = {"auditor": "an auditor", "oracle": "the oracle"}
    told = f"judged by {names.get(kind.judge, f'the contract {kind.judge}')}"
    if kind.removed:
        return "its judge was removed: `rodeo organization kind --judge` sets another"
    if kind.judge == "oracle" and kind.votes:
        told = f"judged by {quorum_in_words(kind)}"
        if kind.judge_stake_iec:
            told += f" with a stake of {iec(kind.judge_stake_iec)} each"
    if windows := windows_in_words(kind):
        told += f"; {windows}; an attempt counts up to {iec(kind.reference_price_iec)}"
    if kind.max_verdict_window_s:
        told += f"; {span(kind.min_verdict_window_s)} to {span(kind.max_verdict_window_s)} to judge"
    if kind.audit_window_s:
        late = (
            "before it is void" if kind.judge == "auditor" else "for auditors, where the judge cannot decide"
        )
        told += f"; {span(kind.audit_window_s)} more {late}"
    if kind.rules_sha256:
        told += f"; by the rules {' or '.join(reversed(kind.rules_sha256))}"
    return told


@organization.command("policy")
@reports_errors
def policy(
    name: Annotated[str, typer.Argument(help=f"{', '.join(get_args(Policy))}.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Set how a service is chosen for a task."""
    send(site, participant, "set_policy", f"Services are now chosen by {name}.", policy=name)


@organization.command("kind")
@reports_errors
def kind(
    name: Annotated[str, typer.Argument(help="The kind of task.")],
    allowed: Annotated[bool, typer.Option("--allow/--disallow")] = True,
    judge: Annotated[
        str | None,
        typer.Option(
            help="Who judges it: auditor (people), oracle, or the address of a contract. Required to allow a "
            "kind. Services go on under the judge before until their providers agree (`rodeo service agree`)."
        ),
    ] = None,
    min_window_s: Annotated[
        int | None,
        typer.Option(
            "--min-window",
            help="Shortest execution window, in seconds. By default, as for the next two, what the kind has "
            "now, or what its package says.",
        ),
    ] = None,
    max_window_s: Annotated[
        int | None, typer.Option("--max-window", help="Longest execution window, in seconds.")
    ] = None,
    grace_s: Annotated[
        int | None,
        typer.Option(
            "--grace",
            help="How long an executor may give a task back so that the attempt does not count, in tens of "
            "seconds, at most half of the shortest window. 0: three minutes, or that half if it is less.",
        ),
    ] = None,
    reference_price_iec: Annotated[
        str | None,
        typer.Option(
            "--reference-price",
            help="The most that an attempt counts in its provider's record, in IEC. By default what it is "
            "now, or the kind's `price_iec`.",
        ),
    ] = None,
    min_verdict_window_s: Annotated[
        int | None, typer.Option("--min-verdict-window", help="Shortest verdict window, in seconds.")
    ] = None,
    max_verdict_window_s: Annotated[
        int | None, typer.Option("--max-verdict-window", help="Longest verdict window, in seconds.")
    ] = None,
    audit_window_s: Annotated[
        int | None,
        typer.Option(
            "--audit-window",
            help="How long after the verdict window a ruling may still be replaced, in seconds: by auditors "
            "where the judge cannot decide. Where nobody rules, the attempt is void.",
        ),
    ] = None,
    rules_sha256: Annotated[
        str | None,
        typer.Option(
            "--rules",
            help="Hash of the rules by which it is judged, beside those that are current. Where the oracle "
            "judges, the default is the hash of the kind as it is installed, with the networks and rates of "
            "the site file (`rodeo kind show`).",
        ),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Allow a kind of work, or stop allowing it. To allow it, set who judges it.

    Repeat it after an update of the kind's package, or of its networks or rates in the site file: new tasks
    are then judged by the new rules.
    """
    if allowed and judge is None:
        raise InvalidRequest(
            f"choose who judges {name}: --judge auditor for people, or --judge oracle where it has checks",
            kind=name,
        )
    fields = {
        "kind": name,
        "allowed": allowed,
        "judge": judge,
        "min_window_s": min_window_s,
        "max_window_s": max_window_s,
        "grace_s": grace_s,
        "reference_price_iec": reference_price_iec,
        "min_verdict_window_s": min_verdict_window_s,
        "max_verdict_window_s": max_verdict_window_s,
        "audit_window_s": audit_window_s,
        "rules_sha256": rules_sha256
        or (_installed_rules(Site.load(site), name) if judge == "oracle" else None),
    }
    judges = judge if judge in ("oracle", "auditor") else f"contract {judge}"
    accepted = f"judged by the {judges}" if allowed else "no longer accepted"
    send(
        site,
        participant,
        "allow_kind",
        f"{name} is {'accepted and ' if allowed else ''}{accepted}.",
        **fields,
    )


@organization.command("remove-judge")
@reports_errors
def remove_judge(
    name: Annotated[str, typer.Argument(metavar="KIND", help="The kind of task.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Remove the judge of a kind at once and for good, as a guardian or administrator.

    Its rulings that nobody has concluded become void, and the auditors may replace them. `kind --judge` sets
    another judge.
    """
    done = f"The judge of {name} rules no more. `rodeo organization kind {name} --judge` sets another."
    send(site, participant, "remove_judge", done, kind=name)


@organization.command("rules")
@reports_errors
def rules(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the rules by which tasks are judged, and how many tasks that have not ended need each of them.

    Update an oracle's checks once no open task needs the rules that it has.
    """
    with connected(site) as (loaded, bus):
        kinds = queries.ask(bus, loaded.org, queries.ORGANIZATION).kinds
        needed: Counter[tuple[str, str]] = Counter()
        offset, total = 0, 1
        while offset < total:
            page = queries.ask(
                bus,
                loaded.org,
                queries.TASKS,
                state=",".join(LIVE_STATES),
                order="oldest",
                limit=queries.MAX_PAGE,
                offset=offset,
            )
            needed.update((task.kind, task.rules_sha256) for task in page.tasks if task.rules_sha256)
            offset, total = offset + queries.MAX_PAGE, page.total
    current = [(kind.kind, one) for kind in kinds for one in kind.rules_sha256]
    newest = {(kind.kind, kind.rules_sha256[-1]) for kind in kinds if kind.rules_sha256}
    entries = [
        {
            "kind": name,
            "rules_sha256": one,
            "state": "newest"
            if (name, one) in newest
            else "current"
            if (name, one) in current
            else "retired",
            "open_tasks": needed[name, one],
            "installed": one == _installed_rules(loaded, name),
        }
        for name, one in sorted({*current, *needed}, key=lambda entry: (entry[0], entry not in current))
    ]
    rows = [
        Row(
            (
                str(one["kind"]),
                str(one["rules_sha256"]),
                str(one["state"]),
                str(one["open_tasks"]),
                "yes" if one["installed"] else "no",
            )
        )
        for one in entries
    ]
    columns = ("kind", "rules", "state", "open tasks", "installed here")
    print_listing({"rules": entries}, as_json, columns, rows, folds=(1,))


@organization.command("retire-rules")
@reports_errors
def retire_rules(
    name: Annotated[str, typer.Argument(help="The kind of task.")],
    rules_sha256: Annotated[str, typer.Argument(metavar="RULES", help="Their hash.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let nobody post a task under these rules any more. Tasks that were posted under them keep them."""
    send(
        site,
        participant,
        "retire_rules",
        f"No task of {name} is posted under {rules_sha256} any more.",
        kind=name,
        rules_sha256=rules_sha256,
    )


def _installed_rules(site: Site, name: str) -> str | None:
    """Hash of the rules by which this site's oracle judges a kind, with the networks and rates of the site
    file; of an installed kind that the site does not list, as it comes. None where people judge it, or
    nothing of the name can be imported here."""
    # Imported here: what the checks use takes its time, and most commands need none of it.
    from rodeo.checks.rules import rules_hash

    try:
        if (kind := kinds_of(site).get(name)) is None and name in installed():
            kind = load(name)
        return None if kind is None else rules_hash(kind)
    except KindError:
        return None


@organization.command("terms")
@reports_errors
def terms(
    bond: Annotated[str, typer.Option(help="Bond that a service locks until it retires, in IEC.")] = "0",
    penalty: Annotated[str, typer.Option(help="Amount that a failed attempt costs, in IEC.")] = "0",
    max_failures: Annotated[int, typer.Option(help="Failures in a row until suspension; 0: never.")] = 0,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Set the terms for services that are offered from now on."""
    fields = {"bond_iec": bond, "penalty_iec": penalty, "max_failures": max_failures}
    send(site, participant, "set_terms", "Services offered from now on agree to these terms.", **fields)


@organization.command("members-only")
@reports_errors
def members_only(
    enabled: Annotated[bool, typer.Option("--on/--off")] = True,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let only members, or everybody, offer services and post tasks."""
    who = "Only members may" if enabled else "Everybody may"
    send(site, participant, "set_members_only", f"{who} offer services and post tasks now.", enabled=enabled)


@organization.command("budget")
@reports_errors
def budget(
    role: Annotated[str, typer.Argument(help="operator: rewards and bonds; treasurer: withdrawals.")],
    amount: Annotated[str, typer.Argument(help="In IEC, for each period.")] = "0",
    period_s: Annotated[int, typer.Option("--period", help="In seconds. 0 ends the limit.")] = 24 * 3600,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Limit what all holders of a role together take out of the treasury."""
    limit = f"at most {amount} IEC in {span(period_s)}" if period_s else "as much as there is"
    done = f"The role {role} may take {limit} out of the treasury."
    send(site, participant, "set_budget", done, role=role, amount_iec=amount, period_s=period_s)


@organization.command("pause")
@reports_errors
def pause(
    duration_s: Annotated[int, typer.Argument(metavar="SECONDS", help="At most three days.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Take no new tasks for a while, as a guardian. Everything that runs continues."""
    done = f"No new tasks are taken for {span(duration_s)}."
    send(site, participant, "pause_tasks", done, duration_s=duration_s)


@organization.command("resume")
@reports_errors
def resume(site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization") -> None:
    """Take new tasks again before a pause ends."""
    send(site, participant, "resume_tasks", "New tasks are taken.")


@organization.command("admit")
@reports_errors
def admit(
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Make somebody a member."""
    send(site, participant, "admit", f"{account} is now a member.", account=account)


@organization.command("dismiss")
@reports_errors
def dismiss(
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """End a membership."""
    send(site, participant, "dismiss", f"{account} is no longer a member.", account=account)


@organization.command("vouch")
@reports_errors
def vouch(
    account: AccountArgument,
    vouched: Annotated[bool, typer.Option("--on/--off", help="Vouch, or do so no longer.")] = True,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Vouch for a provider, so that it is proven before it has done any work. Members are vouched for.

    A proven provider works with all its services at once, and does not rest when it gives a task back.
    """
    done = f"The organization vouches for {account}{'' if vouched else ' no longer'}."
    send(site, participant, "vouch", done, account=account, vouched=vouched)


@organization.command("grant")
@reports_errors
def grant(
    role: RoleArgument,
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Give somebody a role."""
    send(site, participant, "grant_role", f"{account} now has the role {role}.", role=role, account=account)


@organization.command("revoke")
@reports_errors
def revoke(
    role: RoleArgument,
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Take a role back."""
    send(
        site,
        participant,
        "revoke_role",
        f"{account} no longer has the role {role}.",
        role=role,
        account=account,
    )


@organization.command("suspend-provider")
@reports_errors
def suspend_provider(
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Give no service of a provider more tasks, and let it offer no others."""
    done = f"{account} and its services are suspended. Running tasks continue."
    send(site, participant, "suspend_provider", done, account=account)


@organization.command("reinstate-provider")
@reports_errors
def reinstate_provider(
    account: AccountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let a suspended provider offer services again. Reinstate those that it has one by one."""
    done = f"{account} may offer services again. Those that it has stay suspended until you reinstate them."
    send(site, participant, "reinstate_provider", done, account=account)


@organization.command("suspend")
@reports_errors
def suspend(
    service_id: int, site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization"
) -> None:
    """Give a service no more tasks."""
    send(
        site,
        participant,
        "suspend_service",
        f"Service {service_id} is suspended. It gets no tasks until you reinstate it.",
        service_id=service_id,
    )


@organization.command("reinstate")
@reports_errors
def reinstate(
    service_id: int, site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization"
) -> None:
    """Let a suspended service return: paused, until its provider activates it."""
    send(
        site,
        participant,
        "reinstate_service",
        f"Service {service_id} is reinstated. It stays paused until its provider resumes it.",
        service_id=service_id,
    )


@organization.command("deposit")
@reports_errors
def deposit(
    amount: AmountArgument, site: SiteOption = DEFAULT_SITE, participant: ParticipantOption = "organization"
) -> None:
    """Pay into the treasury from the account that signs."""
    told = f"{participant} paid {amount} IEC into the treasury."
    send(site, participant, "deposit", told, amount_iec=amount)


@organization.command("rescue")
@reports_errors
def rescue(
    token: Annotated[str, typer.Argument(help="Address of the ERC-20 contract that the tokens are of.")],
    to: Annotated[str, typer.Option(help="A participant's name or an address.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Send on tokens that somebody sent to the contracts by mistake. Escrow and treasury stay as they are."""
    send(site, participant, "rescue_tokens", f"Tokens of {token} were sent on to {to}.", token=token, to=to)


@organization.command("withdraw")
@reports_errors
def withdraw(
    amount: AmountArgument,
    to: Annotated[str, typer.Option(help="A participant's name or an address.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Pay out of the treasury."""
    send(
        site,
        participant,
        "withdraw",
        f"The treasury paid {amount} IEC to {to}.",
        to=to,
        amount_iec=amount,
    )


@organization.command("judge-key")
@reports_errors
def judge_key(
    judge: Annotated[str, typer.Argument(help="The oracle's name, or the address of its key until now.")],
    key: Annotated[str, typer.Argument(help="Address of the key with which it votes from now on.")],
    signature: SeatSignature,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let a judge of the committee vote with another key, for every kind of work."""
    done = (
        f"{judge} votes with the key {key} on proofs that are submitted from now on. What it signed with the "
        "old key counts no more."
    )
    send(site, participant, "change_judge_key", done, judge=judge, key=key, signature=signature)


@organization.command("seat")
@reports_errors
def seat(
    key: Annotated[str, typer.Argument(help="Address of the key with which the judge votes.")],
    signature: SeatSignature,
    owner: Annotated[
        str | None,
        typer.Option(help="For whom it works, whose tasks it does not judge: a participant or an address."),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Give a judge the next seat of the committee. It judges nothing until `quorum` names it."""
    done = f"The judge with the key {key} has a seat. `rodeo organization quorum` lets it judge."
    send(site, participant, "seat_judge", done, key=key, owner=owner, signature=signature)


@organization.command("sign-seat")
@reports_errors
def sign_seat(
    keystore: Annotated[str, typer.Argument(help="The judge's keystore in the site's folder of keys.")],
    owner: Annotated[
        str | None,
        typer.Option(help="For whom it works: a participant or an address. By default for nobody."),
    ] = None,
    committee: Annotated[
        str, typer.Option(help=f"The committee's contract: {', '.join(_COMMITTEES)}.")
    ] = _COMMITTEES[0],
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Sign with a judge's key that it sits for an owner: the signature for `seat` and `judge-key`."""
    from rodeo import keystores  # take their time to import
    from rodeo.votes import possession

    with connected(site) as (loaded, bus):
        chain = queries.ask(bus, loaded.org, queries.CHAIN)
        people = queries.ask(bus, loaded.org, queries.PARTICIPANTS).participants
    key = keystores.open_key(loaded, keystore)
    address = next((one.address for one in people if one.name == owner), owner or key.address)
    contract = chain.contracts.model_dump(by_alias=True)[committee]
    say("0x" + b"".join(possession(key, address, chain.chain_id, contract)).hex())


@organization.command("unseat")
@reports_errors
def unseat(
    judge: JudgeArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let a judge of the committee judge no kind of work any more. As many votes are needed as before."""
    send(site, participant, "unseat_judge", f"{judge} judges nothing any more.", judge=judge)


@organization.command("deposit-stake")
@reports_errors
def deposit_stake(
    judge: StakedArgument,
    amount: AmountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Add to the stake of a judge: an oracle, or who decides about challenges. Without it its votes do not
    count. Anybody may pay."""
    done = f"{participant} deposited {amount} IEC for {judge}."
    send(site, participant, "deposit_stake", done, judge=judge, amount_iec=amount)


@organization.command("announce-withdrawal")
@reports_errors
def announce_withdrawal(
    judge: StakedArgument,
    amount: AmountArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Begin to take the stake of a judge back, as whom it works for. It does not count for votes any more."""
    done = f"{amount} IEC of {judge} leave. In 30 days `rodeo organization withdraw-stake` pays them."
    send(site, participant, "announce_withdrawal", done, judge=judge, amount_iec=amount)


@organization.command("withdraw-stake")
@reports_errors
def withdraw_stake(
    judge: StakedArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Pay the stake of a judge that was announced to whom it works for."""
    done = f"The stake of {judge} that was announced is paid."
    send(site, participant, "withdraw_stake", done, judge=judge)


@organization.command("quorum")
@reports_errors
def quorum(
    name: Annotated[str, typer.Argument(metavar="KIND", help="The kind of task.")],
    votes: Annotated[int, typer.Argument(help="How many judges have to agree: more than half of a panel.")],
    judges: Annotated[
        list[str] | None,
        typer.Option(
            "--judge",
            help="A judge of this kind, by name or key; repeat it. By default all that judge it now.",
        ),
    ] = None,
    panel: Annotated[
        int | None, typer.Option(help="How many may vote at once. By default as before.")
    ] = None,
    rotation_s: Annotated[
        int | None,
        typer.Option(
            "--rotation", help="Seconds after which one more may vote; 0: never. By default as before."
        ),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Set which judges of the committee judge a kind, and how many have to agree."""
    done = f"{name} is now judged by {votes} judges that agree."
    fields = {"kind": name, "votes": votes, "judges": judges, "panel": panel, "rotation_s": rotation_s}
    send(site, participant, "set_quorum", done, **fields)


@organization.command("devices")
@reports_errors
def devices(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the keys that sign evidence."""
    with connected(site) as (loaded, bus):
        reply = queries.ask(bus, loaded.org, queries.DEVICES)
    rows = []
    for one in reply.devices:
        gone = "" if one.revoked is None else f"revoked: {one.revoked_because}"
        cells = (one.role, one.name, one.owner_name or one.owner, one.address)
        rows.append(Row(cells, note=gone))
    print_listing(reply, as_json, ("role", "name", "owner", "address"), rows, folds=(2, 1))


@organization.command("roots")
@reports_errors
def roots(
    device: Annotated[str | None, typer.Option(help="Address of a key; all by default.")] = None,
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """List the daily roots of what devices signed, as recorded on chain."""
    with connected(site) as (loaded, bus):
        reply = queries.ask(bus, loaded.org, queries.ROOTS, device=device)
        known = queries.ask(bus, loaded.org, queries.DEVICES).devices
    if not (reply.roots or as_json):
        say("No daily root is on chain yet.")
        return
    names = {one.address: f"{one.role} {one.name}" for one in known}
    rows = [
        Row((moment(one.day * 86_400, loaded)[:10], names.get(one.device, one.device), one.root),
            note=one.uri)
        for one in reply.roots
    ]  # fmt: skip
    day = "day (UTC)" if loaded.clock.source == "wall" else "day of the simulated time"
    print_listing(reply, as_json, (day, "device", "root"), rows, folds=(0, 1, 2))


@organization.command("register-device")
@reports_errors
def register_device(
    address: Annotated[str, typer.Argument(help="Address of the key that signs evidence.")],
    role: Annotated[str, typer.Option(help="What the device is: robot, bin, meter or mocap.")],
    owner: Annotated[str, typer.Option(help="A participant's name or an address.")],
    name: Annotated[str, typer.Option(help="Its name on the site, for example panther1 or dock1.")],
    signature: Annotated[str, typer.Option(help="The key's own signature: `sign-device` makes it.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Let a key sign evidence. If another key has this role and name, revoke that key first. Registered again
    with the same role and name, the key has another owner."""
    send(
        site,
        participant,
        "register_device",
        f"From now on {address} signs as {role} {name} of {owner}.",
        device=address,
        role=role,
        owner=owner,
        name=name,
        signature=signature,
    )


@organization.command("sign-device")
@reports_errors
def sign_device(
    keystore: Annotated[str, typer.Argument(help="The device's keystore in the site's folder of keys.")],
    owner: Annotated[str, typer.Option(help="A participant's name or an address.")],
    nonce: Annotated[int, typer.Option(min=0, help="How often the key was registered before.")] = 0,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Sign with a device's key that it belongs to an owner, and print the signature for `register-device`."""
    from rodeo import keystores, possession  # take their time to import

    with connected(site) as (loaded, bus):
        chain = queries.ask(bus, loaded.org, queries.CHAIN)
        people = queries.ask(bus, loaded.org, queries.PARTICIPANTS).participants
    address = next((one.address for one in people if one.name == owner), owner)
    key = keystores.open_key(loaded, keystore)
    say(possession.sign(key, address, nonce, chain.chain_id, chain.contracts.device_registry))


@organization.command("revoke-device")
@reports_errors
def revoke_device(
    address: Annotated[str, typer.Argument(help="Address of the key that signs evidence.")],
    reason: Annotated[
        str,
        typer.Option(
            help="superseded: another key takes over; compromised: somebody else may have signed with it."
        ),
    ],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Reject everything that a key signs from now on. The reason decides about earlier signatures."""
    send(
        site,
        participant,
        "revoke_device",
        f"From now on the organization rejects what {address} signs.",
        device=address,
        reason=reason,
    )


register(
    organization,
    {
        "policy": policy,
        "kind": kind,
        "retire-rules": retire_rules,
        "terms": terms,
        "members-only": members_only,
        "budget": budget,
        "resume": resume,
        "admit": admit,
        "dismiss": dismiss,
        "vouch": vouch,
        "grant": grant,
        "revoke": revoke,
        "suspend-provider": suspend_provider,
        "reinstate-provider": reinstate_provider,
        "suspend": suspend,
        "reinstate": reinstate,
        "rescue": rescue,
        "register-device": register_device,
        "revoke-device": revoke_device,
        "judge-key": judge_key,
        "remove-judge": remove_judge,
        "seat": seat,
        "unseat": unseat,
        "quorum": quorum,
    },
)
budget_votes.register(organization)
