"""Scouting: what nobody listed is reported once, with a picture, and withdrawn when it is gone."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rodeo.errors import RemoteError
from rodeo.lab.config import FurnitureConfig, ItemConfig, Pose2
from rodeo.lab.items import rest_pose
from rodeo.lab.render import encode
from rodeo.person import photos
from rodeo.robot.behaviour import Estimate, Robot
from rodeo.robot.errors import MotionFailed, NoAnswer
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import View
from rodeo.ros2 import types
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.behaviour import WasteDisposal
from services.robot_sim.messages import compressed_image
from tests.support.site import LAB
from tests.unit.robot.fakes import (
    KinematicBody,
    ManualClock,
    Pose3,
    RayCamera,
    SeenBook,
    manipulator,
)

SITE = Site.load(LAB).model_copy(update={"items": []})
PLACE = 3.0, 1.3
STANDS = Pose2(x_m=PLACE[0] - 1.3, y_m=PLACE[1])
CAN = ItemConfig.model_validate(
    {"id": "can", "class": "metal", "shape": "can", "pose": {"x_m": PLACE[0], "y_m": PLACE[1]}}
)
PICTURE = types.serialize(compressed_image(0, "", encode(np.full((48, 64, 3), 90, np.uint8))))


class Eyes(RayCamera):
    def look(self) -> list[View]:
        if self.blindfold:
            raise NoAnswer("the wrist camera sends no depth")
        return super().look()

    def picture(self) -> bytes:
        super().picture()
        return PICTURE

    blindfold = False


class Scene:
    """A robot that looks around 1.3 m before a can. `there`: furniture that no plan shows."""

    def __init__(
        self, folder: Path, site: Site = SITE, there: tuple[Pose2, float, float] | None = None
    ) -> None:
        self.site, self.clock = site.model_copy(update={"data_dir": folder}), ManualClock()
        furniture = [*site.lab.furniture]
        if there is not None:
            pose, wide_m, tall_m = there
            furniture.append(
                FurnitureConfig(name="unplanned", kind="crate", pose=pose, size_m=(wide_m, wide_m, tall_m))
            )
        lab = site.lab.model_copy(update={"furniture": tuple(furniture)})
        things = [] if site.items else [CAN]
        self.body = KinematicBody(
            self.site.model_copy(update={"items": [*site.items, *things], "lab": lab}), self.clock
        )
        self.body.base = STANDS
        self.camera, self.seen = Eyes(self.body), SeenBook(self.clock)
        self.folder = folder
        self.begin()

    def begin(self) -> None:
        """As after a restart."""
        memory = Memory(self.site, self.folder / "memory.json")
        none: Any = SimpleNamespace()
        hands = manipulator(self.site, self.body, self.camera, memory)
        bins: Any = {"itrash": none}
        seen: Any = self.seen
        robot = Robot(
            "panther1", self.site, hands, Floor(self.site), memory, bins, self.clock, none,
            lambda m, end: Estimate(m, m, end), seen,
        )  # fmt: skip
        self.kind = WasteDisposal(robot)

    def look_around(self) -> None:
        self.body.base = STANDS
        self.kind.look_around()

    def take_away(self) -> None:
        self.camera.blind = True


def test_what_nobody_listed_is_reported_with_its_place_its_size_and_a_picture(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.look_around()
    (thing,) = scene.seen.reported
    assert thing.kind == "waste_disposal"
    assert math.dist((thing.x_m, thing.y_m), PLACE) < 0.02
    assert thing.size_m == pytest.approx([0.053, 0.053, 0.1], abs=0.03)
    assert photos.kept(scene.site, thing.photo).startswith(b"\xff\xd8")
    assert len(scene.body.drives) == 1, "it was not looked at from nearby"


def test_what_is_known_is_neither_reported_again_nor_looked_at_again_not_even_after_a_restart(
    tmp_path: Path,
) -> None:
    scene = Scene(tmp_path)
    scene.look_around()
    scene.look_around()
    scene.begin()
    scene.look_around()
    assert len(scene.seen.reported) == len(scene.body.drives) == 1


def test_what_a_person_dismissed_is_reported_only_when_it_is_something_else(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.look_around()
    (thing,) = scene.seen.kept
    scene.seen.kept = [thing.model_copy(update={"state": "dismissed"})]
    scene.look_around()
    assert len(scene.body.drives) == 1
    scene.seen.kept = [thing.model_copy(update={"state": "dismissed", "size_m": [0.2, 0.2, 0.02]})]
    scene.look_around()
    assert len(scene.body.drives) == 2


def test_the_organization_hears_now_and_then_that_a_known_thing_still_lies_there(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.look_around()
    scene.clock.time_s += 4000
    scene.look_around()
    (thing,) = scene.seen.kept
    assert thing.last_s > thing.first_s + 4000


def test_what_is_gone_is_withdrawn_and_reported_again_when_it_is_back(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.look_around()
    scene.take_away()
    scene.look_around()
    assert [one.state for one in scene.seen.kept] == ["gone"]
    scene.camera.blind = False
    scene.look_around()
    assert [one.state for one in scene.seen.kept] == ["gone", "open"]


def test_what_something_stands_before_is_not_withdrawn(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.look_around()
    (thing,) = scene.seen.kept
    before = Pose2(x_m=PLACE[0] - 0.35, y_m=PLACE[1])
    hidden = Scene(tmp_path, there=(before, 0.3, 0.5))
    hidden.seen.kept.append(thing)
    hidden.take_away()
    hidden.look_around()
    assert [one.state for one in hidden.seen.kept] == ["open"]
    assert hidden.seen.reported == []


def test_a_listed_item_is_not_reported(tmp_path: Path) -> None:
    scene = Scene(tmp_path, SITE.model_copy(update={"items": [CAN]}))
    scene.look_around()
    assert scene.seen.reported == []
    assert scene.body.drives == []


def test_what_lies_beside_a_leg_is_not_reported_while_that_stands_there(tmp_path: Path) -> None:
    scene = Scene(tmp_path, there=(Pose2(x_m=PLACE[0], y_m=PLACE[1] + 0.2), 0.11, 0.8))
    scene.look_around()
    assert scene.seen.reported == []


def test_a_leg_is_not_reported(tmp_path: Path) -> None:
    scene = Scene(tmp_path, there=(Pose2(x_m=PLACE[0], y_m=PLACE[1] + 0.5), 0.11, 0.8))
    scene.take_away()
    scene.look_around()
    assert scene.seen.reported == []


def test_what_moves_between_two_looks_is_not_reported(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    navigate = scene.body.navigate

    def while_it_rolls(goal: Pose2, feedback: Any = None) -> None:
        (x_m, y_m, z_m), turn = rest_pose(CAN)
        scene.body.items["can"] = Pose3((x_m + 0.1, y_m, z_m), turn)
        navigate(goal, feedback)

    scene.body.navigate = while_it_rolls  # type: ignore[method-assign]
    scene.look_around()
    assert scene.seen.reported == []


def test_what_the_robot_cannot_look_at_from_nearby_is_not_reported(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.body.blocked = 100
    scene.look_around()
    assert scene.seen.reported == []


def test_a_robot_whose_camera_sends_no_depth_explores_without_looking_for_a_while(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.camera.blindfold = True
    scene.look_around()
    scene.camera.blindfold = False
    scene.look_around()
    assert scene.camera.looks == 0
    scene.clock.time_s += 3600
    scene.look_around()
    assert len(scene.seen.reported) == 1


def test_what_nobody_could_see_on_a_picture_is_not_reported(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    scene.camera.colourless = True
    scene.look_around()
    assert scene.seen.reported == []


def test_nobody_looks_where_no_robot_would_be_paid(tmp_path: Path) -> None:
    lab = SITE.lab.model_copy(update={"mocap_gripper": False})
    scene = Scene(tmp_path, SITE.model_copy(update={"lab": lab}))
    scene.look_around()
    assert scene.camera.looks == 0


@pytest.mark.parametrize(("code", "passes"), [("too_many_seen", False), ("bridge_not_ready", True)])
def test_what_the_organization_does_not_want_to_know_ends_no_exploring(
    tmp_path: Path, code: str, passes: bool
) -> None:
    scene = Scene(tmp_path)

    def refuse(_seen: Any) -> Any:
        raise RemoteError(code, "not now")

    scene.seen.report = refuse  # type: ignore[method-assign]
    if passes:
        with pytest.raises(RemoteError):
            scene.look_around()
    else:
        scene.look_around()
    ready = scene.site.robots[0].postures.ready_rad
    assert scene.body.arm_rad == pytest.approx(ready, abs=0.01), "the arm is not folded"


def test_a_motion_that_fails_ends_the_look_only(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    follow, failures = scene.body.follow, [MotionFailed("stuck", action="follow")]

    def fail_once(plan: Any) -> None:
        if failures:
            raise failures.pop()
        follow(plan)

    scene.body.follow = fail_once  # type: ignore[method-assign]
    scene.look_around()
    assert scene.seen.reported == []
    scene.look_around()
    assert len(scene.seen.reported) == 1
