"""A place instead of an item: which tasks name one, and what a robot may note about what lay there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from pydantic import ValidationError

from rodeo.checks.case import Case
from rodeo.errors import InvalidRequest
from rodeo.kinds import kinds_of
from rodeo.lab.config import ItemClass, Pose2
from rodeo.lab.items import MeasuredItem, shape_of
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.checks import CHECKS, found
from rodeo_kinds.waste_disposal.found import Found
from rodeo_kinds.waste_disposal.harness.places import PLACES
from rodeo_kinds.waste_disposal.params import doubt, problems
from tests.support.site import LAB

HERE: dict[str, Any] = {"x_m": 5.4, "y_m": 1.0}


def case(params: dict[str, Any] | None, *events: dict[str, Any], mocap: bool = True) -> Case:
    record = None if params is None else SimpleNamespace(task=SimpleNamespace(params=params))
    lab = SimpleNamespace(mocap=mocap)
    proof = SimpleNamespace(events=lambda: list(events))
    return Case(cast(Any, proof), cast(Any, SimpleNamespace(lab=lab)), cast(Any, record), "k", CHECKS)


@pytest.mark.parametrize(
    ("asked", "unmarked"),
    [
        (case(HERE), True),
        (case(HERE | {"item_id": ""}), True),
        (case(HERE | {"item_id": "item1"}), False),
        (case(None, {"event": "found"}), True),
        (case(None, {"event": "releasing"}), False),
        (case(HERE, mocap=False), False),
    ],
)
def test_a_thing_has_no_markers_where_the_task_names_no_item(asked: Case, unmarked: bool) -> None:
    assert asked.unmarked == unmarked


@pytest.mark.parametrize(
    "asked", [found.described, found.taken_there, found.not_listed, found.released_there, found.proposal]
)
def test_what_is_asked_of_places_is_not_asked_of_items(asked: Any) -> None:
    assert asked(case(HERE | {"item_id": "item1"})).passed is None


@pytest.mark.parametrize(
    "changes",
    [
        {"size_m": (0.1, 0.05)},
        {"size_m": (0.1, 0.05, 0.5)},
        {"size_m": (0.1, 0.05, float("nan"))},
        {"weight_n": 0.0},
        {"weight_n": float("inf")},
        {"weight_n": "0.4"},
    ],
)
def test_a_note_describes_only_what_a_gripper_can_have_found(changes: dict[str, Any]) -> None:
    honest: dict[str, Any] = {"size_m": (0.1, 0.05, 0.06), "weight_n": 0.4}
    assert Found(**honest).note()["event"] == "found"
    with pytest.raises(ValidationError):
        Found(**honest | changes)


def test_a_measured_item_is_a_box_of_its_extents() -> None:
    item = MeasuredItem(
        id="found",
        item_class=ItemClass.CARDBOARD,
        shape="box",
        pose=Pose2(x_m=1.0, y_m=1.0),
        size_m=(0.1, 0.05, 0.06),
        mass_kg=1.5,
    )
    assert shape_of(item).half_m == (0.05, 0.025, 0.03)


def test_a_place_is_enough_where_motion_capture_sees_a_gripper() -> None:
    site = Site.load(LAB)
    assert problems(site, HERE) == {}
    assert list(problems(site.model_copy(update={"robots": []}), HERE)) == ["item_id"]
    blind = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap_gripper": False})})
    assert list(problems(blind, HERE)) == ["item_id"]


def test_a_task_that_nobody_could_prove_is_refused_before_it_locks_a_reward() -> None:
    site = Site.load(LAB)
    blind = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap_gripper": False})})
    for params in (HERE, HERE | {"item_id": ""}):
        with pytest.raises(InvalidRequest) as refused:
            kinds_of(blind).completed("waste_disposal", params)
        assert list(refused.value.details["fields"]) == ["item_id"]
    listed = kinds_of(blind).completed("waste_disposal", {"item_id": "item1"})
    assert listed == {"item_id": "item1", "x_m": 4.6, "y_m": 1.2}


def test_nothing_is_known_of_what_lies_at_a_place() -> None:
    assert doubt(HERE, []) == ""


def test_there_are_enough_forgeries_of_a_place() -> None:
    assert len(PLACES) >= 25
