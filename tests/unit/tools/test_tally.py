"""The last line of `make test`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import __main__ as runner
from tests.support.tally import Tally

ROOT = Path(__file__).parents[3]
TESTS = """
import pytest

def test_that_passes(): pass
def test_that_fails(): assert False
@pytest.mark.long
def test_that_takes_minutes(): pass
@pytest.mark.xfail
def test_that_may_fail(): assert False
@pytest.mark.parametrize("one", [1, 2])
def test_that_is_skipped(one): pytest.skip("Chromium is missing: make system")
@pytest.fixture
def broken(): assert False
def test_whose_fixture_fails(broken): pass
"""


def told(folder: Path, source: str, *words: str) -> tuple[list[str], Tally]:
    """Lines that pytest prints for a file of tests, and what was counted."""
    (folder / "test_some.py").write_text(source)
    counted = folder / "tally.json"
    plugins = ["-p", "tests.support.tally", "-p", "xdist", "--tally", str(counted), "--rootdir", str(folder)]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *plugins, *words, str(folder)],
        cwd=ROOT,
        env=os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.splitlines(), Tally.read(counted)


def test_what_workers_ran_skipped_and_left_out_is_counted(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = long\n")
    lines, tally = told(tmp_path, TESTS, "-m", "not long", "-n", "1")
    assert [line.split(": ")[0:2] for line in lines if line.startswith("failed (")] == [
        ["failed (call)", "test_some.py::test_that_fails"],
        ["failed (setup)", "test_some.py::test_whose_fixture_fails"],
    ]
    assert tally == Tally(2, 2, {"Chromium is missing: make system": 2}, 1)


def test_what_runs_for_long_is_named_before_it_ends(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text("from tests.support import tally\ntally.LONG_S = -1.0\n")
    lines, _ = told(tmp_path, "def test_that_hangs(): pass\n")
    assert "runs for -1 s and more: test_some.py::test_that_hangs" in lines


def test_what_is_left_after_the_last_minute_is_skipped_by_name(tmp_path: Path) -> None:
    lines, tally = told(tmp_path, "def test_that_is_left(): assert False\n", "--until", "0", "-n", "1")
    assert "out of time: test_some.py::test_that_is_left" in lines
    assert tally.skipped == {"out of time": 1}


def test_the_line_says_why_tests_were_skipped() -> None:
    both = Tally(3, 0, {"Chromium is missing: make system": 2}, 7) + Tally(1, 1)
    assert str(both) == "4 passed, 1 failed, 2 skipped (2: Chromium is missing: make system)"
    assert both.deselected == 7


FORGE = "Ran 2 test suites in 1s (1s CPU time): 5 tests passed, 1 failed, 2 skipped (8 total tests)"


@pytest.mark.parametrize(
    ("node", "npm", "counted"),
    [
        ("echo 20", f"echo '{FORGE}'; exit 1", Tally(5, 1, {"contracts: skipped by their own": 2})),
        ("echo 20", "echo does not compile; exit 1", Tally(0, 1)),
        ("echo 12", "exit 1", Tally(0, 0, {"contracts: Node is missing, `make system`": 1})),
    ],
)
def test_the_contracts_count_too_or_are_skipped_by_name(
    node: str, npm: str, counted: Tally, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, script in {"node": node, "npm": npm}.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(runner, "OUT", tmp_path)
    assert runner.Contracts(long=False, until_s=None).wait() == counted
    if "Node" not in str(counted):
        late = runner.Contracts(long=False, until_s=0.0).wait()
        assert (late.passed, late.failed) == (0, 0) and "no time left" in str(late)
