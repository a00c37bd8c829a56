"""A verdict names who gave it: a person's word does not read like a measurement."""

from __future__ import annotations

from typing import Any

import pytest

from rodeo.bus.messages import Fault
from rodeo.bus.queries import Transaction
from rodeo.judging.verdicts import FAULTS, is_peoples_verdict, judge_of, standing_words, verdict_words
from rodeo_testing import answers
from tests.support.tasks import task


def test_a_persons_verdict_is_told_as_a_persons_word() -> None:
    said = verdict_words("accepted", "accepted", "organization", by_people=True)
    assert said == "accepted by the auditor organization (a person): “accepted”"
    assert verdict_words("accepted", "accepted", "oracle", by_people=False) == (
        "accepted by the oracle: all its checks passed"
    )
    assert verdict_words("rejected", "grasp: it fell", "oracle", by_people=False) == (
        "rejected by the oracle: grasp: it fell"
    )


@pytest.mark.parametrize(
    ("kinds_judge", "verdict", "passed_on", "by_people"),
    [
        ("auditor", "accepted", False, True),
        ("oracle", "accepted", False, False),
        ("oracle", "rejected", True, True),
        ("oracle", "void", True, False),  # no auditor is known to have ruled
        ("auditor", "expired", False, False),
    ],
)
def test_it_is_known_whether_a_person_judged(
    kinds_judge: str, verdict: str, passed_on: bool, by_people: bool
) -> None:
    one = task("failed", judge=kinds_judge, verdict=verdict, passed_on=passed_on)
    assert is_peoples_verdict(one) == by_people
    assert is_peoples_verdict(one, judge="anna") == (by_people or verdict == "void")


def test_the_judge_is_whose_key_sent_the_newest_ruling() -> None:
    def sent(tx_hash: str, name: str | None, *events: str) -> Transaction:
        told = answers.transaction(tx_hash=tx_hash, events=list(events), sender_name=name, sender="0x12")
        return Transaction.model_validate(told)

    told = [
        sent("0x3", "alice", "Ruled"),  # concluded where nobody had ruled
        sent("0x2", None, "Reported", "Ruled", "TaskSettled"),
        sent("0x1", "oracle", "Reported", "Ruled"),
    ]
    assert (judge_of(told), judge_of(told, "0x1"), judge_of(told[:1])) == ("0x12", "oracle", None)
    assert judge_of([sent("0x4", "oracle", "Reported", "PassedOn", "Ruled")]) is None
    for event in ("VotesCounted", "InstanceRuled"):  # whoever sent the votes judged nothing
        assert judge_of([sent("0x4", "anna", event, "Reported", "Ruled"), *told]) == "committee"
    assert verdict_words("accepted", "accepted", "committee", by_people=False) == (
        "accepted by the oracle committee: all its checks passed"
    )


@pytest.mark.parametrize(("fault", "doing"), FAULTS.items())
def test_a_void_attempt_says_whose_doing_it_was(fault: Fault, doing: str) -> None:
    said = verdict_words("void", "the door was locked", None, by_people=False, fault=fault)
    assert said == f"void, {doing}: the door was locked"
    said = verdict_words("void", "the door was locked", "anna", by_people=True, fault=fault)
    assert said == f"void, {doing}, by the auditor anna (a person): “the door was locked”"


def test_a_ruling_without_a_report_says_so_and_one_that_nobody_made_too() -> None:
    assert (
        verdict_words("rejected", None, "0x12", by_people=False) == "rejected by the oracle 0x12: no report"
    )
    assert verdict_words("given_up", None, "anna", by_people=True) == (
        "given up by the auditor anna (a person): no report"
    )
    assert verdict_words("void", None, None, False, "creator") == "void, the creator's doing: no report"
    assert "nobody ruled on it in time" in verdict_words("void", None, None, False, "oracle")


DISPUTE = {"instance": 0, "until": 9.0}


@pytest.mark.parametrize(
    ("standing", "more", "says"),
    [
        ({"ruling": "rejected"}, {}, "rejected: the item fell; it stands unless it is replaced by noon"),
        (
            {"ruling": "void"},
            {"passed_on": True},
            "passed on to the auditors: the item fell; void unless one rules by noon",
        ),
        (
            {"ruling": "void", "fault": "oracle"},
            {"reason": None},
            "void, the judge's doing: nobody ruled on it in time, or who did rules no more; it stands unless "
            "it is replaced by noon",
        ),
        (
            {"ruling": "accepted"},
            {"dispute": DISPUTE, "reason": "accepted"},
            "accepted, 5 IEC; it can be challenged until noon",
        ),
        (
            {"ruling": "rejected"},
            {"dispute": DISPUTE | {"challenger": "0x1", "because": "it did not"}},
            "rejected: the item fell; challenged: it did not; it stands unless the judges decide by noon",
        ),
    ],
)
def test_what_stands_says_what_can_still_become_of_it(
    standing: dict[str, Any], more: dict[str, Any], says: str
) -> None:
    told = {"reason": "the item fell", "passed_on": False, "standing": {"until": 9.0} | standing} | more
    assert standing_words(task("ruled", **told), "5 IEC", "noon") == says
