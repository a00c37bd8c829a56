"""The relay's package: Noetic's Python reads it, it needs nothing of RODEO, and its table is ours."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from rodeo_ros1.bus import info_of, mangle
from rodeo_ros1.errors import Malformed
from rodeo_ros1.layouts import Layouts, dds_type

from rodeo.interfaces.generate import stale
from rodeo.interfaces.package import register
from rodeo.interfaces.ros1 import text
from rodeo.ros2 import definitions, wire
from tests.support.imports import packages_of

FOLDER = Path(__file__).parents[3] / "rodeo_ros1" / "rodeo_ros1"
SOURCES = [
    *sorted((FOLDER / "src" / "rodeo_ros1").glob("*.py")),
    FOLDER / "scripts" / "relay",
    FOLDER / "setup.py",
]
NOETIC = {"actionlib", "actionlib_msgs", "diagnostic_msgs", "genpy", "rosgraph", "rospy"}
"""Packages that a robot with Noetic has, and that package.xml asks for."""


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_python_3_8_reads_it_and_it_imports_nothing_of_ours(path: Path) -> None:
    allowed = {*sys.stdlib_module_names, *NOETIC, "rodeo_ros1", "zenoh", "yaml", "catkin_pkg", "setuptools"}
    assert packages_of(path, (3, 8)) <= allowed


def test_what_it_imports_is_what_the_package_asks_for() -> None:
    asked = {one.text for one in ElementTree.parse(FOLDER / "package.xml").findall("exec_depend")}
    imported = {name for path in SOURCES for name in packages_of(path)}
    # genpy comes with rospy.
    assert imported & NOETIC <= asked | {"genpy"} and {"python3-yaml", "rodeo_msgs"} <= asked


def test_the_table_and_the_messages_are_those_that_are_generated() -> None:
    assert [path for path in stale() if path.startswith("rodeo_ros1")] == []


def test_keys_tokens_and_hashes_are_those_of_the_project() -> None:
    register()
    layouts = Layouts.load()
    for typename in ("nav_msgs/msg/Odometry", "rodeo_msgs/srv/GetWallet", "action_msgs/srv/CancelGoal"):
        assert layouts.hash_of(typename) == definitions.type_hash(typename)
        assert dds_type(typename) == definitions.dds_type(typename)
    for name in ("", "panther1", "/fleet/arthur/", "lab/panther1/get_wallet"):
        assert f"/{mangle(name)}/" in wire.NodeEntity(0, "s", 1, name, "n").token()


class Attachment:
    def __init__(self, data: bytes) -> None:
        self._data = data

    def to_bytes(self) -> bytes:
        return self._data


def test_an_attachment_is_read_as_it_was_written() -> None:
    info = info_of(Attachment(wire.attachment(7, 8, bytes(range(16)))))
    assert info == (7, 8, bytes(range(16))) and info.encode() == wire.attachment(7, 8, bytes(range(16)))
    for data in (b"", bytes(33), bytes(32)):
        with pytest.raises(Malformed):
            info_of(Attachment(data))
    with pytest.raises(Malformed):
        info_of(None)


def test_a_definition_in_the_grammar_of_ros_1_has_no_bounds_quotes_or_times_of_ros_2() -> None:
    ros2 = (
        'string KIND_ONE="one"\n# A builtin_interfaces/Time[<=1] "here".\nbuiltin_interfaces/Time[<=1] due\n'
    )
    ros1 = 'string KIND_ONE=one\n# A builtin_interfaces/Time[<=1] "here".\ntime[] due\n'
    assert text(ros2) == ros1
