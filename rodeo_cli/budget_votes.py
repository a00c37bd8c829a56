"""Money that members split by quadratic votes: propose a budget vote, see it, vote in it, pay the shares."""

from __future__ import annotations

from typing import Annotated

import typer

from rodeo.bus import queries
from rodeo.display.formatting import party, split_in_words
from rodeo.errors import InvalidRequest, RemoteError
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
from rodeo_cli.formatting import iec, moment
from rodeo_cli.layout import Row

NumberArgument = Annotated[int, typer.Argument(min=0, help="Its number: `rodeo organization budget-votes`.")]


def budget_votes(
    site: SiteOption = DEFAULT_SITE,
    participant: Annotated[
        str | None, typer.Option("--as", help="Say what this member has given, and what it can give.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the budget votes with what each recipient gets, the newest first."""
    with connected(site) as (loaded, bus):
        reply = queries.ask(bus, loaded.org, queries.BUDGET_VOTES, limit=100)
    rows = [row for one in reply.budget_votes for row in _rows(one, loaded, participant)]
    columns = ("no.", "state", "amount", "when", "recipient", "votes", "share", "paid")
    print_listing(reply, as_json, columns, rows, folds=(4, 3))


def _rows(one: queries.BudgetVote, site: Site, member: str | None) -> list[Row]:
    """A row for each recipient, and under the last one what the member has given."""
    until = "vote until" if one.state == "open" else "ended"
    about = (str(one.number), one.state, iec(one.amount_iec), f"{until} {moment(one.end_s, site)}")
    rows = []
    for place, to in enumerate(one.recipients):
        cells = (
            *(about if not place else [""] * len(about)),
            to.name or to.address,
            str(to.votes),
            iec(to.share_iec),
            "" if to.paid_iec is None else iec(to.paid_iec),
        )
        is_last = place == len(one.recipients) - 1
        rows.append(Row(cells, note=_given(one, member) if is_last and member is not None else ""))
    return rows


def _given(one: queries.BudgetVote, member: str) -> str:
    ballot = next((ballot for ballot in one.ballots if member in (ballot.voter_name, ballot.voter)), None)
    if ballot is None:
        return f"{member} has given none of {one.credits} credits"
    votes = split_in_words(one, ballot)
    return f"{member} has given {ballot.credits_used} of {one.credits} credits: {votes}"


def pay_budget(
    number: NumberArgument,
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Pay everybody who has not been paid the share of a budget vote that ended. Anybody may."""
    failed: RemoteError | None = None
    with connected(site) as (loaded, bus):
        found = queries.ask(bus, loaded.org, queries.BUDGET_VOTES, number=number).budget_votes
        if not found:
            raise InvalidRequest("no such budget vote", budget_vote=number)
        if found[0].state == "open":
            raise InvalidRequest(
                "voting is still open: shares are paid after it ends",
                budget_vote=number,
                end_s=found[0].end_s,
            )
        owed = [to for to in found[0].recipients if to.share_iec and to.paid_iec is None]
        if not owed:
            say(f"There is nothing to pay of budget vote {number}.")
        for to in owed:
            request = {"budget_vote": number, "recipient": to.address}
            try:
                send_command(loaded, bus, participant, "pay_budget_share", **request)
            except RemoteError as error:
                # The others do not wait for one that cannot be paid.
                failed = failed or error
            else:
                say(f"{party(to.name, to.address)} was paid {iec(to.share_iec)}.")
        if failed is not None:
            raise failed


def register(organization: typer.Typer) -> None:
    """Add these commands to `organization`."""
    for command in (budget_votes, pay_budget):
        organization.command(command.__name__.replace("_", "-"))(reports_errors(command))
