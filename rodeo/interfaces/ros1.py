"""The same for ROS 1: `rodeo_msgs` in its grammar, and the table by which the relay lays messages out.

Both follow from the interfaces of ROS 2. What ROS 1 calls otherwise is written here.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

from rodeo.interfaces.actions import CREATE_TASK
from rodeo.interfaces.fields import PACKAGE
from rodeo.interfaces.naming import service_name
from rodeo.interfaces.package import (
    Interface,
    asked,
    commands,
    create_task,
    interfaces,
    register,
)
from rodeo.ros2.definitions import definition, standard_types
from rodeo.site import topics

FOLDER = "rodeo_ros1"
TABLE = f"{FOLDER}/rodeo_ros1/src/rodeo_ros1/interfaces.json"

RENAMED = {
    "nav2_msgs/action/NavigateToPose_Goal": {"pose": "target_pose"},
    "nav2_msgs/action/NavigateToPose_Feedback": {"current_pose": "base_position"},
    "control_msgs/msg/JointTrajectoryControllerState": {"reference": "desired", "feedback": "actual"},
}
"""Type in ROS 2 -> field -> its name in ROS 1, unless that is the same or in capitals."""

NAMES = {"nav2_msgs/action/NavigateToPose": "move_base_msgs/MoveBase"}
"""Action in ROS 2 -> in ROS 1, unless package and name are the same."""

_LEFT_OUT = frozenset(
    {
        "rcl_interfaces",
        "type_description_interfaces",
        "lifecycle_msgs",
        "rmw_dds_common",
        "rosbag2_interfaces",
    }
    | {"service_msgs", "statistics_msgs", "example_interfaces"}
)
"""Packages for the inside of ROS 2, of which ROS 1 knows nothing."""

_PARTS = ("_Request", "_Response", "_Goal", "_Result", "_Feedback")
_INSIDE = (
    "_Event",
    *(f"_{call}_{part}" for call in ("SendGoal", "GetResult") for part in ("Request", "Response")),
)
_TIGHT: dict[str, Any] = {"separators": (",", ":")}


def table() -> str:
    """Content of interfaces.json, a type a line. What is called, and not sent, has a hash only."""
    register()
    lines = []
    for name in sorted({*standard_types(), *_own_types()}):
        _, form, last = name.split("/")
        if name.split("/")[0] not in _LEFT_OUT and not last.endswith(_INSIDE):
            found = definition(name)
            fields = found.fields if form == "msg" or last.endswith(_PARTS) else []
            lines.append(f"{json.dumps(name)}:{json.dumps([found.hash, fields], **_TIGHT)}")
    head = {"ros1_names": NAMES, "renamed": RENAMED, "organization": _organization()}
    parts = [f"{json.dumps(name)}:{json.dumps(value, **_TIGHT)}" for name, value in head.items()]
    return "{\n" + ",\n".join(parts) + ',\n"types":{\n' + ",\n".join(lines) + "\n}\n}\n"


def _own_types() -> list[str]:
    parts = {
        "msg": ("",),
        "srv": ("", "_Request", "_Response"),
        "action": ("_SendGoal", "_GetResult", "_FeedbackMessage", "_Goal", "_Result", "_Feedback"),
    }
    return [f"{one.typename}{part}" for one in interfaces() for part in parts[one.form]]


def _organization() -> dict[str, dict[str, str]]:
    """Names that `ros_dao` has below `/<organization>/<participant>/`, by its list in a configuration.

    Not `do_task`: where nobody serves it, each task would be given back.
    """
    served = {name: one.interface.typename for name, one in commands().items()}
    served |= {name: one.interface.typename for name, one in asked().items()}
    heard = {
        one.key.rsplit("/", 1)[1]: one.type
        for one in topics.TOPICS
        if one.plane is topics.Plane.ORGANIZATION and one.form is topics.Form.TOPIC
    }
    return {
        "topics_to_ros1": heard,
        "services_to_ros2": served,
        "actions_to_ros2": {service_name(CREATE_TASK): create_task().typename},
    }


def text(ros2: str) -> str:
    """A definition in the grammar of ROS 1: no bounds, times of its own, constants without quotes."""
    lines = []
    for line in ros2.splitlines():
        if not line.startswith("#"):
            line = re.sub(r"^builtin_interfaces/Time\b", "time", line).replace("[<=1]", "[]")
            line = re.sub(r'^(string \w+=)"(.*)"$', r"\1\2", line)
        lines.append(line)
    return "\n".join(lines) + "\n"


def files(written: Callable[[Interface], str]) -> dict[str, str]:
    """Path below the root of the repository -> content. `written` is a definition in the grammar of ROS 2."""
    package = f"{FOLDER}/{PACKAGE}"
    listed = {
        form: "".join(f"  {one.path.split('/')[1]}\n" for one in interfaces() if one.form == form)
        for form in ("msg", "srv", "action")
    }
    return {
        **{f"{package}/{one.path}": text(written(one)) for one in interfaces()},
        f"{package}/CMakeLists.txt": _CMAKE.format(name=PACKAGE, **listed),
        f"{package}/package.xml": _MANIFEST.format(name=PACKAGE, version=version("rodeo-dao")),
        TABLE: table(),
    }


_CMAKE = """\
cmake_minimum_required(VERSION 3.0.2)
project({name})

find_package(catkin REQUIRED COMPONENTS actionlib_msgs message_generation std_msgs)

add_message_files(FILES
{msg})
add_service_files(FILES
{srv})
add_action_files(FILES
{action})
generate_messages(DEPENDENCIES actionlib_msgs std_msgs)

catkin_package(CATKIN_DEPENDS actionlib_msgs message_runtime std_msgs)
"""

_MANIFEST = """\
<?xml version="1.0"?>
<package format="2">
  <name>{name}</name>
  <version>{version}</version>
  <description>Tasks, services and money of a RODEO organization, for ROS 1</description>
  <maintainer email="rodeo@example.org">The RODEO authors</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>catkin</buildtool_depend>
  <build_depend>message_generation</build_depend>
  <build_export_depend>message_runtime</build_export_depend>
  <exec_depend>message_runtime</exec_depend>
  <depend>actionlib_msgs</depend>
  <depend>std_msgs</depend>
</package>
"""
