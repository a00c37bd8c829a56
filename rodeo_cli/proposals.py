"""Decisions after a delay: propose what the organization should do, vote and queue where members decide, and
execute it."""

from __future__ import annotations

from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any

import typer

from rodeo.bus import queries
from rodeo.bus.session import Bus
from rodeo.display.formatting import calls_in_words, span
from rodeo.site.config import Site
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    ParticipantOption,
    SiteOption,
    connected,
    print_listing,
    reports_errors,
    say,
    send_command,
)
from rodeo_cli.formatting import moment
from rodeo_cli.layout import Row

propose = typer.Typer(
    help="Propose what the organization should do. Options of `propose` come first.",
    no_args_is_help=True,
)


_WHY: ContextVar[str | None] = ContextVar("why", default=None)
"""Options of `propose`, given before the command that it proposes."""


def send(site: Path, participant: str, command: str, done: str, **fields: Any) -> None:
    """Do it, and say the sentence `done` when it is; below `propose`, propose it. Fields that are None are
    left out."""
    request = {name: value for name, value in fields.items() if value is not None}
    why = _WHY.get()
    if why is not None:
        request = {"command": command, "request": request, "description": why}
        command = "propose"
    with connected(site) as (loaded, bus):
        reply = send_command(loaded, bus, participant, command, **request)
        if why is not None:
            state = queries.ask(bus, loaded.org, queries.ORGANIZATION)
            next_ = (
                "the members can vote on it"
                if state.decided_by == "vote"
                else f"anybody can execute it in {span(state.delay_s)}"
            )
            done = f"Proposal {reply['proposal']}: {next_}."
            done += "".join(_undone(bus, loaded, int(reply["proposal"]), state))
    say(done)


_OVER = ("canceled", "defeated", "expired", "executed")


def _undone(bus: Bus, site: Site, number: int, state: queries.Organization) -> Iterator[str]:
    """What to say of proposals that are not over and set the judges of a kind, as this new one does. Each has
    all judges, by those that were on chain when it was proposed, so that the last one undoes the others."""
    listed = queries.ask(bus, site.org, queries.PROPOSALS, limit=100).proposals
    judged = {one for proposal in listed if proposal.number == number for one in _judged(proposal)}
    for one in listed:
        if one.number == number or one.state in _OVER or not (both := judged & _judged(one)):
            continue
        kinds, decide = (
            ", ".join(sorted(kind for _, kind in both)),
            "`rodeo organization cancel` withdraws one",
        )
        if state.decided_by == "vote":
            decide = "vote for one"
        yield (
            f" Warning: proposal {one.number} ({one.state}) sets the judges of {kinds}, too. The one that is "
            f"executed last undoes the other: {decide}."
        )


def _judged(proposal: queries.Proposal) -> set[tuple[str, str]]:
    """Committee and kind whose judges it sets."""
    return {
        (call.contract, str(call.args["kind"])) for call in proposal.calls if call.function == "setQuorum"
    }


@propose.callback()
def _why(
    context: typer.Context,
    text: Annotated[str, typer.Option("--why", help="What everybody reads. They see the calls, too.")],
) -> None:
    """Propose one of these commands. `--as` names who proposes it: a member, or the administrator."""
    told = _WHY.set(text)
    context.call_on_close(lambda: _WHY.reset(told))


@propose.command("price")
@reports_errors
def price(
    service_id: int,
    price_iec: Annotated[str, typer.Argument(metavar="PRICE", help="In IEC.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
    paused: Annotated[
        bool, typer.Option("--paused", help="The service takes no tasks then. Both are set together.")
    ] = False,
) -> None:
    """Set the price of a service that the organization offers."""
    fields = {"service_id": service_id, "price_iec": price_iec, "state": "paused" if paused else "active"}
    send(site, participant, "update_service", "", **fields)


@reports_errors
def proposals(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List what was proposed and what became of it, the newest first."""
    with connected(site) as (loaded, bus):
        reply = queries.ask(bus, loaded.org, queries.PROPOSALS, limit=100)
    rows = [
        Row(
            (
                str(one.number),
                one.state,
                ""
                if one.vote_end_s is None
                else " / ".join(str(one.votes[support]) for support in ("for", "against", "abstain")),
                when(one, loaded),
                one.description,
            ),
            note=calls_in_words(one.calls),
        )
        for one in reply.proposals
    ]
    columns = ("no.", "state", "for / against / abstain", "when", "why")
    print_listing(reply, as_json, columns, rows, folds=(4, 3))


def when(one: queries.Proposal, site: Site) -> str:
    """Until when it stays as it is."""
    if one.state == "active" and one.vote_end_s is not None:
        return f"vote until {moment(one.vote_end_s, site)}"
    if one.state in ("queued", "waiting", "ready") and one.ready_s is not None:
        return f"not before {moment(one.ready_s, site)}"
    return ""
