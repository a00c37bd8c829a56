"""Map and 3-D view draw robots where the models have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rodeo.lab.layout import BinLayout
from rodeo.lab.world import arm_model, robot_model
from rodeo.site.config import Site
from services.console import scene, solids
from tests.support.site import LAB, RunningSite, write_site


@pytest.mark.parametrize("seed", range(5))
def test_the_drawn_arm_is_the_models_seen_from_above(seed: int) -> None:
    model = robot_model()
    data = mujoco.MjData(model)
    joints = np.random.default_rng(seed).uniform(-1.5, 1.2, 6)
    drawing = scene.arm_drawing(None)
    for name, angle in zip(arm_model().joints, joints, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_kinematics(model, data)
    points = drawing.points(joints)
    bodies = ["shoulder_link", "upper_arm_link", "upper_forearm_link", "lower_forearm_link", "wrist_link"]
    for point, body in zip(points[1:6], bodies, strict=True):
        assert point == pytest.approx(data.body(body).xpos[:2], abs=0.001), body
    assert points[-1] == pytest.approx(data.site("grasp").xpos[:2], abs=0.001)


def test_the_way_ahead_begins_next_to_the_robot_and_keeps_its_end() -> None:
    way = [(x / 10, 1.0) for x in range(41)]
    assert scene.ahead(way, 3.62, 1.2, 60) == [[3.6, 1.0], [3.7, 1.0], [3.8, 1.0], [3.9, 1.0], [4.0, 1.0]]
    thinned = scene.ahead(way, 0.0, 1.0, 10)
    assert thinned[0] == [0.0, 1.0] and thinned[-1] == [4.0, 1.0] and len(thinned) <= 12
    assert scene.ahead(way, 9.0, 1.0, 10) == [[4.0, 1.0]]


def place_of(part: dict[str, Any], joints: list[float], path: list[int]) -> np.ndarray:
    """Where the page puts the body at the end of `path`, in the base frame: as `lab_scene.js` does."""
    quaternion, position = part["quat"], np.array(part["pos"])
    turn = Rotation.from_quat(quaternion, scalar_first=True)
    for move in part["moves"]:
        axis, by = np.array(move["axis"]), joints[move["joint"]] - move["zero"]
        if move["slides"]:
            position = position + turn.apply(axis * by)
            continue
        hinge, anchor = Rotation.from_rotvec(axis * by), np.array(move["pos"])
        position = position + turn.apply(anchor - hinge.apply(anchor))
        turn = turn * hinge
    if not path:
        return position
    inner = place_of(part["parts"][path[0]], joints, path[1:])
    return position + turn.apply(inner)


@pytest.mark.parametrize("seed", range(3))
def test_each_body_in_three_dimensions_is_where_the_model_has_it(seed: int) -> None:
    model = robot_model()
    data = mujoco.MjData(model)
    positions = dict(
        zip(solids.joint_names(None), np.random.default_rng(seed).uniform(-0.02, 1.2, 12), strict=True)
    )
    for name, position in positions.items():
        data.joint(name).qpos = round(position, 3)
    mujoco.mj_kinematics(model, data)
    drawn = solids.solids(Site.load(LAB))["robots"]["panther1"]
    for body in ("gripper_link", "left_finger_link", "rr_wheel_link"):
        chain: list[int] = []
        at = int(model.body(body).id)
        while at != 0:
            parent = int(model.body_parentid[at])
            children = [one for one in range(1, model.nbody) if model.body_parentid[one] == parent]
            chain.insert(0, children.index(at))
            at = parent
        joints = [one or 0.0 for one in solids.joints(None, positions)]
        assert place_of(drawn, joints, chain) == pytest.approx(data.body(body).xpos, abs=0.002), body


def test_what_stands_and_what_is_carried_is_drawn_but_neither_the_room_nor_hulls() -> None:
    site = Site.load(LAB)
    drawn = solids.solids(site)
    assert drawn["items"].keys() == {one.id for one in site.items} and all(drawn["items"].values())
    assert len(drawn["fixed"]) > 20
    length_m, width_m = site.lab.size_m
    assert all(max(one["size"][:2]) < min(length_m, width_m) / 2 for one in drawn["fixed"])
    parts = drawn["robots"]["panther1"]["parts"]
    assert "sphere" not in {shape["kind"] for part in parts for shape in part["shapes"]}


def test_a_joint_that_nobody_publishes_has_no_position() -> None:
    assert solids.joints(None, {"waist": 0.12345, "strange": 1.0})[4:6] == [0.123, None]


def test_a_mesh_is_drawn_as_itself_and_one_of_too_many_faces_as_its_box(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    corners = "0 0 0  1 0 0  0 1 0  0 0 1"
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="m" vertex="{corners}"/></asset>'
        '<worldbody><body><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    (shape,) = solids.shapes(model, 1)
    assert shape["kind"] == "mesh" and len(shape["vertices"]) == 12 and len(shape["faces"]) == 12
    monkeypatch.setattr(solids, "MOST_FACES", 3)
    (shape,) = solids.shapes(model, 1)
    assert shape["kind"] == "box" and shape["size"] == pytest.approx([0.5] * 3, abs=0.3)


def test_an_item_below_the_rim_lies_in_its_compartment_and_others_in_none(tmp_path: Path) -> None:
    site = RunningSite(write_site(tmp_path), wallets=False).site
    (one,) = site.bins
    x, y, rim_m = BinLayout(one).compartment("yellow")
    seen = {
        "inside": {"x": x, "y": y, "z": rim_m / 2},
        "held above": {"x": x, "y": y, "z": rim_m + 0.1},
        "beside": {"x": x, "y": y + 1.0, "z": 0.05},
    }
    assert scene.in_bins(site, seen) == {"inside": f"{one.name}, yellow"}
