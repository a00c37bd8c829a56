"""Commands about the organization itself: its rules, members, devices and treasury."""

from __future__ import annotations

from collections import Counter
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

import typer

from rodeo.bus import queries
from rodeo.bus.messages import LIVE_STATES
from rodeo.display.formatting import count, quorum_in_words, span, voids_in_words, windows_in_words
from rodeo.errors import InvalidRequest
from rodeo.kinds import KindError, installed, kinds_of, load
from rodeo.site.config import Site
from rodeo_cli import budget_votes, forms
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
from rodeo_cli.proposals import proposals, propose


def _with_installed_rules(site: Path, request: dict[str, Any]) -> dict[str, Any]:
    """A kind is judged by the rules that are installed here, unless others are named. Raises
    InvalidRequest where nobody is named who judges it."""
    name, judge = request["kind"], request["judge"]
    if request["allowed"] and judge is None:
        raise InvalidRequest(
            f"choose who judges {name}: --judge auditor for people, or --judge oracle where it has checks",
            kind=name,
        )
    rules = request["rules_sha256"]
    if rules is None and judge == "oracle":
        rules = _installed_rules(Site.load(site), name)
    return request | {"rules_sha256": rules}


_COMPLETED = {"installed_rules": _with_installed_rules}
organization = typer.Typer(
    cls=forms.group("organization", _COMPLETED),
    help="Show and change the organization's rules, members, devices and treasury.",
    no_args_is_help=True,
)

_COMMITTEES = ("OracleCommittee", "DisputeCommittee", "AppealCommittee")


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
        *((kind.kind, kind_in_words(kind)) for kind in state.kinds),
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
    from rodeo.chain.node.errors import NotDeployed
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
    """Empty if new tasks were never paused."""
    return f"none before {moment(state.paused_until_s, site)}" if state.paused_until_s else ""


def _stake_in_words(judge: queries.Judge, needed: Decimal, site: Site) -> str:
    """Empty where it neither has nor needs one."""
    told = f", stake {iec(judge.stake_iec)}" if judge.stake_iec or needed else ""
    if judge.stake_iec < needed:
        told += f" of {iec(needed)}, so that its votes do not count"
    if judge.leaving_iec:
        told += f", {iec(judge.leaving_iec)} leave after {moment(judge.leaving_until_s, site)}"
    return told


def kind_in_words(kind: queries.KindRules) -> str:
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


@organization.command("rules")
@reports_errors
def rules(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the rules by which tasks are judged, and how many tasks that have not ended need each of them.

    Update an oracle's checks once no open task needs the rules that it has.
    """
    with connected(site) as (loaded, bus):
        kinds = queries.ask(bus, loaded.org, queries.ORGANIZATION).kinds
        live: dict[str, Any] = {"state": ",".join(LIVE_STATES), "order": "oldest", "limit": queries.MAX_PAGE}
        tasks = queries.entries(
            lambda offset: queries.ask(bus, loaded.org, queries.TASKS, offset=offset, **live).tasks
        )
    needed = Counter((task.kind, task.rules_sha256) for task in tasks if task.rules_sha256)
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
    from rodeo.judging.votes import possession
    from rodeo.signing import keystores  # take their time to import

    with connected(site) as (loaded, bus):
        chain = queries.ask(bus, loaded.org, queries.CHAIN)
        people = queries.ask(bus, loaded.org, queries.PARTICIPANTS).participants
    key = keystores.open_key(loaded, keystore)
    address = next((one.address for one in people if one.name == owner), owner or key.address)
    contract = chain.contracts.model_dump(by_alias=True)[committee]
    say("0x" + b"".join(possession(key, address, chain.chain_id, contract)).hex())


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


@organization.command("sign-device")
@reports_errors
def sign_device(
    keystore: Annotated[str, typer.Argument(help="The device's keystore in the site's folder of keys.")],
    owner: Annotated[str, typer.Option(help="A participant's name or an address.")],
    nonce: Annotated[int, typer.Option(min=0, help="How often the key was registered before.")] = 0,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Sign with a device's key that it belongs to an owner, and print the signature for `register-device`."""
    from rodeo.signing import keystores, possession  # take their time to import

    with connected(site) as (loaded, bus):
        chain = queries.ask(bus, loaded.org, queries.CHAIN)
        people = queries.ask(bus, loaded.org, queries.PARTICIPANTS).participants
    address = next((one.address for one in people if one.name == owner), owner)
    key = keystores.open_key(loaded, keystore)
    say(possession.sign(key, address, nonce, chain.chain_id, chain.contracts.device_registry))


organization.add_typer(
    propose, name="propose", cls=forms.group("organization propose", _COMPLETED, proposes=True)
)
organization.command("proposals")(proposals)
budget_votes.register(organization)
