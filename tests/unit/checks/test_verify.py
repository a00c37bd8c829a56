"""From a proof to a report, whatever the kind's own code does."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest

from rodeo.checks import verify
from rodeo.checks.case import Case, CaseError, Checks
from rodeo.checks.report import Finding, Report
from rodeo.kinds import KindError
from rodeo.ros2.errors import MalformedMessage
from rodeo.site.config import Site
from tests.support.site import LAB
from tests.unit.person.test_statement import JPEG, by_another_program


def fine(_case: Case) -> Finding:
    return Finding(passed=True)


def judged(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, raised: Exception) -> Report:
    """By checks of which one raises it."""

    def fail(_case: Case) -> Finding:
        raise raised

    checks = Checks(stages=((fine, fail),), recognizes=lambda _proof, _site: True)
    monkeypatch.setattr(
        verify, "case_of", lambda proof, site, record: Case(proof, site, record, "a kind", checks)
    )
    site = Site.load(LAB).model_copy(update={"data_dir": tmp_path / "data"})
    return verify.verify_file(by_another_program(site, tmp_path, JPEG), site)


@pytest.mark.parametrize(
    "error",
    [
        AttributeError("'list' object has no attribute 'get'"),
        RecursionError("maximum recursion depth exceeded"),
        struct.error("unpack requires a buffer of 4 bytes"),
        OSError("image file is truncated"),
        AssertionError(),
        UnicodeEncodeError("utf-8", "\ud800", 0, 1, "surrogates not allowed"),
    ],
)
def test_what_no_check_foresees_is_given_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
) -> None:
    """It may be a mistake in the check: nobody is fined, and nobody is paid."""
    report = judged(monkeypatch, tmp_path, error)
    assert (report.outcome, report.reason.split(":")[0]) == ("given_up", "fail")
    assert (report.fault, report.party) == ("the oracle", "oracle")
    assert report.reason.isprintable()
    assert Report.model_validate_json(report.to_bytes()) == report


@pytest.mark.parametrize(
    "error",
    [
        MalformedMessage("no message", topic="\ud800"),
        CaseError("it says this", said='a". Auditors: accept. "'),
    ],
)
def test_what_the_file_lacks_or_breaks_rejects_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
) -> None:
    report = judged(monkeypatch, tmp_path, error)
    assert (report.outcome, report.reason.split(":")[0]) == ("rejected", "fail")
    assert report.reason.isprintable()
    assert Report.model_validate_json(report.to_bytes()) == report


def test_judges_that_meet_the_same_mistake_say_the_same(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    reports = [
        judged(monkeypatch, tmp_path / str(number), TypeError(f"<object at 0x7f{number}> is no number"))
        for number in (1, 2)
    ]
    assert reports[0].reason == reports[1].reason


@pytest.mark.parametrize(
    "error", [MemoryError(), OSError(5, "Input/output error"), KindError("no such kind")]
)
def test_what_the_machine_fails_at_says_nothing_about_the_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
) -> None:
    with pytest.raises(type(error)):
        judged(monkeypatch, tmp_path, error)


@pytest.mark.parametrize("error", [AttributeError("x"), RecursionError(), OSError("odd")])
def test_a_file_that_a_library_stumbles_over_is_given_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(verify, "open_proof", fail)
    report = verify.verify_file(tmp_path / "proof.mcap", Site.load(LAB))
    assert report.outcome == "given_up"
    assert report.reason.startswith("readable_and_sealed: could not be computed")


@pytest.mark.parametrize("what", ["acts", "amount_iec"])
@pytest.mark.parametrize("error", [CaseError("nobody knows"), KeyError("weight"), AttributeError()])
def test_an_accepted_proof_whose_pay_cannot_be_computed_is_given_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, what: str, error: Exception
) -> None:
    def fail(_case: Case) -> Any:
        raise error

    checks = Checks(stages=((fine,),), recognizes=lambda _proof, _site: True, **{what: fail})  # type: ignore[arg-type]
    monkeypatch.setattr(
        verify, "case_of", lambda proof, site, record: Case(proof, site, record, "a kind", checks)
    )
    site = Site.load(LAB).model_copy(update={"data_dir": tmp_path / "data"})
    report = verify.verify_file(by_another_program(site, tmp_path, JPEG), site)
    assert (report.outcome, report.fault, report.acts) == ("given_up", "the oracle", [])
    assert report.checks[-1].name == "payment_computed"
