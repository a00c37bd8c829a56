"""Which forgeries pass without a check, on checks that are known by heart."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rodeo.checks.case import Case, Checks
from rodeo.checks.report import Check, Finding, Report
from rodeo.kinds import kinds_of
from rodeo_experiments.ablation import WITNESSES, Found, KindAblation, rests_on, write
from rodeo_testing.check import lab
from rodeo_testing.harness import Harness
from rodeo_testing.workshop import Submission


def speed(case: Case) -> Finding:
    return Finding(passed="speed" not in str(case))


def weight(case: Case) -> Finding:
    return Finding(passed="weight" not in str(case))


def colour(case: Case) -> Finding:
    assert "unreadable" not in str(case)  # `speed` passed
    return Finding(passed="colour" not in str(case))


CHECKS = Checks(stages=((speed, weight), (colour,)), recognizes=lambda _proof, _site: True)


class Shop:
    """A proof's URI names what is wrong with it."""

    noise = ""

    def judged(
        self, submission: Submission, checks_of: Callable[[Checks], Checks] = lambda one: one
    ) -> Report:
        found = [Check(name="readable_and_sealed", passed=True)]
        for stage in checks_of(CHECKS).stages:
            case: Any = f"{submission.uri} {self.noise}"
            found += [Check(name=one.__name__, **one(case).model_dump()) for one in stage]
            if any(one.passed is False for one in found):
                break
        return Report.of(found)

    def under_noise(self, seed: int) -> Shop:
        noisy = Shop()
        noisy.noise = "weight" if seed == 1 else ""
        return noisy

    def empty(self) -> None:
        pass


def ablation() -> KindAblation:
    shop: Any = Shop()
    harness: Harness[Any] = Harness(lambda _site, _folder: shop)
    nothing: Any = None

    def wrong(name: str, uri: str) -> None:
        def make(_shop: Any) -> Submission:
            return Submission(nothing, uri=uri)

        make.__name__ = name
        harness.forgery("speed", role="executor")(make)

    wrong("too_fast", "speed")
    wrong("too_fast_and_heavy", "speed weight")
    wrong("too_fast_and_blue", "speed colour")
    wrong("too_fast_and_unreadable", "speed unreadable")

    @harness.honest
    def honest(_shop: Any) -> Submission:
        return Submission(nothing, uri="nothing")

    site: Any = SimpleNamespace()
    return KindAblation("carrying", CHECKS, harness, site, Path())


def silent(_text: str, _share: float) -> None:
    pass


def test_a_forgery_passes_without_the_only_check_that_refuses_it() -> None:
    one = ablation()
    assert one.forge(["too_fast", "too_fast_and_heavy", "too_fast_and_blue"], silent) == 3
    parts = {part.name: part for part in one.parts()}
    assert parts["speed"].passing == ["too_fast"]
    assert parts["speed"].decides == 2  # without it, the one that is blue is refused by the next stage
    assert parts["weight"].decides == 0
    everything = next(part for part in one.parts() if len(part.checks) == 3)
    assert everything.passing == ["too_fast", "too_fast_and_heavy", "too_fast_and_blue"]


def test_a_forgery_on_which_a_later_check_cannot_do_without_an_earlier_one_does_not_pass() -> None:
    one = ablation()
    one.forge(["too_fast_and_unreadable"], silent)
    assert {part.name: part.passing for part in one.parts()}["speed"] == []


def test_a_noisy_honest_run_returns_without_the_check_that_refuses_it() -> None:
    one = ablation()
    assert one.be_honest(2, silent) == 2
    parts = {part.name: part for part in one.parts()}
    assert (parts["weight"].refused, parts["weight"].returning) == (["honest 1"], ["honest 1"])
    assert parts["colour"].refused == []
    assert parts["speed"].seconds > 0


def test_a_witness_is_off_with_every_check_that_reads_it() -> None:
    kinds = kinds_of(lab())
    resting = {
        witness: {
            check.__name__
            for kind in kinds.values()
            if kind.checks
            for stage in kind.load_checks().stages
            for check in stage
            if rests_on(check, words)
        }
        for witness, words in WITNESSES.items()
    }
    assert {"motion_capture", "item_in_gripper", "item_outside_bin"} <= resting["motion capture"]
    assert {"bin_witnessed", "classified", "dropped", "weight"} <= resting["bin"]
    assert {"gripper_force", "gripper_commanded", "grasp"} <= resting["gripper"]
    assert {"both_signed", "delivered", "power"} <= resting["meter receipts"]
    assert not {"base_speed", "within_counts", "sealed"} & set().union(*resting.values())


def test_the_report_names_what_passes(tmp_path: Path) -> None:
    one = ablation()
    one.forge(["too_fast"], silent)
    write(Found(one.parts(), 1, 0, 1.0), tmp_path)
    found = json.loads((tmp_path / "results.json").read_text())
    assert next(part for part in found["parts"] if part["part"] == "speed")["forgeries_passing"] == [
        "too_fast"
    ]
    assert "too_fast" in (tmp_path / "report.md").read_text()
    assert "<svg" in (tmp_path / "report.html").read_text()
