"""Journal: what was said is still there after the process is gone."""

from __future__ import annotations

from pathlib import Path

from services.robot_agent.journal import Journal, Phase


def test_a_phase_survives_the_process(tmp_path: Path) -> None:
    Journal.open(tmp_path / "3-1", 3, 1).advance(tmp_path / "3-1", Phase.SEALED, "0xab")
    again = Journal.open(tmp_path / "3-1", 3, 1)
    assert (again.phase, again.proof_sha256) == (Phase.SEALED, "0xab")


def test_an_unfinished_save_does_not_hurt(tmp_path: Path) -> None:
    Journal.open(tmp_path, 3, 1).advance(tmp_path, Phase.EXECUTED)
    (tmp_path / "journal.json.new").write_text("{cut o")
    assert Journal.open(tmp_path, 3, 1).phase == Phase.EXECUTED
