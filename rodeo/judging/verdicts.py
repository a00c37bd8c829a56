"""The judge of a proof, in words: the oracle, which measures, or an auditor, who is a person."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import get_args

from rodeo.bus.messages import Fault, Ruling, Task
from rodeo.bus.queries import Transaction

REPORTED = "Reported"
"""In the transaction of each ruling, from the judge that made it."""
_PASSED_ON = "PassedOn"
_VOTED = frozenset({"VotesCounted", "InstanceRuled"})
COMMITTEE = "committee"
"""The judge where several oracles agreed: whoever sent their votes judged nothing."""

WORDS = {"given_up": "given up"}
"""Rulings whose name is not the word for people."""
MEANINGS: dict[str, str] = {
    "accepted": "accepted: the work was done, and is paid",
    "rejected": "rejected: the executor claims what is not so, and pays the penalty",
    "given_up": "given up: the executor could not do it, and is not paid; unless it is proven, it is fined",
    "impossible": "impossible: nobody could do it, and its executor is paid a tenth of the price",
    "void": "void: nobody's doing, or not to be told; the task ends, and nobody is paid or pays",
}
"""What a ruling means, in the words of the contracts' table (docs/reference/contracts.md)."""
FAULTS: dict[Fault, str] = {
    "nobody": "nobody's doing",
    "creator": "the creator's doing",
    "creators_witness": "the doing of a device that the creator owns",
    "other_witness": "the doing of a device that somebody else owns",
    "oracle": "the judge's doing",
}
"""The party at fault for a void attempt, in words."""
OF_A_CREATOR: tuple[Fault, ...] = ("creator", "creators_witness")
"""Voids that cost a creator its reputation: nobody can tell a creator that unplugs its own witness, and has
the work free, from an accomplice of the executor at the same plug. Of the site every void counts."""
LAST_RULINGS, MOST_VOID = 100, 0.05
"""More than this share of the last rulings is shown in red."""
NO_REPORT = "no report"
_NOT_RULED = "nobody ruled on it in time, or who did rules no more"


def is_peoples_verdict(task: Task, judge: str | None = None) -> bool:
    """Whether the task's verdict is an auditor's: auditors judge its kind, or the oracle passed it on. A void
    attempt may have no ruling, so it counts only if its `judge` is known (`judge_of`)."""
    if task.verdict not in get_args(Ruling) or (task.verdict == "void" and judge is None):
        return False
    return task.passed_on or task.judge == "auditor"


def judge_of(transactions: Iterable[Transaction], tx_hash: str | None = None) -> str | None:
    """The owner of the key that posted the newest ruling, or the one in `tx_hash`: name or address, or
    COMMITTEE; None if unknown. Passing a case on is no ruling.

    `transactions` are a task's as the index tells them, the newest first.
    """
    for one in transactions:
        if REPORTED in one.events and _PASSED_ON not in one.events and tx_hash in (None, one.tx_hash):
            return COMMITTEE if _VOTED.intersection(one.events) else one.sender_name or one.sender
    return None


def judge_words(judge: str | None, by_people: bool) -> str:
    """`the auditor organization`, or `the oracle`, under its name where it has another."""
    if by_people:
        return f"the auditor {judge}" if judge else "an auditor"
    return "the oracle" if judge in (None, "oracle") else f"the oracle {judge}"


def counted_voids(rulings: int, voids: Mapping[str, int], *, of_a_creator: bool) -> dict[Fault, int]:
    """The party at fault -> how many of the last `rulings` are void and count against a creator, or
    against the site; nothing unless they are too many."""
    counted = {fault: voids[fault] for fault in (OF_A_CREATOR if of_a_creator else FAULTS) if fault in voids}
    return counted if sum(counted.values()) > MOST_VOID * rulings else {}


def void_words(fault: Fault | None, reason: str | None) -> str:
    """`void, nobody's doing: the picture is too dark`"""
    why = reason or (_NOT_RULED if fault == "oracle" else NO_REPORT)
    return f"void, {FAULTS[fault or 'nobody']}: {why}"


def verdict_words(
    verdict: str, reason: str | None, judge: str | None, by_people: bool, fault: Fault | None = None
) -> str:
    """A verdict as a sentence: who gave it, and why. The name of the check that decided is in words."""
    name, colon, rest = (reason or "").partition(":")
    reason = f"{name.replace('_', ' ')}{colon}{rest}" if name.isidentifier() else reason
    if not verdict or verdict in ("expired", "abandoned"):
        return reason or ""
    who, word = judge_words(judge, by_people), WORDS.get(verdict, verdict)
    if verdict == "void":
        if not by_people:
            return void_words(fault, reason)
        word = f"void, {FAULTS[fault or 'nobody']},"
    if by_people:
        return f"{word} by {who} (a person): {f'“{reason}”' if reason else NO_REPORT}"
    if verdict == "accepted" and reason:
        return f"accepted by {who}: all its checks passed"
    return f"{word} by {who}: {reason or NO_REPORT}"


def standing_words(task: Task, paid: str, until: str) -> str:
    """The ruling that stands on a task that is `ruled`, and what can still become of it.

    `paid` is what it pays, `until` its end, as the reader writes amounts and times.
    """
    said, dispute = task.standing, task.dispute
    if said is None:
        return ""
    if task.passed_on and said.ruling == "void":
        return f"passed on to the auditors: {task.reason or NO_REPORT}; void unless one rules by {until}"
    if said.ruling == "void":
        word = void_words(said.fault, task.reason)
    else:
        word = f"{WORDS.get(said.ruling, said.ruling)}{f', {paid}' * (said.ruling == 'accepted')}"
        word += f": {task.reason or NO_REPORT}" if task.reason != said.ruling else ""
    if dispute is None or dispute.until != said.until:
        return f"{word}; it stands unless it is replaced by {until}"
    if dispute.challenger is None:
        return f"{word}; it can be challenged until {until}"
    return f"{word}; challenged: {dispute.because}; it stands unless the judges decide by {until}"
