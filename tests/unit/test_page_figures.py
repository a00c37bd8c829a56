"""A figure of a web page that is missing is named with its reason; it never ends the benchmark."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest
from playwright.sync_api import Page
from playwright.sync_api import TimeoutError as PageTimeout

from rodeo_testing.waiting import HANG_S
from tests.support.page_figures import FigureMissing, kept, latency_ms, measured, wait_seen

ROOT = Path(__file__).parents[2]


class FakePage:
    """A page whose `window` is a dict; a page that is loaded again begins with an empty one."""

    def __init__(self, **window: Any) -> None:
        self.window = window

    def evaluate(self, expression: str) -> Any:
        return self.window.get(expression.removeprefix("window."))

    def wait_for_function(self, _expression: str) -> None:
        """What is waited for is there, or the page lost what it watched."""


def page(**window: Any) -> Page:
    return cast(Page, FakePage(**window))


def test_what_a_page_counted_is_read_also_where_it_is_nothing() -> None:
    assert kept(page(moves=0), "moves") == 0
    assert kept(page(seen={}), "seen") == {}


def test_a_page_that_was_loaded_again_says_what_it_lost() -> None:
    with pytest.raises(FigureMissing, match=r"window\.moves: it was loaded again"):
        kept(page(), "moves")
    with pytest.raises(FigureMissing, match=r"window\.seen"):
        wait_seen(page(), "/tasks/1")


def test_the_time_to_the_page_counts_the_events_that_were_heard_and_seen() -> None:
    published = {f"/tasks/{n}": 1000.0 for n in range(5)}
    seen = {f"/tasks/{n}": 1100.0 for n in range(4)} | {"/tasks/elsewhere": 9e9}
    assert latency_ms(published, seen) == (100.0, 100.0)


@pytest.mark.parametrize("seen", [{}, {"/tasks/1": 1100.0}])
def test_too_few_events_are_a_missing_figure_with_their_number(seen: dict[str, float]) -> None:
    with pytest.raises(FigureMissing, match=f"the page showed {len(seen)} of the 2 events"):
        latency_ms({"/tasks/1": 1000.0, "/tasks/2": 1000.0}, seen)


def test_figures_have_the_names_that_were_asked_for_in_their_order() -> None:
    assert measured(lambda: 5.0, "load_ms") == {"load_ms": 5.0}
    assert measured(lambda: (1.0, 2.0), "p50_ms", "p95_ms") == {"p50_ms": 1.0, "p95_ms": 2.0}


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (PageTimeout("Page.goto: Timeout 60000ms exceeded.\nCall log:\n  - navigating"), "Timeout 60000ms"),
        (FigureMissing("the page lost window.seen"), "lost window.seen"),
    ],
)
def test_a_page_that_fails_leaves_its_figures_out_and_says_which_and_why(
    error: Exception, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure() -> float:
        raise error

    assert measured(measure, "p50_ms", "p95_ms") == {"p50_ms": None, "p95_ms": None}
    said = capsys.readouterr().out.splitlines()
    assert [line.partition(" is missing: ")[0] for line in said] == ["p50_ms", "p95_ms"]
    assert all(reason in line and "Call log" not in line for line in said)


def test_a_defect_of_the_measurement_is_no_missing_figure() -> None:
    def measure() -> float:
        raise KeyError("moves")

    with pytest.raises(KeyError):
        measured(measure, "load_ms")


def test_the_benchmark_prints_a_missing_figure_and_forgets_the_older_one(tmp_path: Path) -> None:
    out = tmp_path / "out" / "bench.json"
    out.parent.mkdir()
    out.write_text(json.dumps({"console_a_ms": 1.5, "console_b_ms": 2.5, "robot_c": 3}))
    script = """
import sys, types
sys.modules["bench.console"] = types.SimpleNamespace(run=lambda: {"console_a_ms": None, "console_b_ms": 7.25})
from bench.__main__ import main
sys.exit(main(["console"]))
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert done.returncode == 0, done.stderr
    assert ["console_a_ms", "missing"] in [line.split() for line in done.stdout.splitlines()]
    assert json.loads(out.read_text()) == {"console_b_ms": 7.25, "robot_c": 3}
