"""`rodeo kind`: what is installed, what a site uses, what a check ends with, and what a new kind is."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from rodeo_cli import app, kinds
from rodeo_testing import check
from rodeo_testing.check import Outcome
from tests.support.site import LAB

SHIPPED = ["battery_charging", "waste_disposal"]


def said(*words: str, status: int = 0) -> str:
    done = CliRunner().invoke(app, ["kind", *words])
    assert done.exit_code == status, done.output
    return done.stdout


def entries(site: Path) -> dict[str, dict[str, object]]:
    return {one["name"]: one for one in json.loads(said("list", "--json", "--site", str(site)))["kinds"]}


def test_every_installed_kind_is_listed_without_a_site_file(tmp_path: Path) -> None:
    found = entries(tmp_path / "none.toml")
    assert set(found) >= set(SHIPPED)
    assert {one["used_by_site"] for one in found.values()} == {None}
    assert all(found[name]["installed"] for name in SHIPPED)


def test_a_listing_says_which_kinds_the_site_uses_and_has_those_that_it_declares(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(
        f"extends = {json.dumps(str(LAB))}\n"
        '[[kinds]]\nname = "waste_disposal"\n'
        '[[kinds]]\nname = "water_plants"\ntitle = "Water the plants"\njudge = "auditor"\n'
        "[agent]\nmaintenance = []\n"
    )
    found = entries(path)
    assert {
        name: one["used_by_site"] for name, one in found.items() if name in (*SHIPPED, "water_plants")
    } == {
        "waste_disposal": True,
        "battery_charging": False,
        "water_plants": True,
    }
    assert (found["water_plants"]["installed"], found["water_plants"]["judged_by"]) == (False, "auditor")


def test_show_has_the_parameters_and_the_checks_in_order() -> None:
    shown = json.loads(said("show", "waste_disposal", "--json"))
    assert {"item_id", "x_m", "y_m"} <= set(shown["parameters"]["properties"])
    names = [one["name"] for one in shown["checks"]]
    assert names.index("task_binding") < names.index("witnessed") < names.index("dropped")
    assert all(one["asks"] and one["source"] for one in shown["checks"])
    assert {one["signed_by"] for one in shown["recorded"]} == {
        "the executor's seals",
        "mocap",
        "bin",
        "robot",
    }
    assert {"{ns}/odom", "{ns}/joint_states"} <= {one["topic"] for one in shown["recorded"]}
    text = said("show", "waste_disposal")
    assert "Waste disposal" in text and "task_binding" in text
    assert (shown["current_rules"], shown["installed_is_current"]) == (None, None)
    assert "unknown: no site answers" in text


def test_a_kind_that_is_not_installed_is_refused() -> None:
    said("show", "no_such_kind", status=1)
    said("check", "no_such_kind", status=1)


@pytest.mark.parametrize("passed", [True, False])
def test_the_exit_status_is_0_only_if_all_is_as_expected(
    monkeypatch: pytest.MonkeyPatch, passed: bool
) -> None:
    outcomes = [
        Outcome("a_run", "honest run", "accepted", True, "accepted", True, 0.1),
        Outcome("a_forgery", "forgery", "stayed", not passed, "stayed: too short", passed, 0.1),
    ]
    monkeypatch.setattr(kinds, "load", lambda _name: SimpleNamespace(load_harness=lambda: object()))
    monkeypatch.setattr(check, "outcomes", lambda *_: iter(outcomes))
    document = json.loads(said("check", "any", "--json", status=0 if passed else 1))
    assert document["passed"] is passed
    assert [one["name"] for one in document["outcomes"]] == ["a_run", "a_forgery"]
    assert ("WRONG" in said("check", "any", status=0 if passed else 1)) is not passed


def test_a_check_of_nothing_does_not_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kinds, "load", lambda _name: SimpleNamespace(load_harness=lambda: object()))
    monkeypatch.setattr(check, "outcomes", lambda *_: iter(()))
    said("check", "any", status=1)
    monkeypatch.setattr(kinds, "load", lambda _name: SimpleNamespace(load_harness=lambda: None))
    said("check", "any", status=1)


def test_a_new_kind_is_a_package_under_its_own_name(tmp_path: Path) -> None:
    into = tmp_path / "door"
    said("new", "inspect_door", "--into", str(into))
    files = {str(path.relative_to(into)): path for path in into.rglob("*") if path.is_file()}
    assert {"pyproject.toml", "inspect_door/__init__.py", "tests/test_inspect_door.py"} <= set(files)
    for path in files.values():
        text = path.read_text()
        assert not any(word in text for word in ("visit_place", "VisitPlace", "Visit place", "visit-place"))
        if path.suffix == ".py":
            compile(text, str(path), "exec")


@pytest.mark.parametrize("name", ["Inspect", "9doors", "inspect-door", "../door", "a" * 32, ""])
def test_a_name_that_is_no_kinds_is_refused(tmp_path: Path, name: str) -> None:
    said("new", "--into", str(tmp_path / "door"), "--", name, status=1)
    assert not (tmp_path / "door").exists()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    said("new", "inspect_door", "--into", str(tmp_path), status=1)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
