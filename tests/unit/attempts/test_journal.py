"""Journal: what was said is still there after the process is gone, and is never taken for another task's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rodeo.attempts.journal import Journal, Phase
from rodeo.dao import Assignment
from rodeo.robot.errors import JournalBroken

OURS = Assignment(
    genesis_hash="0x" + "01" * 32,
    chain_id=31_337,
    task_manager="0x" + "02" * 20,
    organization="0x" + "03" * 20,
    task_id=1,
    attempt=1,
    nonce="0x" + "04" * 32,
)


def test_a_phase_survives_the_process(tmp_path: Path) -> None:
    Journal.open(tmp_path / "1-1", OURS).advance(tmp_path / "1-1", Phase.SEALED, "0xab")
    again = Journal.open(tmp_path / "1-1", OURS)
    assert (again.phase, again.proof_sha256) == (Phase.SEALED, "0xab")


def test_an_unfinished_save_does_not_hurt(tmp_path: Path) -> None:
    Journal.open(tmp_path, OURS).advance(tmp_path, Phase.EXECUTED)
    (tmp_path / "journal.json.new").write_text("{cut o")
    assert Journal.open(tmp_path, OURS).phase == Phase.EXECUTED


@pytest.mark.parametrize(
    "changed",
    [
        pytest.param({"genesis_hash": "0x" + "99" * 32}, id="a chain that was wiped"),
        pytest.param({"task_manager": "0x" + "99" * 20}, id="contracts that were deployed anew"),
        pytest.param({"nonce": "0x" + "99" * 32}, id="assigned again after a reorganization"),
    ],
)
def test_another_assignment_of_the_same_number_begins_anew_and_the_old_one_is_kept(
    tmp_path: Path, changed: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "1-1"
    Journal.open(folder, OURS).advance(folder, Phase.SUBMITTED, "0xab")
    (folder / "recording.mcap").write_bytes(b"what was recorded")
    theirs = OURS.model_copy(update=changed)

    assert Journal.find(folder, theirs) is None
    assert Journal.open(folder, theirs).phase == Phase.EXECUTING
    assert not (folder / "recording.mcap").exists()

    (aside,) = (path for path in tmp_path.iterdir() if path != folder)
    assert (aside / "recording.mcap").read_bytes() == b"what was recorded"
    assert json.loads((aside / "journal.json").read_text())["phase"] == "submitted"
    assert str(aside) in caplog.text


def test_a_journal_that_does_not_say_whose_it_is_is_nobodys(tmp_path: Path) -> None:
    folder = tmp_path / "1-1"
    folder.mkdir()
    (folder / "journal.json").write_text('{"task_id":1,"attempt":1,"phase":"submitted","failure":null}')
    assert Journal.open(folder, OURS).phase == Phase.EXECUTING
    assert len(list(tmp_path.iterdir())) == 2


def test_a_journal_that_was_cut_is_named_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "journal.json").write_text('{"assignment": {"gen')
    with pytest.raises(JournalBroken) as broken:
        Journal.open(tmp_path, OURS)
    assert broken.value.details["path"] == str(tmp_path / "journal.json")
