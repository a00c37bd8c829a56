"""Every attempt at a task is shown from its events, also those that the index has forgotten."""

from __future__ import annotations

from typing import Any

from rodeo.bus.messages import DaoEvent
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


REPORT, NONE = "0x" + "f" * 64, "0x" + "0" * 64


def judged(ruling: str, reason: str, until: int = 0, **more: Any) -> list[tuple[str, dict[str, Any]]]:
    """A ruling with its report; `until` 0: it is final."""
    report = {"reason": reason, "report_uri": "file:///f.json"}
    return [
        ("Reported", report),
        ("Ruled", {"ruling": ruling, "fault": "nobody", "until": until, "report": REPORT} | more),
    ]


REGISTERED = ("TaskRegistered", {})


def test_a_rejected_an_expired_and_an_accepted_attempt_keep_their_own_proof_and_reason() -> None:
    told = events(
        REGISTERED,
        assigned(1),
        proven("a"),
        *judged("rejected", "nothing was lifted"),
        ("TaskRequeued", {"cause": "rejected"}),
        assigned(2, OTHER),
        ("TaskRequeued", {"cause": "execution_expired"}),
        assigned(3),
        proven("b"),
        *judged("accepted", "accepted"),
        ("TaskSettled", {}),
    )
    first, second, third = attempts(told)
    assert (first.number, first.executor, first.assigned_s, first.submitted_s, first.ended_s) == (
        1, ROBOT, 20.0, 30.0, 60.0,
    )  # fmt: skip
    assert (first.proof_sha256, first.verdict, first.reason) == (
        "0x" + "a" * 64, "rejected", "nothing was lifted",
    )  # fmt: skip
    assert (second.executor, second.proof_sha256, second.verdict, second.reason, second.ended_s) == (
        OTHER, None, "expired", "no proof within the execution window", 80.0,
    )  # fmt: skip
    assert (third.proof_uri, third.verdict, third.ended_s) == ("file:///b.mcap", "accepted", 130.0)
    assert ended_s(told) == 130.0


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


def test_a_ruling_that_stands_has_its_report_and_is_the_verdict_when_it_is_concluded() -> None:
    begun = (REGISTERED, assigned(1), proven("a"), *judged("rejected", "it fell", until=900))
    (stands,) = attempts(events(*begun))
    assert (stands.standing, stands.verdict) == ("rejected", None)
    assert (stands.reason, stands.report_sha256, stands.report_uri) == ("it fell", REPORT, "file:///f.json")
    (concluded,) = attempts(events(*begun, ("TaskRequeued", {"cause": "rejected"})))
    assert (concluded.standing, concluded.verdict, concluded.reason) == (None, "rejected", "it fell")
    replaced = (*begun, *judged("accepted", "it did not"), ("TaskSettled", {"paid_iec": "5"}))
    (paid,) = attempts(events(*replaced))
    assert (paid.verdict, paid.reason, paid.paid_iec) == ("accepted", "it did not", "5")


def test_whoever_challenges_a_ruling_has_not_made_it() -> None:
    told = events(REGISTERED, assigned(1), proven("a"), *judged("rejected", "it fell", until=900))
    again = told[-1].model_copy(update={"seq": 9, "tx_hash": "0xchallenge"})
    (stands,) = attempts([*told, again])
    assert (stands.standing, stands.reason, stands.verdict_tx) == ("rejected", "it fell", "0x")


def test_an_attempt_on_which_nobody_ruled_has_no_report_and_says_whose_doing_it_is() -> None:
    void = {"ruling": "void", "fault": "oracle", "until": 900, "report": NONE}
    (stands,) = attempts(events(REGISTERED, assigned(1), proven("a"), ("Ruled", void)))
    assert (stands.standing, stands.fault, stands.report_sha256, stands.reason) == (
        "void",
        "oracle",
        None,
        None,
    )


def test_what_a_removed_judge_had_said_is_gone() -> None:
    begun = (REGISTERED, assigned(1), proven("a"), *judged("accepted", "fine", until=900))
    void = {"ruling": "void", "fault": "oracle", "until": 1800, "report": NONE}
    (stands,) = attempts(events(*begun, ("Ruled", void)))
    assert (stands.standing, stands.reason, stands.report_uri) == ("void", None, None)


def test_what_was_passed_on_is_known_as_such() -> None:
    ruling = judged("void", "too dark", until=900)
    told = events(REGISTERED, assigned(1), proven("a"), ruling[0], ("PassedOn", {"attempt": 1}), ruling[1])
    (waits,) = attempts(told)
    assert (waits.passed_on, waits.standing, waits.reason) == (True, "void", "too dark")


def test_an_attempt_that_the_contracts_passed_does_not_count() -> None:
    passed = ("TaskPassed", {"provider": 3, "gave_up": False})
    told = events(
        REGISTERED, assigned(1), passed, ("TaskRequeued", {"cause": "abandoned"}), assigned(2, OTHER)
    )
    first, second = attempts(told)
    assert (first.counts, first.verdict, first.reason) == (
        False, "abandoned", "the executor gave the task back in the grace period, or had not accepted it",
    )  # fmt: skip
    assert second.counts and second.verdict is None
