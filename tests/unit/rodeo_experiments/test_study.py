"""Many runs of an experiment: what they are asked, what answers them, and what their report shows."""

from __future__ import annotations

import gzip
import json
import math
import socket
import threading
from datetime import date
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from rodeo.jobs.job import BadAnswer, Job, WorkerDiffers
from rodeo.site.config import Site
from rodeo_cli.experiment import PAPER
from rodeo_cli.study import Study
from rodeo_experiments.conduct import parameters
from rodeo_experiments.errors import ExperimentFailed
from rodeo_experiments.inputs import files_sha256
from rodeo_experiments.record import Run
from rodeo_experiments.site import Variation, write_site
from rodeo_experiments.study import ASKED, Asked, Runs, begin, record_of, settings
from rodeo_experiments.study_report import Found, interval, write_study
from tests.unit.rodeo_experiments.test_results import a_run


def asked(seed: int = 1, unlisted: bool = False, **changes: Any) -> Asked:
    return Asked.of(PAPER, Variation(seed=seed, days=1, unlisted=unlisted), changes, "")


def a_record(tmp_path: Path, seed: int) -> Run:
    """A run whose parameters are those that `asked` sets."""
    site = Site.load(write_site(PAPER, tmp_path / f"site-{seed}", Variation(seed=seed, days=1)))
    return a_run(seed=seed, days=1, parameters=parameters(site))


def packed(run: Run) -> bytes:
    return gzip.compress(run.model_dump_json().encode())


class Pool:
    """An engine that answers with such records."""

    name = "pool"
    places = 2

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.asked: list[int] = []

    def do(self, job: Job, stop: threading.Event, failed: int = 0) -> bytes:
        seed = job.given["tables"]["clock"]["seed"]
        self.asked.append(seed)
        return packed(a_record(self._folder, seed))

    def close(self) -> None:
        pass


def test_each_combination_of_values_is_a_setting() -> None:
    assert settings([]) == [{}]
    assert settings(["a.b=1,2.5", "c=x"]) == [{"a.b": 1, "c": "x"}, {"a.b": 2.5, "c": "x"}]
    assert settings(["limits=[1, 2],[3]"]) == [{"limits": [1, 2]}, {"limits": [3]}]
    for texts in (["a.b"], ["=1"], ["a.b="], ["a=1", "a=2"], ["clock.seed=1,2"], ["chain=5"]):
        with pytest.raises(ExperimentFailed):
            settings(texts)


def test_the_same_run_has_the_same_key_wherever_it_is_asked_for() -> None:
    assert asked().job.key == asked().job.key
    others = [
        asked(seed=2),
        asked(**{"agent.charge_below": 0.4}),
        asked(unlisted=True),
        asked().model_copy(update={"times_s": []}),
    ]
    assert len({asked().job.key, *(one.job.key for one in others)}) == 5


def test_a_setting_changes_each_table_of_a_list() -> None:
    assert [one["battery"]["soc"] for one in asked(**{"robots.battery.soc": 0.5}).tables["robots"]] == [0.5]


def test_what_a_variation_says_can_be_set() -> None:
    fitted = Variation(seed=1, days=1, calibrated=True)
    asked = Asked.of(PAPER, fitted, {"experiment.calibrated_idle_power_w": 90.0}, "")
    assert [one["battery"]["idle_power_w"] for one in asked.tables["robots"]] == [90.0]


def test_what_is_set_counts_also_where_a_variation_sets_it(tmp_path: Path) -> None:
    found = asked(unlisted=True, **{"agent.explore_min_per_h": 4.0, "experiment.arrivals": 20})
    assert found.tables["agent"]["explore_min_per_h"] == 4.0
    assert len(found.times_s) == 20


def test_another_file_behind_the_same_name_is_another_run(tmp_path: Path) -> None:
    site, scene = tmp_path / "site.toml", tmp_path / "map.yaml"
    site.write_text(f'extends = "{PAPER}"\n')
    scene.write_text("one")
    tables = {"rooms": {"map": str(scene)}}
    before = files_sha256(tables)
    scene.write_text("two")
    assert before.keys() == files_sha256(tables).keys() == {str(scene)}
    assert before != files_sha256(tables)
    other = asked().model_copy(update={"files": before})
    with pytest.raises(WorkerDiffers, match="another files"):
        Runs(tmp_path).do(other.job, threading.Event())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("agent.charge_bellow", 0.4, "agent.charge_bellow: no such key"),
        ("agent.charge_below", date(2026, 1, 1), "write a number"),
        ("agent.charge_below", math.nan, "Invalid value"),
        ("clock.seed.robot", 1, "no such setting"),
    ],
)
def test_a_setting_that_no_site_has_is_refused(name: str, value: Any, words: str) -> None:
    with pytest.raises(ExperimentFailed) as refused:
        asked(**{name: value})
    assert words in str(refused.value)


def test_a_worker_with_other_code_refuses_the_run_by_name(tmp_path: Path) -> None:
    other = asked().model_copy(update={"code_sha256": "0" * 64})
    with pytest.raises(WorkerDiffers, match="another code_sha256"):
        Runs(tmp_path).do(other.job, threading.Event())


def test_a_run_that_was_interrupted_begins_anew(tmp_path: Path) -> None:
    """Else its balances would depend on where it was interrupted. Its chain's port may be taken by now."""
    given = asked()
    (tmp_path / ASKED).write_text(given.model_dump_json())
    first = Site.load(begin(tmp_path)[0])
    (first.data_dir / "chain").mkdir(parents=True)
    address = urlsplit(first.chain.url)
    with socket.create_server((address.hostname or "", address.port or 0)):
        again, times_s = begin(tmp_path)
        assert urlsplit(Site.load(again).chain.url).port != address.port
    assert Site.load(again).data_dir == first.data_dir and not first.data_dir.exists()
    assert times_s == given.times_s


def test_a_record_answers_its_own_run_only(tmp_path: Path) -> None:
    runs, answer = Runs(tmp_path), packed(a_record(tmp_path, 1))
    runs.check(asked(seed=1).job, answer)
    for other, differ in (
        (asked(seed=2), "clock, seed"),
        (asked(unlisted=True), "agent.explore_min_per_h, agent.look_when_exploring, items, things"),
    ):
        with pytest.raises(BadAnswer, match="of another run") as refused:
            runs.check(other.job, answer)
        assert refused.value.details["differ"] == differ


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"{}",
        gzip.compress(b"{}", mtime=0),
        gzip.compress(bytes(65 << 20)),
        gzip.compress(b"{}" * 99, mtime=0)[:10] + b"\xff" * 20,
    ],
)
def test_what_is_no_record_is_refused(answer: bytes) -> None:
    with pytest.raises(BadAnswer):
        record_of(answer)


@pytest.mark.parametrize("odd", [{"supply_end_iec": "y"}, {"days": 10**12}, {"wall_s": 0.0}])
def test_a_record_that_says_what_cannot_be_is_refused(tmp_path: Path, odd: dict[str, Any]) -> None:
    run = a_record(tmp_path, 1).model_copy(update=odd)
    with pytest.raises(BadAnswer):
        Runs(tmp_path).check(asked(seed=1).job, packed(run))


def test_the_interval_of_the_median_assumes_no_distribution() -> None:
    assert interval(range(1, 21)) == (6, 15)
    assert interval([3, 1, 2, 6, 5, 4]) == (1, 6)
    assert interval([1, 2, 3, 4, 5]) is None


def test_the_report_shows_each_setting_beside_the_paper(tmp_path: Path) -> None:
    found = [
        Found(name, a_run(seed=seed, wall_s=seed, days=days), [])
        for name, days in (("", 3), ("agent.charge_below = 0.4", 2))
        for seed in range(1, 8)
    ]
    write_study(found, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 2
    assert "<h2>agent.charge_below = 0.4</h2>" in page
    assert "14 runs of 2 site days or 3 site days." in page
    assert page.count("<td>cleaning_settled</td><td>51</td><td>2</td><td>2 to 2</td>") == 1
    assert page.count("<td>cleaning_settled</td><td></td>") == 1  # 51 are those of three days
    assert "<td>wall_s</td><td></td><td>4</td><td>1 to 7</td><td>1 to 7</td>" in page
    assert len(json.loads((tmp_path / "study.json").read_text())) == 14


def test_the_report_says_how_many_runs_have_a_quantity(tmp_path: Path) -> None:
    without = a_run(seed=1, events=[])
    write_study([Found("", one, []) for one in (without, a_run(seed=2), a_run(seed=3))], tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<td>gas_per_task_median (2 of 3 runs)</td>" in page
    assert "nan" not in page


def test_a_study_asks_for_each_run_once_and_not_again_when_it_is_repeated(tmp_path: Path) -> None:
    pool = Pool(tmp_path)

    def run() -> list[str]:
        study = Study(PAPER, tmp_path / "out", Variation(days=1), "", 3, ["agent.charge_below=0.5"], False)
        return study.run(lambda _: pool)

    problems = run()
    assert sorted(pool.asked) == [1, 2, 3]
    assert problems == [f"seed {seed}: 2 of 17 arrivals were posted" for seed in (1, 2, 3)]
    assert run() == problems
    assert len(pool.asked) == 3
