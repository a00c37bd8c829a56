"""Cleaning: an item ends in the compartment that the bin names, whatever slips, blocks or stops."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rodeo.config import Site
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import GRIPPER_OPEN_M
from services.robot_agent.arm import Arm
from services.robot_agent.cleaning import Cleaning, Where
from services.robot_agent.errors import Stopped, TaskFailed
from services.robot_agent.navigation import Floor
from tests.support.site import LAB
from tests.unit.services.robot_agent.fakes import AnsweringBin, KinematicBody, ManualClock

ITEMS = [item.id for item in Site.load(LAB).items]


class Scene:
    def __init__(self, compartment: str = "yellow") -> None:
        self.site = Site.load(LAB)
        self.clock = ManualClock()
        self.body = KinematicBody(self.site, self.clock)
        self.bin = AnsweringBin(self.clock, compartment)
        self.notes: list[dict[str, Any]] = []
        self.progress: list[float] = []
        self.cleaning = Cleaning(
            self.site,
            self.body,  # type: ignore[arg-type]
            Arm(self.site.robots[0].limits),
            Floor(self.site),
            self.bin,  # type: ignore[arg-type]
            self.clock,
            threading.Event(),
        )

    @property
    def events(self) -> list[str]:
        return [note["event"] for note in self.notes]

    def dispose(self, item: str = "item1", checkpoint: Any = lambda: None, resumed: bool = False) -> None:
        self.cleaning.dispose(
            item,
            self.clock.now_s(),
            checkpoint,
            lambda text, share: self.progress.append(share),
            self.notes.append,
            resumed,
        )


@pytest.mark.parametrize("item", ITEMS)
@pytest.mark.parametrize("compartment", ["blue", "yellow", "green", "grey"])
def test_an_item_ends_in_the_compartment_that_the_bin_names(item: str, compartment: str) -> None:
    scene = Scene(compartment)
    scene.dispose(item)
    assert scene.body.dropped_in == compartment
    assert scene.body.gripper_m == GRIPPER_OPEN_M
    assert scene.events == ["released"]
    assert scene.progress == sorted(scene.progress)


def test_the_robot_leaves_the_bin_when_it_is_done() -> None:
    scene = Scene()
    scene.dispose()
    scene.cleaning.clear_the_bin(lambda: None)
    parking = BinLayout(scene.site.bin).parking
    assert parking in scene.body.drives
    assert Floor(scene.site).clearance_m(scene.body.base.x_m, scene.body.base.y_m) > 0.6


def test_a_grasp_that_slips_is_tried_again() -> None:
    scene = Scene()
    scene.body.slips = 2
    scene.dispose()
    assert scene.body.dropped_in == "yellow"
    assert scene.events == ["retry", "retry", "released"]
    assert [note["code"] for note in scene.notes[:2]] == ["grasp_failed", "grasp_failed"]


def test_grasps_that_keep_slipping_fail_the_task_with_the_cause() -> None:
    scene = Scene()
    scene.body.slips = 99
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "grasp_failed"
    assert scene.body.dropped_in is None


def test_a_blocked_way_is_answered_with_another_place_to_stand() -> None:
    scene = Scene()
    scene.body.blocked = 2
    scene.dispose()
    assert scene.body.dropped_in == "yellow"


def test_a_bin_that_says_nothing_is_shown_the_item_again() -> None:
    scene = Scene()
    scene.bin.silent = 2
    scene.dispose()
    assert scene.body.dropped_in == "yellow"


@pytest.mark.parametrize(
    ("unsure", "shown", "compartment"), [(1, 2, "yellow"), (2, 3, "yellow"), (9, 3, "grey")]
)
def test_what_the_bin_does_not_know_is_shown_from_other_sides_before_grey_is_chosen(
    unsure: int, shown: int, compartment: str
) -> None:
    scene = Scene()
    scene.bin.unsure = unsure
    scene.dispose()
    assert (scene.bin.shown, scene.body.dropped_in) == (shown, compartment)


def test_nothing_is_dropped_into_a_full_compartment() -> None:
    scene = Scene()
    scene.bin.full = True
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["compartment"] == "yellow"
    assert scene.body.dropped_in is None


def test_a_bin_that_never_answers_fails_the_task_with_the_item_still_held() -> None:
    scene = Scene()
    scene.bin.silent = 999
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "no_answer"
    assert scene.body.held == "item1"


def test_a_missing_confirmation_goes_on_record() -> None:
    scene = Scene()
    scene.bin.disposals = False
    scene.dispose()
    assert scene.events == ["released", "unconfirmed"]


def test_the_arm_keeps_still_until_the_bin_has_spoken_of_the_drop() -> None:
    scene = Scene()
    heard: list[str] = []
    heard_before_motion: list[bool] = []
    follow = scene.body.follow

    def watched(plan: Any, checkpoint: Any) -> None:
        if scene.body.dropped_in:
            heard_before_motion.append("disposal" in heard)
        follow(plan, checkpoint)

    scene.bin.on_wait = heard.append
    scene.body.follow = watched  # type: ignore[method-assign]
    scene.dispose()
    assert heard_before_motion
    assert all(heard_before_motion)


def test_an_item_that_is_in_the_bin_already_fails_the_task_without_a_motion() -> None:
    scene = Scene()
    scene.dispose()
    drives = list(scene.body.drives)
    with pytest.raises(TaskFailed, match="already in the bin"):
        scene.dispose()
    assert scene.body.drives == drives


def test_a_robot_that_is_not_at_the_bin_need_not_clear_it() -> None:
    scene = Scene()
    scene.cleaning.clear_the_bin(lambda: None)
    assert scene.body.drives == []


def test_an_unknown_item_fails_the_task() -> None:
    with pytest.raises(TaskFailed) as caught:
        Scene().dispose("item99")
    assert caught.value.details == {"item": "item99"}


@pytest.mark.parametrize("steps", range(2, 60, 4))
def test_work_goes_on_after_being_stopped_anywhere(steps: int) -> None:
    scene = Scene()
    left = steps

    def stop_after_a_while() -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise Stopped("the process is asked to end")

    try:
        scene.dispose(checkpoint=stop_after_a_while)
    except Stopped:
        scene.dispose(resumed=True)
    assert scene.body.dropped_in == "yellow"


def test_a_held_item_is_seen_as_held() -> None:
    scene = Scene()
    item = scene.cleaning.item("item1")
    assert scene.cleaning.where(item, lambda: None) == Where.FLOOR
    scene.bin.silent = 999
    with pytest.raises(TaskFailed):
        scene.dispose()
    assert scene.cleaning.where(item, lambda: None) == Where.HELD


@pytest.mark.parametrize("item", ITEMS)
def test_a_held_item_can_be_put_back_where_it_lay_and_taken_again(item: str) -> None:
    scene = Scene()
    pose = scene.cleaning.item(item).pose
    scene.bin.silent = 999
    with pytest.raises(TaskFailed):
        scene.dispose(item)
    scene.cleaning.put_back(item, (pose.x_m, pose.y_m), lambda: None)
    assert scene.cleaning.where(scene.cleaning.item(item), lambda: None) == Where.FLOOR
    assert scene.body.items[item].position_m[:2] == pytest.approx((pose.x_m, pose.y_m), abs=0.02)
    scene.bin.silent = 0
    scene.dispose(item)
    assert scene.body.dropped_in == "yellow"
