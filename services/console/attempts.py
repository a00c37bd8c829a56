"""The attempts at a task one by one, from its contract events; the index keeps the last one only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from rodeo.messages import DaoEvent, Fault

_ENDS = ("TaskSettled", "TaskFailed", "TaskCancelled")
_EXPIRED = {
    "execution_expired": "no proof within the execution window",
    "not_accepted": "the executor did not accept the task in the grace period",
}
_ABANDONED = {
    "abandoned": "the executor gave the task back in the grace period, or had not accepted it",
    "abandoned_late": "the executor gave the task back after the grace period",
}


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


def happened(events: Iterable[DaoEvent]) -> list[DaoEvent]:
    """Without those that a reorganization took back."""
    kept: dict[int, DaoEvent] = {}
    for event in events:
        if event.name == "EventUndone":
            kept.pop(event.args["undone_seq"], None)
        else:
            kept[event.seq] = event
    return list(kept.values())


def attempts(events: Iterable[DaoEvent]) -> list[Attempt]:
    """In order; `events` are those of one task in order."""
    made: list[Attempt] = []
    for event in happened(events):
        args = event.args
        if event.name == "TaskAssigned":
            made.append(Attempt(args["attempt"], args["executor"], event.time_s))
        elif not made:
            continue
        elif event.name == "ProofSubmitted":
            made[-1] = replace(
                made[-1], submitted_s=event.time_s, proof_sha256=args["proof_hash"], proof_uri=args["uri"]
            )
        elif event.name == "Reported":  # comes before its ruling
            made[-1] = replace(
                made[-1],
                reason=args["reason"],
                report_sha256=None,
                report_uri=args["report_uri"],
                verdict_tx=event.tx_hash,
            )
        elif event.name == "PassedOn":
            made[-1] = replace(made[-1], passed_on=True)
        elif event.name == "TaskPassed":
            made[-1] = replace(made[-1], counts=False)
        elif event.name == "Ruled":
            if made[-1].report_sha256 is None and made[-1].verdict_tx == event.tx_hash:
                made[-1] = replace(made[-1], report_sha256=args["report"])
            elif (
                args["report"] != made[-1].report_sha256
            ):  # nobody has ruled, or a judge that reports nothing
                made[-1] = replace(
                    made[-1], reason=None, report_sha256=None, report_uri=None, verdict_tx=None
                )
            final = not int(args["until"])
            made[-1] = replace(
                made[-1],
                verdict=args["ruling"] if final else None,
                standing=None if final else args["ruling"],
                fault=args["fault"],
            )
        elif event.name in ("TaskSettled", "TaskFailed", "TaskRequeued"):
            last = made[-1]
            made[-1] = replace(
                last,
                ended_s=event.time_s,
                paid_iec=args.get("paid_iec"),
                verdict=last.verdict or last.standing,
                standing=None,
            )
            if (expiry := _EXPIRED.get(args.get("cause", ""))) is not None:
                made[-1] = replace(made[-1], verdict="expired", reason=expiry)
            if (given_back := _ABANDONED.get(args.get("cause", ""))) is not None:
                made[-1] = replace(made[-1], verdict="abandoned", reason=given_back)
    return made


def ended_s(events: Iterable[DaoEvent]) -> float | None:
    """When the task was settled, failed or cancelled; None while it continues."""
    return next((event.time_s for event in happened(events) if event.name in _ENDS), None)
