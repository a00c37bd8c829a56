"""A verdict names who gave it: a person's word does not read like a measurement."""

from __future__ import annotations

import pytest

from rodeo.config import Site
from rodeo.kinds import kinds_of
from rodeo.queries import Transaction
from rodeo.verdicts import is_peoples_verdict, judge_of, verdict_words
from rodeo_testing import answers
from tests.support.site import LAB


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
    ("kind", "verdict", "audit_deadline", "audited", "by_people"),
    [
        ("wheel_cleaning", "accepted", None, (), True),
        ("waste_disposal", "accepted", None, (), False),
        ("waste_disposal", "rejected", 5.0, (), True),
        ("waste_disposal", "undecided", 5.0, (), False),
        ("waste_disposal", "accepted", None, ("waste_disposal",), True),
        ("wheel_cleaning", "expired", None, (), False),
    ],
)
def test_it_is_known_whether_a_person_judged(
    kind: str, verdict: str, audit_deadline: float | None, audited: tuple[str, ...], by_people: bool
) -> None:
    kinds = kinds_of(Site.load(LAB))
    assert is_peoples_verdict(kinds, kind, verdict, audit_deadline, audited) == by_people


def test_the_judge_is_whose_key_posted_the_newest_verdict() -> None:
    def posted(tx_hash: str, name: str | None, *events: str) -> Transaction:
        told = answers.transaction(tx_hash=tx_hash, events=list(events), sender_name=name, sender="0x12")
        return Transaction.model_validate(told)

    told = [
        posted("0x3", "alice", "ProofSubmitted"),
        posted("0x2", None, "VerdictPosted", "TaskSettled"),
        posted("0x1", "oracle", "VerdictPosted"),
    ]
    assert (judge_of(told), judge_of(told, "0x1"), judge_of(told[:1])) == ("0x12", "oracle", None)
    voted = [posted("0x4", "anna", "VotesCounted", "VerdictPosted", "TaskSettled"), *told]
    assert judge_of(voted) == "committee"  # whoever sent the votes judged nothing
    assert verdict_words("accepted", "accepted", judge_of(voted), by_people=False) == (
        "accepted by the oracle committee: all its checks passed"
    )
