"""Who judged a proof, in words: the oracle, which measures, or an auditor, who is a person."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from rodeo.kinds import Kinds
from rodeo.queries import Transaction

POSTED = "VerdictPosted"
VOTED = "VotesCounted"
COMMITTEE = "committee"
"""The judge where several oracles agreed: whoever sent their votes judged nothing."""


def is_peoples_verdict(
    kinds: Kinds,
    kind: str,
    verdict: str | None,
    audit_deadline: float | None = None,
    audited: Collection[str] = (),
) -> bool:
    """Whether a verdict on work of this kind is an auditor's: on people's work, on kinds that the
    organization has auditors judge (`audited`), and on what the oracle had left undecided."""
    if verdict not in ("accepted", "rejected", "impossible"):
        return False
    return kinds.by_people(kind) or kind in audited or audit_deadline is not None


def judge_of(transactions: Iterable[Transaction], tx_hash: str | None = None) -> str | None:
    """Whose key posted the newest verdict, or the one in `tx_hash`: name or address, or COMMITTEE; None if
    unknown.

    `transactions` are a task's as the index tells them, the newest first.
    """
    for one in transactions:
        if POSTED in one.events and tx_hash in (None, one.tx_hash):
            return COMMITTEE if VOTED in one.events else one.sender_name or one.sender
    return None


def judge_words(judge: str | None, by_people: bool) -> str:
    """`the auditor organization`, or `the oracle`, under its name where it has another."""
    if by_people:
        return f"the auditor {judge}" if judge else "an auditor"
    return "the oracle" if judge in (None, "oracle") else f"the oracle {judge}"


def verdict_words(verdict: str, reason: str | None, judge: str | None, by_people: bool) -> str:
    """A verdict as a sentence: who gave it, and why."""
    who = judge_words(judge, by_people)
    if not verdict:
        return reason or ""
    if verdict in ("expired", "abandoned"):
        return reason or "nobody judged it in time"
    if by_people:
        return f"{verdict} by {who} (a person): “{reason or ''}”"
    if verdict == "accepted":
        return f"accepted by {who}: all its checks passed"
    return f"{verdict} by {who}: {reason or 'no reason given'}"
