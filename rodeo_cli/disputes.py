"""Commands about verdicts that can be challenged."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import TypeAdapter, ValidationError

from rodeo import queries
from rodeo.config import Site
from rodeo.errors import InvalidRequest
from rodeo.files import replace_file
from rodeo.messages import Dispute, SignedVote, Task
from rodeo_cli import formatting
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    print_facts,
    reports_errors,
    say,
)
from rodeo_cli.formatting import iec
from rodeo_cli.tasks import ParticipantOption, send_command

disputes = typer.Typer(
    help="Challenge a verdict before it settles, and decide about a challenge.", no_args_is_help=True
)

_INSTANCES = ("the oracles", "the judges of challenges")
_VOTES = TypeAdapter(list[SignedVote])


@disputes.command("show")
@reports_errors
def show(task_id: int, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show the verdict that stands, who challenged it, and what the judges look at."""
    with connected(site) as (loaded, bus):
        task = queries.ask(bus, loaded.org, queries.TASK, id=task_id)
    dispute = _dispute(task)
    print_facts(dispute, as_json, () if as_json else _told(loaded, task, dispute))


@disputes.command("challenge")
@reports_errors
def challenge(
    task_id: int,
    reason: Annotated[str, typer.Option(help="Why the verdict is wrong.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ParticipantOption = "organization",
) -> None:
    """Have the judges of challenges decide. This takes a stake, which is lost if the verdict is right."""
    with connected(site) as (loaded, bus):
        send_command(loaded, bus, participant, "challenge_verdict", task_id=task_id, reason=reason)
    say(f"{participant} challenged the verdict on task {task_id}.")


@disputes.command("vote")
@reports_errors
def vote(
    task_id: int,
    outcome: Annotated[str, typer.Argument(help="accepted, rejected or impossible.")],
    judge: Annotated[str, typer.Option("--as", help="Who votes.")],
    reason: Annotated[
        str | None, typer.Option(help="Why. Only votes with the same reason count together.")
    ] = None,
    amount: Annotated[
        str | None,
        typer.Option(help="What an accepted proof is paid, in IEC. By default the agreed price."),
    ] = None,
    votes: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, help="File with the judges' votes. By default dispute-TASK.json in this folder."
        ),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Vote on a challenged verdict, into a file with the other judges' votes. Whoever completes them posts
    them."""
    file = votes or Path(f"dispute-{task_id}.json")
    with connected(site) as (loaded, bus):
        if loaded.disputes is None:
            raise InvalidRequest("verdicts cannot be challenged on this site: it has no [disputes]")
        request: dict[str, Any] = {"task_id": task_id, "outcome": outcome}
        request |= {} if amount is None else {"amount_iec": amount}
        request |= {} if reason is None else {"reason": reason}
        own = SignedVote.model_validate(send_command(loaded, bus, judge, "sign_vote", **request))
        others = [one for one in _read(file) if one.signature != own.signature]
        replace_file(file, _VOTES.dump_json([*others, own], indent=2).decode() + "\n")
        same = [one for one in (*others, own) if one.vote == own.vote]
        missing = loaded.disputes.votes - len(same)
        if missing > 0:
            say(f"{judge} voted: {outcome}. {missing} equal votes are missing in {file}.")
            return
        send_command(
            loaded,
            bus,
            judge,
            "post_votes",
            vote=own.vote.model_dump(mode="json"),
            report_uri=own.report_uri,
            signatures=[one.signature for one in same],
        )
    say(f"{judge} voted: {outcome}. That was enough: the verdict on task {task_id} is {outcome}.")


def _told(site: Site, task: Task, dispute: Dispute) -> list[tuple[str, str]]:
    said = dispute.vote
    paid = f", {iec(said.amount_iec)}" if said.outcome == "accepted" else ""
    told = [
        ("task", f"{task.id}, {task.kind}, attempt {task.attempt}"),
        ("verdict", f"{said.outcome}{paid}, by {_INSTANCES[dispute.instance]}"),
        ("reason", said.reason),
        ("proof", task.proof_uri or ""),
        ("report", dispute.report_uri),
        ("replay", f"rodeo verify {(task.proof_uri or '').removeprefix('file://')}"),
    ]
    if dispute.challenger is None:
        return [*told, ("challenge", f"until {formatting.moment(dispute.until, site)}")]
    stake = "" if dispute.stake_iec is None else f" with {iec(dispute.stake_iec)} at stake"
    return [
        *told,
        ("challenged", f"by {dispute.challenger}{stake}"),
        ("because", dispute.because or ""),
        ("decision", f"until {formatting.moment(dispute.until, site)}, or the verdict stands"),
    ]


def _dispute(task: Task) -> Dispute:
    """Raises InvalidRequest."""
    if task.dispute is None:
        raise InvalidRequest(
            "no verdict on this task waits to be challenged", task_id=task.id, state=task.state
        )
    return task.dispute


def _read(file: Path) -> list[SignedVote]:
    """The votes so far. Raises InvalidRequest."""
    if not file.exists():
        return []
    try:
        return _VOTES.validate_json(file.read_bytes())
    except ValidationError as error:
        raise InvalidRequest("not a file of votes", file=str(file), problem=str(error)) from error
