"""People's work: the oracle says what stands in the proof, and judges none of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from eth_account import Account

from rodeo.checks.report import Check, Report
from rodeo.checks.verify import verify_file
from rodeo.evidence.recorder import Recorder
from rodeo.host.clock import WallClock
from rodeo.kinds import kinds_of
from rodeo.site.config import Site
from rodeo.site.topics import EVENT_CHANNEL
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.assignments import BINDING
from rodeo_testing.recordings import Sample, Take
from services.oracle.process import is_ours
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.person.test_statement import JPEG, by_another_program


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site.load(LAB).model_copy(update={"data_dir": tmp_path / "data"})


def check(report: Report, name: str) -> Check:
    return next(one for one in report.checks if one.name == name)


KINDS = kinds_of(Site.load(LAB))


def test_a_kind_without_checks_of_its_own_is_never_the_oracles_whatever_the_rules_say() -> None:
    assert is_ours(KINDS, task("submitted", judge="oracle"))
    assert not is_ours(KINDS, task("submitted", judge="oracle", kind="wheel_cleaning"))


@pytest.mark.parametrize("judge", ["auditor", "none", "0x" + "11" * 20])
def test_a_task_that_others_judge_is_not_the_oracles(judge: str) -> None:
    assert not is_ours(KINDS, task("submitted", judge=judge))
    assert not is_ours(KINDS, task("submitted", judge="oracle", judge_removed=True))


def test_a_good_statement_is_left_to_people_and_never_accepted(site: Site, tmp_path: Path) -> None:
    report = verify_file(by_another_program(site, tmp_path, JPEG), site)
    assert check(report, "stated").passed
    assert (report.outcome, report.accepted) == ("undecided", False)
    assert "auditor" in report.reason


def test_a_statement_whose_photo_is_no_picture_is_said_to_be_so(site: Site, tmp_path: Path) -> None:
    report = verify_file(by_another_program(site, tmp_path, b"\xff\xd8\xff\xe0 no photo"), site)
    assert check(report, "stated").passed is False
    assert "not an image" in report.reason


def test_work_that_is_given_back_without_a_device_is_rejected_with_the_reason(
    site: Site, tmp_path: Path
) -> None:
    recorder = Recorder(tmp_path / "back.mcap", BINDING, Account.create(), WallClock())
    why = "alice cannot do waste_disposal: it has no machine that does it"
    recorder.write_json(EVENT_CHANNEL, {"event": "execution_failed", "message": why})
    chain_record = cleaning_chain_record(Take([Sample("", "", None, 1_900_000_000 * 10**9)]))
    report = verify_file(recorder.close().path, site, chain_record)
    assert report.outcome == "rejected"
    assert report.reason.startswith("signer: ") and why in report.reason
