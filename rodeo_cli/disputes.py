"""Commands about rulings that stand, and can be challenged."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer
from pydantic import TypeAdapter, ValidationError

from rodeo.bus import queries
from rodeo.bus.messages import JUDGES, Dispute, Fault, Ruling, SignedVote, Task
from rodeo.bus.session import Bus
from rodeo.errors import InvalidRequest, RemoteError, unreadable
from rodeo.judging.verdicts import NO_REPORT, standing_words
from rodeo.site.config import Site
from rodeo_cli import formatting
from rodeo_cli.common import (
    DEFAULT_SITE,
    JsonOption,
    SiteOption,
    connected,
    print_facts,
    reports_errors,
    say,
    send_command,
    write_file,
)
from rodeo_cli.formatting import iec
from rodeo_cli.task_words import steps, story_of

if TYPE_CHECKING:
    from rodeo.display.story import Step

disputes = typer.Typer(
    help="Challenge a ruling while it stands, and decide about a challenge.", no_args_is_help=True
)

_REFUSED = frozenset({"judge_is_party", "key_too_new", "not_a_judge", "not_in_panel", "voted_twice"})
"""The contract does not count the vote of the judge that the error names."""
_TOO_LOW = "stake_too_low"
"""Code of the error for a judge whose stake is too low; it names the judge's seat."""
_COMMITTEES = ("DisputeCommittee", "AppealCommittee")
"""The committees that decide about a challenge, of the oracles' ruling and of the decision about it."""
_VOTES = TypeAdapter(list[SignedVote])


@disputes.command("show")
@reports_errors
def show(task_id: int, site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """Show the ruling that stands, who challenged it, and what the judges look at."""
    with connected(site) as (loaded, bus):
        task = queries.ask(bus, loaded.org, queries.TASK, id=task_id)
        story = story_of(loaded, bus, task)
    if task.dispute is None and story:  # of an attempt before
        print_facts(story, as_json, steps(story, loaded))
        return
    dispute = _dispute(task)
    told = {**dispute.model_dump(mode="json"), "story": story}
    print_facts(told, as_json, () if as_json else facts(loaded, task, dispute, story))


@disputes.command("vote")
@reports_errors
def vote(
    task_id: int,
    ruling: Annotated[str, typer.Argument(help=f"{', '.join(get_args(Ruling))}.")],
    judge: Annotated[str, typer.Option("--as", help="Who votes.")],
    reason: Annotated[
        str | None, typer.Option(help="Why. Only votes with the same reason count together.")
    ] = None,
    fault: Annotated[
        str, typer.Option(help=f"Who is at fault for a void attempt: {', '.join(get_args(Fault))}.")
    ] = "nobody",
    amount: Annotated[
        str | None,
        typer.Option(help="What an accepted proof is paid, in IEC. By default the agreed price."),
    ] = None,
    votes: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            help="File with the judges' votes. By default dispute-TASK.json in this folder, and "
            "appeal-TASK.json when their decision is challenged.",
        ),
    ] = None,
    site: SiteOption = DEFAULT_SITE,
) -> None:
    """Vote on a challenged ruling, into a file with the other judges' votes. Whoever completes them posts
    them."""
    with connected(site) as (loaded, bus):
        if loaded.disputes is None:
            raise InvalidRequest("rulings cannot be challenged on this site: it has no [disputes]")
        instances = loaded.disputes.instances
        said_by = _dispute(queries.ask(bus, loaded.org, queries.TASK, id=task_id)).instance
        if said_by >= len(instances):
            raise InvalidRequest("the site file names nobody who decides about this", task_id=task_id)
        needed, committee = instances[said_by].votes, _COMMITTEES[said_by]
        file = votes or Path(f"{'appeal' if said_by else 'dispute'}-{task_id}.json")
        request: dict[str, Any] = {"task_id": task_id, "ruling": ruling, "fault": fault}
        request |= {} if amount is None else {"amount_iec": amount}
        request |= {} if reason is None else {"reason": reason}
        own = SignedVote.model_validate(send_command(loaded, bus, judge, "sign_vote", **request))
        held = _by_signer(loaded, bus, committee, [*_read(file), own])
        write_file(file, _VOTES.dump_json(list(held.values()), indent=2).decode() + "\n")
        same = {key: one for key, one in held.items() if one.vote == own.vote}
        counted = _counted(loaded, bus, judge, same, own, needed, file)
    if counted:
        last = said_by + 1 == len(instances)
        said = f"That was enough: the ruling on task {task_id} is {ruling}"
        said += "." if last else ", unless it is challenged again."
    else:
        missing = needed - len(same)
        are = "equal vote is" if missing == 1 else "equal votes are"
        said = f"{missing} {are} missing in {file}."
    say(f"{judge} voted: {ruling}. {said}")


def _counted(
    site: Site,
    bus: Bus,
    judge: str,
    same: dict[str, SignedVote],
    own: SignedVote,
    needed: int,
    file: Path,
) -> bool:
    """Post equal votes as soon as they are enough; those that the contract does not count leave `same`.

    Raises what refuses the judge's `own` vote, or all of them.
    """
    while len(same) >= needed:
        refused = _post(site, bus, judge, list(same.values()))
        if refused is None:
            return True
        key = next((str(one) for one in refused.details.values() if one in same), "")
        if refused.code == _TOO_LOW and len(same) > needed:
            key = _unstaked(site, bus, judge, same, refused)
        elif refused.code not in _REFUSED:
            raise refused
        if same.get(key) in (None, own):
            raise refused
        say(f"The vote of {key} in {file} does not count: {refused.code}.")
        del same[key]
    return False


def _by_signer(site: Site, bus: Bus, committee: str, given: list[SignedVote]) -> dict[str, SignedVote]:
    """The last vote for this committee of each key on the submission that the newest is about. What nobody
    signed is left out, and so is what is about another submission."""
    from rodeo.judging.votes import signer  # takes its time to import

    chain = queries.ask(bus, site.org, queries.CHAIN)
    address = str((chain.contracts.model_extra or {})[committee])
    newest = given[-1].vote
    held: dict[str, SignedVote] = {}
    for one in given:
        vote = one.vote
        key = signer(vote, one.signature, chain.chain_id, address, site.economy.currency)
        if key is not None and (vote.task_id, vote.attempt) == (newest.task_id, newest.attempt):
            held.pop(key, None)
            held[key] = one
    return held


def _unstaked(site: Site, bus: Bus, judge: str, same: dict[str, SignedVote], refused: RemoteError) -> str:
    """Judges whose stake is too low: without their votes the contract refuses another one, or none."""
    for key in same:
        rest = [vote for other, vote in same.items() if other != key]
        error = _post(site, bus, judge, rest, dry_run=True)
        if error is None or error.details.get("seat") != refused.details.get("seat"):
            return key
    return ""


def _post(
    site: Site, bus: Bus, judge: str, same: list[SignedVote], dry_run: bool = False
) -> RemoteError | None:
    """Send equal votes; the error with which the contract refused them, None if they count."""
    vote, report_uri = same[-1].vote.model_dump(mode="json"), same[-1].report_uri
    signatures = [one.signature for one in same]
    request = {"vote": vote, "report_uri": report_uri, "signatures": signatures, "dry_run": dry_run}
    try:
        send_command(site, bus, judge, "post_votes", **request)
    except RemoteError as error:
        return error
    return None


def facts(site: Site, task: Task, dispute: Dispute, story: Sequence[Step] = ()) -> list[tuple[str, str]]:
    until = formatting.moment(dispute.until, site)
    stands = "" if task.standing is None else standing_words(task, iec(task.standing.amount_iec), until)
    told = [
        ("task", f"{task.id}, {task.kind}, attempt {task.attempt}"),
        ("by", JUDGES[dispute.instance]),
        ("stands", stands),
        ("proof", task.proof_uri or ""),
        ("report", task.report_uri or NO_REPORT),
        # The executor wrote the location, and a judge may paste the line into a shell.
        ("replay", f"rodeo verify {shlex.quote((task.proof_uri or '').removeprefix('file://'))}"),
    ]
    if dispute.challenger is not None:
        stake = "" if dispute.stake_iec is None else f" with {iec(dispute.stake_iec)} at stake"
        by = next((one.who[0] for one in reversed(story) if one.what == "challenged"), dispute.challenger)
        told += [
            ("challenged", f"by {by}{stake}"),
            ("because", dispute.because or ""),
        ]
    elif task.standing is not None and dispute.challenge_iec is not None:
        told.append(("a challenge takes", f"{iec(dispute.challenge_iec)}, lost if the ruling is right"))
    return [*told, ("stakes", "settled" if dispute.settled else ""), *steps(story, site)]


def _dispute(task: Task) -> Dispute:
    """Raises InvalidRequest."""
    if task.dispute is None:
        raise InvalidRequest("no ruling on this task can be challenged", task_id=task.id, state=task.state)
    return task.dispute


def _read(file: Path) -> list[SignedVote]:
    """The votes so far. Raises InvalidRequest."""
    try:
        return _VOTES.validate_json(file.read_bytes())
    except FileNotFoundError:
        return []
    except (OSError, ValidationError) as error:
        raise InvalidRequest("not a file of votes", file=str(file), problem=unreadable(error)) from error
