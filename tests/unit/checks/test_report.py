"""Three outcomes, and which check names them."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest

from rodeo.checks.report import NOBODY, Check, Report, describe, equal, undecided
from rodeo.text.strict_json import read_json

PASSED = Check(name="fine", passed=True)
SKIPPED = Check(name="not_asked", passed=None)
REJECTED = Check(name="wrong", passed=False, detail="too fast", measured=3.0, limit=2.0, unit="m/s")
UNDECIDED = Check(name="unseen", **undecided("nobody saw it", "the site's motion capture").model_dump())


def outcome(*checks: Check) -> tuple[str, str, str | None]:
    report = Report.of(list(checks))
    return report.outcome, report.reason.split(":")[0], report.fault


def test_checks_that_pass_accept() -> None:
    assert outcome(PASSED, SKIPPED) == ("accepted", "accepted", None)


def test_the_first_check_that_fails_names_the_rejection() -> None:
    later = REJECTED.model_copy(update={"name": "worse"})
    assert outcome(PASSED, REJECTED, later) == ("rejected", "wrong", None)


def test_what_neither_party_owns_is_undecided_and_names_who_failed() -> None:
    report = Report.of([PASSED, UNDECIDED])
    assert (report.outcome, report.fault) == ("undecided", "the site's motion capture")
    assert report.reason == ("unseen: nobody saw it; the site's motion capture is at fault, not the executor")


def test_where_nothing_failed_people_decide_and_nobody_is_said_to_be_at_fault() -> None:
    report = Report.of([Check.of("unseen", undecided("who lifted it cannot be told", NOBODY))])
    assert report.reason == "unseen: who lifted it cannot be told; nobody is at fault, people decide"


@pytest.mark.parametrize("checks", [(UNDECIDED, REJECTED), (REJECTED, UNDECIDED)])
def test_what_the_executor_did_wrong_goes_before_what_a_witness_failed_at(checks: tuple[Check, ...]) -> None:
    assert outcome(*checks) == ("rejected", "wrong", None)


def test_no_checks_accept_nothing() -> None:
    assert Report.of([]).outcome == "rejected"


def test_a_rejection_pays_nothing_and_says_what_was_claimed_as_it_may_be_overturned() -> None:
    report = Report.of([REJECTED], amount_iec=Decimal(5), acts=["bin/itrash/drop/7"])
    assert (report.amount_iec, report.acts) == (None, ["bin/itrash/drop/7"])


def test_a_check_that_fails_afterwards_takes_back_what_was_accepted() -> None:
    report = Report.of([PASSED], amount_iec=Decimal(5), acts=["bin/itrash/drop/7"])
    assert (report.amount_iec, report.acts) == (Decimal(5), ["bin/itrash/drop/7"])
    report = report.with_checks(REJECTED)
    assert (report.outcome, report.amount_iec) == ("rejected", None)


def test_what_is_stored_is_what_is_read() -> None:
    report = Report.of([PASSED], amount_iec=Decimal("0.1"), acts=["bin/itrash/drop/7"])
    assert Report.model_validate_json(report.to_bytes()) == report


def test_a_report_is_strict_json_whatever_was_found() -> None:
    odd = Check(name="odd", passed=False, measured=math.nan, limit=math.inf, detail="\ud800\x1b[2J")
    report = Report.of([odd, Check(name="text", passed=False, measured="\udc00")], acts=["a\ud800/1"])
    assert read_json(report.to_bytes())["checks"][0]["measured"] == "nan"
    assert report.reason == "odd: \\ud800\\u001b[2J (nan, limit inf)"
    assert report.model_copy(update={"acts": ["\ud800/1"]}).to_bytes()


def test_what_is_compared_is_quoted() -> None:
    found = equal("no item; the oracle is at fault", "item1", source="the site")
    assert describe(Check(name="same", **found.model_dump())) == (
        'same:  ("no item; the oracle is at fault", limit "item1")'
    )


def test_a_reason_fits_the_chain_and_keeps_whose_failure_it_is() -> None:
    long = Check(name="unseen", **undecided("x" * 1000, "the oracle").model_dump())
    reason = Report.of([long]).reason
    assert 490 < len(reason) <= 500
    assert reason.endswith("the oracle is at fault, not the executor")
