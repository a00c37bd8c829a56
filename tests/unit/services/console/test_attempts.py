"""Every attempt at a task is told from its events, also those that the index has forgotten."""

from __future__ import annotations

from typing import Any

from rodeo.messages import DaoEvent
from services.console.attempts import attempts, ended_s

ROBOT, OTHER = "0x" + "1" * 40, "0x" + "2" * 40


def events(*told: tuple[str, dict[str, Any]]) -> list[DaoEvent]:
    """In order, ten seconds apart."""
    return [
        DaoEvent(
            seq=seq,
            name=name,
            block=seq,
            log_index=0,
            tx_hash="0x",
            time_s=10.0 * seq,
            task_id=1,
            args=args,
        )
        for seq, (name, args) in enumerate(told, start=1)
    ]


def assigned(attempt: int, executor: str = ROBOT) -> tuple[str, dict[str, Any]]:
    return "TaskAssigned", {"attempt": attempt, "executor": executor}


def proven(digit: str) -> tuple[str, dict[str, Any]]:
    return "ProofSubmitted", {"proof_hash": "0x" + digit * 64, "uri": f"file:///{digit}.mcap"}


def judged(accepted: bool, reason: str) -> tuple[str, dict[str, Any]]:
    return "VerdictPosted", {
        "verdict": "accepted" if accepted else "rejected",
        "reason": reason,
        "report_hash": "0x" + "f" * 64,
        "report_uri": "file:///f.json",
    }


REGISTERED = ("TaskRegistered", {})


def test_a_rejected_an_expired_and_an_accepted_attempt_keep_their_own_proof_and_reason() -> None:
    told = events(
        REGISTERED,
        assigned(1),
        proven("a"),
        judged(False, "nothing was lifted"),
        ("TaskRequeued", {"cause": "rejected"}),
        assigned(2, OTHER),
        ("TaskRequeued", {"cause": "execution_expired"}),
        assigned(3),
        proven("b"),
        judged(True, "accepted"),
        ("TaskSettled", {}),
    )
    first, second, third = attempts(told)
    assert (first.number, first.executor, first.assigned_s, first.submitted_s, first.ended_s) == (
        1, ROBOT, 20.0, 30.0, 50.0,
    )  # fmt: skip
    assert (first.proof_sha256, first.verdict, first.reason) == (
        "0x" + "a" * 64, "rejected", "nothing was lifted",
    )  # fmt: skip
    assert (second.executor, second.proof_sha256, second.verdict, second.reason, second.ended_s) == (
        OTHER, None, "expired", "no proof within the execution window", 70.0,
    )  # fmt: skip
    assert (third.proof_uri, third.verdict, third.ended_s) == ("file:///b.mcap", "accepted", 110.0)
    assert ended_s(told) == 110.0


def test_a_task_that_nobody_took_has_no_attempt_and_ends_when_it_is_cancelled() -> None:
    told = events(REGISTERED, ("TaskCancelled", {}))
    assert attempts(told) == []
    assert ended_s(told) == 20.0
    assert ended_s(told[:1]) is None


def test_what_a_reorganization_took_back_did_not_happen() -> None:
    told = events(
        REGISTERED,
        assigned(1),
        proven("a"),
        ("EventUndone", {"undone_seq": 3, "undone_name": "ProofSubmitted"}),
    )
    assert [(one.number, one.proof_sha256) for one in attempts(told)] == [(1, None)]


def test_the_report_of_a_verdict_that_can_be_challenged_is_that_of_the_attempt() -> None:
    ruled = ("Ruled", {"vote": {"report_hash": "0x" + "e" * 64}, "report_uri": "file:///e.json"})
    (waiting,) = attempts(events(REGISTERED, assigned(1), proven("a"), ruled))
    assert (waiting.report_sha256, waiting.report_uri) == ("0x" + "e" * 64, "file:///e.json")
    assert waiting.verdict is None
    (done,) = attempts(events(REGISTERED, assigned(1), proven("a"), ruled, judged(True, "fine")))
    assert (done.report_uri, done.verdict) == ("file:///f.json", "accepted")
