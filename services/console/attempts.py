"""The attempts at a task one by one, from its contract events; the index keeps the last one only."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from rodeo.bus.messages import DaoEvent, Fault
from rodeo.display.story import happened

_ENDS = ("TaskSettled", "TaskFailed", "TaskCancelled")
_CAUSES = {
    "execution_expired": ("expired", "no proof within the execution window"),
    "not_accepted": ("expired", "the executor did not accept the task in the grace period"),
    "abandoned": ("abandoned", "the executor gave the task back in the grace period, or had not accepted it"),
    "abandoned_late": ("abandoned", "the executor gave the task back after the grace period"),
}
"""The cause of an attempt's end that no judge ruled -> its verdict, and why."""


@dataclass(frozen=True)
class Attempt:
    """Times are site time, s; what did not happen is None."""

    number: int
    executor: str
    """Address."""
    assigned_s: float
    submitted_s: float | None = None
    ended_s: float | None = None
    proof_sha256: str | None = None
    proof_uri: str | None = None
    verdict: str | None = None
    """accepted, rejected, given_up, impossible, void, expired or abandoned: how it ended"""
    standing: str | None = None
    """The ruling that stood last and could be replaced."""
    fault: Fault = "nobody"
    """The party at fault for a void attempt."""
    reason: str | None = None
    report_sha256: str | None = None
    report_uri: str | None = None
    verdict_tx: str | None = None
    """The transaction in which the judge reported its ruling; its sender judged."""
    passed_on: bool = False
    """The oracle could not decide, so that auditors could."""
    counts: bool = True
    """Toward the task's `max_attempts`."""
    paid_iec: str | None = None
    """What the executor was paid for it."""


def _submitted(event: DaoEvent, _last: Attempt) -> dict[str, Any]:
    args = event.args
    return {"submitted_s": event.time_s, "proof_sha256": args["proof_hash"], "proof_uri": args["uri"]}


def _reported(event: DaoEvent, _last: Attempt) -> dict[str, Any]:
    """It comes before its ruling."""
    said = {"reason": event.args["reason"], "report_uri": event.args["report_uri"]}
    return {**said, "report_sha256": None, "verdict_tx": event.tx_hash}


def _ruled(event: DaoEvent, last: Attempt) -> dict[str, Any]:
    args, report = event.args, dict[str, Any]()
    if last.report_sha256 is None and last.verdict_tx == event.tx_hash:
        report = {"report_sha256": args["report"]}
    elif args["report"] != last.report_sha256:  # nobody has ruled, or a judge that reports nothing
        report = dict.fromkeys(("reason", "report_sha256", "report_uri", "verdict_tx"))
    final, ruling = not int(args["until"]), args["ruling"]
    stands = {"verdict": ruling, "standing": None} if final else {"verdict": None, "standing": ruling}
    return {**report, **stands, "fault": args["fault"]}


def _ended(event: DaoEvent, last: Attempt) -> dict[str, Any]:
    ended = {"ended_s": event.time_s, "paid_iec": event.args.get("paid_iec"), "standing": None}
    verdict, reason = _CAUSES.get(event.args.get("cause", ""), (last.verdict or last.standing, last.reason))
    return {**ended, "verdict": verdict, "reason": reason}


_CHANGES: dict[str, Callable[[DaoEvent, Attempt], dict[str, Any]]] = {
    "ProofSubmitted": _submitted,
    "Reported": _reported,
    "PassedOn": lambda _event, _last: {"passed_on": True},
    "TaskPassed": lambda _event, _last: {"counts": False},
    "Ruled": _ruled,
    **dict.fromkeys(("TaskSettled", "TaskFailed", "TaskRequeued"), _ended),
}
"""Event -> what it changes in the attempt that runs."""


def attempts(events: Iterable[DaoEvent]) -> list[Attempt]:
    """In order; `events` are those of one task in order."""
    made: list[Attempt] = []
    for event in happened(events):
        if event.name == "TaskAssigned":
            made.append(Attempt(event.args["attempt"], event.args["executor"], event.time_s))
        elif made and (change := _CHANGES.get(event.name)) is not None:
            made[-1] = replace(made[-1], **change(event, made[-1]))
    return made


def ended_s(events: Iterable[DaoEvent]) -> float | None:
    """When the task was settled, failed or cancelled; None while it continues."""
    return next((event.time_s for event in happened(events) if event.name in _ENDS), None)
