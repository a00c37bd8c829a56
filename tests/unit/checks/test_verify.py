"""From a proof to a report, whatever the kind's own code does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rodeo.checks import verify
from rodeo.checks.case import Case, CaseError, Checks
from rodeo.checks.report import Finding
from rodeo.config import Site
from tests.support.site import LAB
from tests.unit.person.test_statement import JPEG, by_another_program


def fine(_case: Case) -> Finding:
    return Finding(passed=True)


@pytest.mark.parametrize("what", ["acts", "amount_iec"])
@pytest.mark.parametrize("error", [CaseError("nobody knows"), KeyError("weight"), ZeroDivisionError()])
def test_an_accepted_proof_whose_pay_cannot_be_computed_is_for_people(
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
    assert (report.outcome, report.fault, report.acts) == ("undecided", "the oracle", [])
    assert report.checks[-1].name == "payment_computed"
