"""Cleaning: an item ends in the compartment that the bin names, whatever slips, blocks or stops."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rodeo.evidence.recorder import Recorder
from rodeo.lab.config import Pose2
from rodeo.lab.drop import JUDGED_AFTER_DROP_S, RECORDED_AFTER_DROP_S
from rodeo.lab.items import shape_of
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import GRIPPER_CLOSED_M, GRIPPER_OPEN_M
from rodeo.robot import bin as bin_module
from rodeo.robot.behaviour import Estimate, Robot, Work
from rodeo.robot.bin import SmartBin
from rodeo.robot.errors import GraspFailed, MotionFailed, Stopped, TaskFailed
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import Sighting
from rodeo.site.config import Site
from rodeo.witness.statement import Classification, Drop
from rodeo_kinds.waste_disposal import delivery
from rodeo_kinds.waste_disposal.behaviour import WasteDisposal, ordered
from rodeo_kinds.waste_disposal.found import Found
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_kinds.waste_disposal.place import JUDGED_LIMIT_M, TAKEN_LIMIT_M
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Sample, Take
from tests.support.site import LAB
from tests.unit.robot.fakes import (
    CLAIMANT,
    AnsweringBin,
    BinBus,
    KinematicBody,
    ManualClock,
    Notes,
    Pose3,
    RayCamera,
    SeenBook,
    Voice,
    manipulator,
)

MOMENT = Take([Sample("", "", None, 1_900_000_000 * 10**9)])
ITEMS = [item.id for item in Site.load(LAB).items]


class Scene:
    def __init__(self, folder: Path, compartment: str = "yellow", bus: BinBus | None = None) -> None:
        self.site = Site.load(LAB)
        self.clock = ManualClock()
        self.body = KinematicBody(self.site, self.clock)
        self.camera = RayCamera(self.body)
        self.bin = AnsweringBin(self.clock, compartment, self.body.interrupts)
        self.memory = Memory(self.site, folder / "memory.json")
        self.record = Notes(self.body.interrupts)
        self.progress: list[float] = []
        self.sightings: list[Sighting] = []
        self.hands = manipulator(self.site, self.body, self.camera, self.memory)
        smart_bin: Any = self.bin
        nothing_seen: Any = SeenBook(self.clock)
        if bus is not None:
            real: Any = bus, self.site, "itrash", self.clock, Voice(folder, bus), self.body.interrupts
            smart_bin = SmartBin(*real)
        self.cleaning = WasteDisposal(
            Robot(
                "panther1",
                self.site,
                self.hands,
                Floor(self.site),
                self.memory,
                {"itrash": smart_bin},
                self.clock,
                self.sightings.append,
                lambda way_m, ends_at: Estimate(way_m, way_m, ends_at),
                nothing_seen,
            )
        )

    @property
    def work(self) -> Work:
        return Work(
            cleaning_chain_record(MOMENT).task, self.record, lambda _text, share: self.progress.append(share)
        )

    @property
    def events(self) -> list[str]:
        return [note["event"] for note in self.record.notes]

    def place(self, item: str) -> tuple[float, float]:
        """Where the site file says that it lies; that of the first one without a name."""
        item = item or ITEMS[0]
        pose = next((i.pose for i in self.site.items if i.id == item), self.site.robots[0].pose)
        return pose.x_m, pose.y_m

    def dispose(self, item: str = "item1", off_m: float = 0.0) -> None:
        """With a place that is `off_m` from where the item lies."""
        x_m, y_m = self.place(item)
        self.cleaning.dispose(
            item,
            (x_m + off_m, y_m),
            self.cleaning.stations,
            self.work,
        )


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("item", ITEMS)
@pytest.mark.parametrize("compartment", ["blue", "yellow", "green", "grey"])
def test_an_item_ends_in_the_compartment_that_the_bin_names(
    tmp_path: Path, item: str, compartment: str
) -> None:
    scene = Scene(tmp_path, compartment)
    scene.dispose(item)
    assert scene.body.dropped_in == compartment
    assert scene.body.gripper_m == GRIPPER_OPEN_M
    assert scene.events == ["releasing", "released"]
    assert scene.progress == sorted(scene.progress)


def test_the_robot_leaves_the_bin_when_it_is_done(scene: Scene) -> None:
    scene.dispose()
    scene.cleaning.tidy()
    parking = BinLayout(scene.site.bins[0]).parking
    assert parking in scene.body.drives
    assert Floor(scene.site).clearance_m(scene.body.base.x_m, scene.body.base.y_m) > 0.6


def test_a_grasp_that_slips_is_tried_again(scene: Scene) -> None:
    scene.body.slips = 2
    scene.dispose()
    assert scene.body.dropped_in == "yellow"
    assert scene.events == ["retry", "retry", "releasing", "released"]
    assert [note["code"] for note in scene.record.notes[:2]] == ["grasp_failed", "grasp_failed"]


def test_grasps_that_keep_slipping_fail_the_task_with_the_cause(scene: Scene) -> None:
    scene.body.slips = 99
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "grasp_failed"
    assert scene.body.dropped_in is None


def test_a_blocked_way_is_answered_with_another_place_to_stand(scene: Scene) -> None:
    scene.body.blocked = 2
    scene.dispose()
    assert scene.body.dropped_in == "yellow"


def test_a_robot_that_stands_in_the_way_for_minutes_costs_no_retry(scene: Scene) -> None:
    scene.body.blocked = 20
    scene.dispose()
    assert scene.body.dropped_in == "yellow"
    assert "retry" not in [note["event"] for note in scene.record.notes]


def test_a_way_that_stays_blocked_fails_the_task_once_patience_ends(scene: Scene) -> None:
    scene.body.blocked = 999
    start_s = scene.body.clock.now_s()
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "blocked"
    assert scene.body.clock.now_s() - start_s < 600


def test_a_bin_that_says_nothing_is_shown_the_item_again(scene: Scene) -> None:
    scene.bin.silent = 2
    scene.dispose()
    assert scene.body.dropped_in == "yellow"


@pytest.mark.parametrize(("wondering", "shown"), [(0, 1), (1, 2), (9, 3)])
def test_the_bin_is_shown_the_other_angles_that_it_asks_for(scene: Scene, wondering: int, shown: int) -> None:
    scene.bin.wondering = wondering
    scene.dispose()
    assert (scene.bin.shown, scene.body.dropped_in) == (shown, "yellow")


@pytest.mark.parametrize(
    ("unsure", "shown", "compartment"), [(1, 2, "yellow"), (2, 3, "yellow"), (9, 3, "grey")]
)
def test_what_the_bin_does_not_know_is_shown_from_other_sides_before_grey_is_chosen(
    scene: Scene, unsure: int, shown: int, compartment: str
) -> None:
    scene.bin.unsure = unsure
    scene.dispose()
    assert (scene.bin.shown, scene.body.dropped_in) == (shown, compartment)


def test_the_robot_presents_itself_before_each_showing(scene: Scene) -> None:
    scene.bin.unsure = 1
    scene.dispose()
    assert scene.bin.presented == [CLAIMANT, CLAIMANT]


def test_the_robot_tells_the_bin_of_each_grasp_when_it_was(scene: Scene) -> None:
    scene.bin.wondering = 1
    scene.dispose()
    first, again = scene.bin.grasps_s
    held = scene.memory.held
    assert first == again and held is None
    scene.body.dropped_in = None
    scene.dispose("item2")
    assert scene.bin.grasps_s[-1] > first > 0


def test_what_the_bin_names_with_pictures_from_before_the_grasp_is_shown_again(scene: Scene) -> None:
    scene.bin.combining = [0.0]
    scene.dispose()
    assert (scene.bin.shown, scene.body.dropped_in) == (2, "yellow")


def test_nothing_is_dropped_while_the_bin_names_pictures_from_before_the_grasp(scene: Scene) -> None:
    scene.bin.combining = [0.0] * 99
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "no_answer"
    assert scene.body.dropped_in is None


def test_what_the_bin_takes_for_somebody_elses_is_shown_again(scene: Scene) -> None:
    scene.bin.mistaken = 2
    scene.dispose()
    assert (scene.bin.shown, scene.body.dropped_in) == (3, "yellow")


def test_nothing_is_dropped_while_the_bin_names_another_claimant(scene: Scene) -> None:
    scene.bin.mistaken = 999
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "no_answer"
    assert (scene.body.held, scene.body.dropped_in) == ("item1", None)


def test_the_item_is_not_touched_before_a_witness_knows_of_the_recording(scene: Scene) -> None:
    scene.record.deaf = 999
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "no_answer"
    assert scene.memory.held is None
    assert scene.body.items["item1"].position_m[:2] == pytest.approx(scene.place("item1"), abs=1e-9)


def test_a_witness_that_is_late_is_waited_for(scene: Scene) -> None:
    scene.record.deaf = 1
    scene.dispose()
    assert (scene.record.awaited, scene.body.dropped_in) == (["item1", "item1"], "yellow")


def test_the_robot_leaves_the_bin_and_records_on_for_longer_than_the_oracle_asks_for(scene: Scene) -> None:
    dropped_s: list[float] = []
    scene.bin.on_wait = lambda kind: dropped_s.append(scene.clock.now_s()) if kind is Drop else None
    scene.dispose()
    assert scene.clock.now_s() - dropped_s[-1] >= JUDGED_AFTER_DROP_S + 4.5
    base, parking = scene.body.base, BinLayout(scene.site.bins[0]).parking
    assert math.dist((base.x_m, base.y_m), (parking.x_m, parking.y_m)) > 0.5


@pytest.mark.parametrize(("left_s", "waits_s"), [(None, 300.0), (5_000.0, 300.0), (200.0, 80.0)])
def test_a_motion_capture_that_fell_silent_after_the_drop_is_waited_for_within_the_execution_window(
    scene: Scene, left_s: float | None, waits_s: float
) -> None:
    scene.record.blind = True
    (station,) = scene.cleaning.stations
    # The bin speaks at once, and the clock passes only while the robot waits.
    dropped_s = scene.clock.now_s()
    stops_s = dropped_s + RECORDED_AFTER_DROP_S
    deadline = None if left_s is None else stops_s + left_s
    task = scene.work.task.model_copy(update={"execution_deadline": deadline})
    scene.cleaning.delivery.finish(dropped_s - 1.0, station, 1.0, replace(scene.work, task=task))
    ((after_s, latest_s),) = scene.record.motion_s
    assert after_s == pytest.approx(dropped_s + JUDGED_AFTER_DROP_S, abs=0.1)
    assert latest_s == pytest.approx(stops_s + waits_s, abs=0.1)
    assert scene.events == ["unwitnessed"]


def test_what_is_taken_out_after_the_drop_is_not_submitted_as_done(scene: Scene) -> None:
    scene.bin.thefts = 1
    with pytest.raises(TaskFailed, match="was not found near"):
        scene.dispose()
    assert [note.get("code") for note in scene.record.notes if note["event"] == "retry"] == ["taken_out"]


def test_what_was_taken_out_during_an_interruption_fails_the_task(scene: Scene) -> None:
    scene.bin.thefts = 1
    with pytest.raises(TaskFailed) as caught:
        (station,) = scene.cleaning.stations
        scene.cleaning.confirm(900.0, station, scene.work)
    assert caught.value.details["cause"] == "taken_out"


def test_nothing_is_dropped_into_a_full_compartment(scene: Scene) -> None:
    scene.bin.full = {"yellow"}
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["compartment"] == "yellow"
    assert scene.body.dropped_in is None


def test_another_view_is_shown_although_the_compartment_for_the_unknown_is_full(scene: Scene) -> None:
    scene.bin.unsure, scene.bin.full = 1, {"grey"}
    scene.dispose()
    assert (scene.bin.shown, scene.body.dropped_in) == (2, "yellow")


def test_a_bin_that_never_answers_fails_the_task_with_the_item_still_held(scene: Scene) -> None:
    scene.bin.silent = 999
    with pytest.raises(TaskFailed) as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "no_answer"
    assert scene.body.held == "item1"


def test_a_missing_confirmation_goes_on_record(scene: Scene) -> None:
    scene.bin.disposals = False
    scene.dispose()
    assert scene.events == ["releasing", "released", "unconfirmed"]


def test_the_arm_keeps_still_until_the_bin_has_spoken_of_the_drop(scene: Scene) -> None:
    heard: list[type] = []
    heard_before_motion: list[bool] = []
    follow = scene.body.follow

    def watched(plan: Any) -> None:
        if scene.body.dropped_in:
            heard_before_motion.append(Drop in heard)
        follow(plan)

    scene.bin.on_wait = heard.append
    scene.body.follow = watched  # type: ignore[method-assign]
    scene.dispose()
    assert heard_before_motion
    assert all(heard_before_motion)


def test_an_arm_that_is_stopped_after_the_release_costs_neither_the_drop_nor_the_task(scene: Scene) -> None:
    follow, stopped = scene.body.follow, [MotionFailed("the arm did not follow", action="arm")]

    def stopped_once(plan: Any) -> None:
        if scene.body.dropped_in and stopped:
            raise stopped.pop()
        follow(plan)

    scene.body.follow = stopped_once  # type: ignore[method-assign]
    scene.dispose()
    assert not stopped
    assert scene.body.dropped_in == "yellow"
    assert scene.events == ["releasing", "released", "retry"]
    scene.cleaning.tidy()


def test_an_item_that_is_not_there_fails_the_task_after_a_look_from_two_sides(scene: Scene) -> None:
    scene.camera.blind = True
    with pytest.raises(TaskFailed, match="was not found near") as caught:
        scene.dispose()
    assert caught.value.details["cause"] == "not_found"
    first, second = scene.body.drives
    assert abs(first.yaw_rad - second.yaw_rad) > 1.0
    assert scene.body.gripper_m == GRIPPER_OPEN_M


@pytest.mark.parametrize("off_m", [-0.3, 0.3])
def test_the_place_that_the_task_names_is_right_only_roughly(scene: Scene, off_m: float) -> None:
    scene.dispose(off_m=off_m)
    assert scene.body.dropped_in == "yellow"


@pytest.mark.parametrize("off_m", [-0.33, 0.33, 0.37])
def test_an_item_that_is_seen_further_off_than_would_be_paid_for_is_not_touched(
    scene: Scene, off_m: float
) -> None:
    with pytest.raises(TaskFailed, match="too far from the task's place") as caught:
        scene.dispose(off_m=off_m)
    assert caught.value.details["cause"] == "not_found"
    assert caught.value.details["away_m"] == pytest.approx(abs(off_m), abs=0.01)
    assert (scene.body.held, scene.body.dropped_in, scene.sightings) == (None, None, [])


def test_the_oracle_allows_more_than_the_robot_takes() -> None:
    assert TAKEN_LIMIT_M + 0.03 <= JUDGED_LIMIT_M


def test_an_item_far_from_the_place_is_not_taken(scene: Scene) -> None:
    with pytest.raises(TaskFailed, match="was not found near"):
        scene.dispose(off_m=-1.2)
    assert scene.body.held is None


def test_another_item_at_the_place_is_not_mistaken_for_the_one_that_is_meant(scene: Scene) -> None:
    # The can's place with the bottle on it, and the can nowhere.
    x_m, y_m = scene.place("item1")
    bottle = scene.body.items["item2"]
    scene.body.items["item2"] = Pose3((x_m, y_m, bottle.position_m[2]), bottle.quat_wxyz)
    scene.body.items["item1"] = Pose3((6.0, 4.0, 0.05), scene.body.items["item1"].quat_wxyz)
    with pytest.raises(TaskFailed, match="was not found near"):
        scene.dispose()


@pytest.fixture
def anything(tmp_path: Path) -> Scene:
    """A lab whose items the robot does not know."""
    scene = Scene(tmp_path)
    site = scene.site.model_copy(update={"items": []})
    memory = Memory(site, tmp_path / "nothing.json")
    hands = manipulator(scene.site, scene.body, scene.camera, memory)
    scene.cleaning = WasteDisposal(replace(scene.cleaning.robot, site=site, body=hands, memory=memory))
    return scene


@pytest.mark.parametrize("item", ITEMS)
def test_whatever_lies_at_a_place_is_taken_measured_and_weighed(anything: Scene, item: str) -> None:
    anything.cleaning.dispose("", anything.place(item), anything.cleaning.stations, anything.work)
    assert (anything.body.dropped_in, anything.record.awaited) == ("yellow", ["panther1/gripper"])
    assert anything.events == ["found", "releasing", "released"]
    assert anything.record.pictures == ["before", "grip", "after"]
    listed = next(one for one in anything.site.items if one.id == item)
    noted, half = Found.model_validate_json(json.dumps(anything.record.notes[0])), shape_of(listed).half_m
    assert noted.weight_n == pytest.approx(9.81 * listed.mass_kg, rel=0.05)
    assert sorted(noted.size_m) == pytest.approx(sorted(2 * one for one in half), abs=0.02)
    assert noted.size_m[1] / 2 == pytest.approx(half[1], abs=0.01)


def test_a_wrist_without_colour_costs_nothing_but_the_pictures(anything: Scene) -> None:
    anything.camera.colourless = True
    anything.cleaning.dispose("", anything.place("item1"), anything.cleaning.stations, anything.work)
    assert (anything.body.dropped_in, anything.record.pictures) == ("yellow", [])


def test_an_item_of_the_site_is_not_taken_for_whatever_lies_at_a_place(scene: Scene) -> None:
    with pytest.raises(TaskFailed, match="was not found near"):
        scene.dispose("")
    assert scene.body.held is None


def test_an_item_that_somebody_carried_away_is_not_taken_for_whatever_lies_there(scene: Scene) -> None:
    place = scene.place("item1")
    scene.cleaning.robot.memory.saw("item1", (6.0, 4.0))
    scene.record.places["item1"] = place
    with pytest.raises(TaskFailed, match="an item of the site lies there"):
        scene.dispose("")
    assert scene.body.held is None
    del scene.record.places["item1"]
    scene.dispose("")
    assert scene.body.dropped_in == "yellow"


def test_a_task_by_place_is_given_back_where_it_cannot_be_proven(scene: Scene) -> None:
    task = cleaning_chain_record(MOMENT, {"x_m": 4.6, "y_m": 1.2}).task
    assert scene.cleaning.weigh(task, scene.body.base).duration_s > 0
    lab = scene.site.lab.model_copy(update={"mocap_gripper": False})
    blind = WasteDisposal(replace(scene.cleaning.robot, site=scene.site.model_copy(update={"lab": lab})))
    with pytest.raises(TaskFailed, match="without markers"):
        blind.weigh(task, scene.body.base)


def test_a_robot_that_is_not_at_the_bin_need_not_clear_it(scene: Scene) -> None:
    scene.cleaning.tidy()
    assert scene.body.drives == []


def test_an_unknown_item_fails_the_task(scene: Scene) -> None:
    with pytest.raises(TaskFailed) as caught:
        scene.dispose("item99")
    assert caught.value.details == {"item": "item99"}


@pytest.mark.parametrize("steps", range(2, 90, 8))
def test_work_goes_on_after_being_stopped_anywhere(scene: Scene, steps: int) -> None:
    left = steps

    def stop_after_a_while() -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise Stopped("the process is asked to end")

    try:
        with scene.body.interrupts.also(stop_after_a_while):
            scene.dispose()
    except Stopped:
        if "releasing" not in scene.events:
            scene.dispose()
    assert scene.body.dropped_in == "yellow"


def test_what_is_held_is_felt_and_remembered(scene: Scene) -> None:
    assert scene.hands.held() is None
    scene.bin.silent = 999
    with pytest.raises(TaskFailed):
        scene.dispose()
    held = scene.hands.held()
    assert held is not None
    assert held.item_id == "item1"
    assert held.place_m == pytest.approx(scene.place("item1"), abs=0.01)


def test_what_is_lost_while_it_is_held_ends_a_wait_and_nothing_after_that(scene: Scene) -> None:
    with scene.hands.holding():
        scene.hands.wait(1.0)
        scene.body.gripper_m = GRIPPER_CLOSED_M
        with pytest.raises(GraspFailed):
            scene.hands.wait(1.0)
    scene.hands.wait(1.0)


def test_what_slipped_out_unnoticed_is_not_believed_to_be_held(scene: Scene) -> None:
    scene.bin.silent = 999
    with pytest.raises(TaskFailed):
        scene.dispose()
    scene.body.gripper_m = GRIPPER_CLOSED_M
    assert scene.hands.held() is None
    assert scene.memory.held is None


def test_a_gripper_that_holds_another_item_fails_the_task(scene: Scene) -> None:
    scene.bin.silent = 999
    with pytest.raises(TaskFailed):
        scene.dispose()
    with pytest.raises(TaskFailed, match="holds another item"):
        scene.dispose("item2")
    assert scene.body.held == "item1"


@pytest.mark.parametrize("item", ITEMS)
def test_a_held_item_can_be_put_back_where_it_lay_and_taken_again(scene: Scene, item: str) -> None:
    scene.bin.silent = 999
    with pytest.raises(TaskFailed):
        scene.dispose(item)
    held = scene.hands.held()
    assert held is not None
    scene.hands.put_back(held)
    assert scene.hands.held() is None
    assert scene.body.items[item].position_m[:2] == pytest.approx(scene.place(item), abs=0.02)
    scene.bin.silent = 0
    scene.dispose(item)
    assert scene.body.dropped_in == "yellow"


@pytest.fixture
def on_a_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Scene, BinBus]:
    """With the robot's real bin on a bus."""
    monkeypatch.setattr(bin_module, "_ASK_PERIOD_S", 0.0)
    monkeypatch.setattr(delivery, "_HOLD_WALL_S", 0.5)
    monkeypatch.setattr(delivery, "BIN_ANSWER_WALL_S", 2.0)
    bus = BinBus()
    return Scene(tmp_path, bus=bus), bus


def test_what_the_bin_said_of_another_item_is_no_answer_although_it_did_not_answer_before(
    on_a_bus: tuple[Scene, BinBus],
) -> None:
    scene, bus = on_a_bus
    bus.away = 1
    bus.say(Classification, scene.clock.now_s(), compartment="blue")
    asked = 0

    def answer() -> None:
        nonlocal asked
        asked += 1
        if scene.body.dropped_in:
            bus.say(Drop, scene.clock.now_s())
        elif asked == 4:
            bus.say(Classification, scene.clock.now_s())

    bus.on_ask = answer
    scene.dispose()
    assert scene.body.dropped_in == "yellow"
    assert scene.events == ["releasing", "released"]


def test_an_answer_to_one_look_is_none_to_the_next_although_the_clock_is_heard_late(
    on_a_bus: tuple[Scene, BinBus],
) -> None:
    scene, bus = on_a_bus
    ahead_s, asked = 10.0, 0

    def answer() -> None:
        nonlocal asked
        asked += 1
        now_s = scene.clock.now_s() + ahead_s
        if scene.body.dropped_in:
            bus.say(Drop, now_s)
        elif asked == 1:
            bus.say(Classification, now_s, **{"class": "unknown", "compartment": "grey"})
        elif asked == 3:
            bus.say(Classification, now_s)

    bus.on_ask = answer
    scene.dispose()
    assert scene.body.dropped_in == "yellow"


@pytest.mark.long
def test_a_drop_that_others_made_during_the_task_confirms_nothing(on_a_bus: tuple[Scene, BinBus]) -> None:
    scene, bus = on_a_bus

    def answer() -> None:
        if scene.body.dropped_in:
            bus.away = 1
            return
        bus.say(Classification, scene.clock.now_s())
        bus.say(Drop, 1_001.0)

    bus.on_ask = answer
    scene.dispose()
    assert scene.events == ["releasing", "released", "unconfirmed"]


def test_a_drop_by_others_that_is_told_only_after_the_release_is_waited_past(
    on_a_bus: tuple[Scene, BinBus],
) -> None:
    scene, bus = on_a_bus
    told: list[float] = []

    def answer() -> None:
        if not scene.body.dropped_in:
            bus.say(Classification, scene.clock.now_s())
        elif len(told) < 2:
            told.append(1_001.0 if not told else scene.clock.now_s())
            bus.say(Drop, told[-1])

    bus.on_ask = answer
    scene.dispose()
    assert len(told) == 2
    assert scene.events == ["releasing", "released"]


def two_bins(scene: Scene) -> WasteDisposal:
    """The cleaning at a site that has another bin, nearer to item1, which answers as the first does."""
    other = scene.site.bins[0].model_copy(
        update={"name": "other", "pose": Pose2(x_m=5.2, y_m=0.4, yaw_rad=math.pi / 2)}
    )
    site = scene.site.model_copy(update={"bins": [*scene.site.bins, other]})
    smart_bin: Any = scene.bin
    robot = replace(scene.cleaning.robot, site=site, bins={"itrash": smart_bin, "other": smart_bin})
    return WasteDisposal(robot)


@pytest.mark.parametrize(("named", "goes_to"), [("itrash", "itrash"), ("other", "other"), (None, "other")])
def test_the_robot_goes_to_the_bin_that_the_task_names_or_to_the_nearest(
    scene: Scene, named: str | None, goes_to: str
) -> None:
    cleaning = two_bins(scene)
    params = {"item_id": "item1", "x_m": 4.6, "y_m": 1.2} | ({"bin": named} if named else {})
    task = cleaning_chain_record(MOMENT, params).task
    station = next(one for one in cleaning.stations if one.name == goes_to)
    assert cleaning.weigh(task, scene.body.base).ends_at == station.layout.parking
    assert cleaning.choice(ordered(task))[0] == station
    with pytest.raises(TaskFailed):
        cleaning.weigh(task.model_copy(update={"params": params | {"bin": "nowhere"}}), scene.body.base)


def test_what_was_dropped_before_an_interruption_is_asked_of_the_bin_that_it_fell_into(
    scene: Scene, tmp_path: Path
) -> None:
    scene.dispose()
    (note,) = [note for note in scene.record.notes if note["event"] == "releasing"]
    assert note["bin"] == "itrash"
    path, clock = tmp_path / "recording.mcap", ManualClock()
    clock.time_s = 1_900_000_000.0
    with Recorder(path, BINDING, ROBOT, clock) as recorder:
        recorder.write_json("rodeo/event", note | {"bin": "other"}, urgent=True)
    done = two_bins(scene).irrevocable(path)
    assert done is not None and done.where == "other"
