"""A task in words, for terminals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.bus.session import Bus
from rodeo.display.formatting import (
    passed_in_words,
    span,
    tries_in_words,
)
from rodeo.judging.verdicts import (
    NO_REPORT,
    WORDS,
    is_peoples_verdict,
    judge_of,
    standing_words,
    verdict_words,
    void_words,
)
from rodeo.person.photo_code import photo_code
from rodeo.site.config import Site
from rodeo_cli import formatting
from rodeo_cli.common import time_left
from rodeo_cli.formatting import iec, plain, worth
from rodeo_cli.layout import Row

if TYPE_CHECKING:
    from rodeo.display.story import Step

STATE_COLOURS = {
    "open": "yellow",
    "assigned": "cyan",
    "submitted": "blue",
    "ruled": "magenta",
    "settled": "green",
    "cancelled": "dim",
    "failed": "red",
}


def row(task: Task, site: Site) -> Row:
    cells = (
        str(task.id),
        task.kind,
        task.state,
        f"{task.attempts_counted}/{task.max_attempts}",
        party(task.creator_name, task.creator),
        party(task.executor_name, task.executor),
        iec(task.reward_iec),
        iec(task.paid_iec) if task.paid_iec else "",
    )
    return Row(cells, {2: STATE_COLOURS.get(task.state, "")}, _why(task, site))


def _named_provider(task: Task) -> list[tuple[str, str]]:
    if task.requested_provider is None:
        return []
    return [("named provider", party(task.requested_provider_name, task.requested_provider))]


def _why(task: Task, site: Site) -> str:
    """The ruling that stands on the last attempt, or why it failed."""
    if stands := standing(task, site):
        return stands
    if task.verdict in (None, "accepted"):
        return ""
    if task.verdict in ("expired", "abandoned"):
        return task.reason or "the executor submitted no proof in time"
    if task.verdict == "void":
        return void_words(task.fault, task.reason)
    return f"{WORDS.get(task.verdict, task.verdict)}: {task.reason or NO_REPORT}"


def facts(
    task: Task, site: Site, left: str | None = None, judged: str = "", story: Iterable[Step] = ()
) -> list[tuple[str, str]]:
    """All that is known of a task, in words and in the order in which it happens.

    `left` is how much time there is for what comes next, `judged` the verdict as a sentence, `story` that of
    its dispute.
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
        ("stands", standing(task, site)),
        ("accept or give back by", moment(task.grace_ends_s) if unaccepted else ""),
        ("due by", moment(due.get(state))),
        ("time left", left or ""),
        ("attempt", tries_in_words(task) if task.attempt else ""),
        ("attempts", "" if task.attempt else f"none yet, {task.max_attempts} at most"),
        ("verdict", judged),
        *steps(story, site),
        ("reward", f"{worth(task.reward_iec, site)} by {party(task.creator_name, task.creator)}"),
        ("executor", party(task.executor_name, task.executor)),
        ("not offered again to", passed_in_words(task)),
        ("service", "" if task.service_id is None else str(task.service_id)),
        *([] if task.requested_service_id is None else [("named service", str(task.requested_service_id))]),
        *_named_provider(task),
        ("price", worth(task.price_iec, site) if task.price_iec is not None else ""),
        ("paid", worth(task.paid_iec, site) if ended else ""),
        ("refunded", worth(task.refunded_iec, site) if ended else ""),
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


def steps(story: Iterable[Step], site: Site) -> list[tuple[str, str]]:
    return [("dispute", f"{formatting.moment(one.time_s, site)}: {one.text}") for one in story]


def story_of(site: Site, bus: Bus, task: Task) -> list[Step]:
    """The story of its dispute; nothing where its ruling could not be challenged."""
    if site.disputes is None:
        return []
    from rodeo.display.story import story  # takes its time to import

    events = queries.ask(bus, site.org, queries.EVENTS, task_id=task.id).events
    organization = queries.ask(bus, site.org, queries.ORGANIZATION)
    return story(events, organization, queries.ask(bus, site.org, queries.WALLETS).wallets)


def standing(task: Task, site: Site) -> str:
    """A ruling that is not done yet: nobody may learn of it too late to challenge or replace it."""
    if task.standing is None:
        return ""
    until = formatting.moment(task.standing.until, site)
    return standing_words(task, iec(task.standing.amount_iec), until)


def judged_by(site: Site, bus: Bus, task: Task) -> str:
    """The last verdict as a sentence: who gave it, and why; empty while there is none."""
    if not task.verdict:
        return ""
    transactions = queries.ask(bus, site.org, queries.TRANSACTIONS, task_id=task.id).transactions
    judge = judge_of(transactions)
    return verdict_words(task.verdict, task.reason, judge, is_peoples_verdict(task, judge), task.fault)


def facts_on(site: Site, bus: Bus, task: Task) -> list[tuple[str, str]]:
    """`facts`, with all that has to be asked for. An unchallenged ruling has no story."""
    story = story_of(site, bus, task)
    challenged = any(one.what == "challenged" for one in story)
    left, judged = left_of(site, bus, task), judged_by(site, bus, task)
    return facts(task, site, left, judged, story if challenged else ())


def left_of(site: Site, bus: Bus, task: Task) -> str | None:
    """Time left for the next step, if it has a deadline."""
    from rodeo.person.pace import running_out_s  # takes its time to import

    ends_s = running_out_s(task)
    return None if ends_s is None else time_left(site, bus, ends_s)


def party(name: str | None, address: str | None) -> str:
    return name or (f"{address[:8]}…" if address else "")
