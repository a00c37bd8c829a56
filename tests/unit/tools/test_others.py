"""The figures of honest runs that others disturb, and where they are kept."""

from pathlib import Path

import pytest

from bench import resuming
from bench.others import Run, shares
from bench.resuming import Found


def test_who_is_paid_and_who_is_fined_is_counted_by_kind_of_fault() -> None:
    runs = [
        Run("junk_dropped", True, "accepted", ""),
        Run("junk_dropped", True, "rejected", ""),
        Run("bin_dead", False, "undecided", ""),
        Run("bin_dead", True, "accepted", ""),
    ]
    assert shares(runs) == {
        "honest_disturbed": 4,
        "honest_fined_by_others_share": 0.25,
        "honest_paid_despite_others_share": pytest.approx(2 / 3),
        "honest_paid_despite_bin_dead_share": 0.5,
        "honest_paid_despite_junk_dropped_share": 0.5,
    }
    assert shares([]) == {}


def test_a_run_that_was_stopped_goes_on_at_the_same_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "found.json"
    monkeypatch.setattr(resuming, "commit", lambda: "aa")
    found = Found(path, every=2)
    found.add(0, "x")
    found.add(2, "z")
    again = Found(path)
    assert (again.left(4), again.of(4)) == ([("aa", 1), ("aa", 3)], ["x", "z"])
    monkeypatch.setattr(resuming, "commit", lambda: "bb")
    assert Found(path).of(4) == []
