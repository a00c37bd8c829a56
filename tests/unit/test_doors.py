"""Numbers of devices enter by `rodeo.ros2.readings`: whoever decodes a device's message is listed here."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from rodeo.ros2.definitions import ARRAY, BASE, NAME, SEQUENCE, definition
from rodeo.site import topics

ROOT = Path(__file__).parents[2]
PRODUCT = ("rodeo", "rodeo_cli", "rodeo_experiments", "rodeo_kinds", "services")
DOOR = "rodeo/ros2/readings.py"
DECODES = {"deserialize", "subscription", "raw_subscription"}

BY_THE_DOOR = {
    "rodeo/robot/receipts.py": {"battery"},
    "rodeo/robot/ros_body.py": {"battery", "joints", "pose", "efforts"},
    "rodeo/robot/wrist_camera.py": {"depth_m", "intrinsics"},
    "rodeo_experiments/lab.py": {"pose"},
    "rodeo_cli/mocap.py": {"pose"},
    "services/charger/job.py": {"power"},
    "services/charger/terminals.py": {"power", "why_unknown"},
    "services/console/live.py": {"battery", "pose", "positions"},
    "services/itrash/steps.py": {"distance_m", "force_n"},
    "services/robot_agent/upkeep.py": {"power"},
}
"""Files that decode messages of devices -> what they ask the door for."""
WITHOUT_NUMBERS = {
    "rodeo/person/statement.py": "a photo",
    "rodeo/recording/pace.py": "stamps alone",
    "rodeo/robot/recording.py": "bytes, written as they are",
    "rodeo/ros2/action.py": "codec",
    "rodeo/ros2/base.py": "codec",
    "rodeo/ros2/dds.py": "bytes, carried as they are",
    "rodeo/ros2/service.py": "codec",
    "rodeo_cli/film.py": "a picture",
    "rodeo_experiments/conduct.py": "handed to `rodeo_experiments.progress.Meters`",
    "rodeo_kinds/waste_disposal/checks/picture.py": "a picture",
    "rodeo_kinds/waste_disposal/scouting.py": "a picture",
    "services/charger/process.py": "bytes, written as they are",
    "services/console/replay.py": "a picture",
    "services/itrash/camera.py": "a picture",
    "services/mocap/sources/recorded.py": "poses, which `services.mocap.frames` holds to the door's rule",
    "services/mocap/sources/ros2.py": "poses, which `services.mocap.frames` holds to the door's rule",
    "services/robot_sim/plane.py": "commands to the simulated body",
}
"""The others, and what they decode instead."""


def modules() -> Iterator[str]:
    for room in PRODUCT:
        for path in sorted((ROOT / room).rglob("*.py")):
            if "harness" not in path.parts:
                yield str(path.relative_to(ROOT))


@cache
def tree(name: str) -> ast.Module:
    return ast.parse((ROOT / name).read_text())


def called(name: str) -> set[str]:
    """Functions that a module calls or hands on, by the last part of their names."""
    found = {node.attr for node in ast.walk(tree(name)) if isinstance(node, ast.Attribute)}
    return found | {node.id for node in ast.walk(tree(name)) if isinstance(node, ast.Name)}


def decodes(name: str) -> bool:
    calls = [node.func for node in ast.walk(tree(name)) if isinstance(node, ast.Call)]
    return any(getattr(one, "attr", getattr(one, "id", "")) in DECODES for one in calls)


def numbers_of(ros_type: str) -> Iterator[str]:
    """Names of the fields that are floats, or sequences of them."""
    for name, (kind, detail) in definition(ros_type).fields:
        if kind in (ARRAY, SEQUENCE):
            kind, detail = detail[0]
        if kind == NAME:
            yield from numbers_of(detail)
        elif kind == BASE and detail[0].startswith("float"):
            yield name


DEVICES = (
    *(topics.BATTERY_STATE, topics.JOINT_STATES, topics.ARM_STATE, topics.BIN_PRESENCE, topics.BIN_LOAD),
    *(topics.DOCK_OUTPUT, topics.WRIST_DEPTH_INFO),
)
AXES = {"x", "y", "z", "w"}
"""Names that any point has: a pose is asked for as a whole."""
FIELDS = {name for topic in DEVICES for name in numbers_of(topic.type)} - AXES


def test_each_place_that_decodes_messages_is_listed() -> None:
    assert {name for name in modules() if decodes(name)} == BY_THE_DOOR.keys() | WITHOUT_NUMBERS.keys()


@pytest.mark.parametrize("name", BY_THE_DOOR)
def test_whoever_decodes_a_devices_message_asks_the_door(name: str) -> None:
    assert BY_THE_DOOR[name] <= called(name)
    imported = {
        node.module for node in ast.walk(tree(name)) if isinstance(node, ast.ImportFrom) and node.module
    }
    assert imported & {"rodeo.ros2", "rodeo.ros2.readings"}


def test_the_fields_of_devices_are_known() -> None:
    assert {"percentage", "voltage", "current", "position", "effort", "range", "k", "positions"} <= FIELDS


def reads(name: str, fields: set[str]) -> set[str]:
    """Where a module reads an attribute with one of these names."""
    return {
        ast.unparse(node)
        for node in ast.walk(tree(name))
        if isinstance(node, ast.Attribute) and node.attr in fields and isinstance(node.ctx, ast.Load)
    }


ALLOWED = {
    # What the robot sends.
    "command.position",
    "trajectory.positions",
    "trajectory.velocities",
    # What the door has let in.
    "readings.positions",
    "readings.pose(one.pose).position",
    # The vector of a pose, which has no number by itself.
    "pose.message.position",
    "pose(message.pose).position",
    "pose.pose.position",
    "state.pose.position",
    # Motion capture's, for `services.mocap.frames`.
    "message.pose.position",
    "said.pose.position",
    # What is handed to the door as it is.
    "result.position",
}
OTHERS_TOO = {"position", "positions", "velocities", "current", "charge", "temperature", "range", "k"}
"""Names that other things have as well."""


@pytest.mark.parametrize(
    "name", [one for one in [*BY_THE_DOOR, *WITHOUT_NUMBERS] if one != "services/robot_sim/plane.py"]
)
def test_whoever_decodes_messages_reads_no_number_of_a_device(name: str) -> None:
    assert reads(name, FIELDS) - ALLOWED == set()


def test_what_only_devices_say_is_read_nowhere_else() -> None:
    found = {name: reads(name, FIELDS - OTHERS_TOO) - {"perturbation.effort"} for name in modules()}
    assert {name for name, one in found.items() if one and "robot_sim" not in name} == {DOOR}


def test_the_recorded_numbers_of_joints_pass_the_door_too() -> None:
    assert "are_joints" in called("rodeo/checks/tables.py")


def test_the_door_is_short() -> None:
    assert len((ROOT / DOOR).read_text().splitlines()) <= 400
    assert len((ROOT / "rodeo/chain/node/answers.py").read_text().splitlines()) <= 400
