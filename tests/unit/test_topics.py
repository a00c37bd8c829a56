"""The table of keys."""

from pathlib import Path

from rodeo.topics import TOPICS, Form, Plane, markdown, robot_interface


def test_keys_are_unique() -> None:
    keys = [topic.key for topic in TOPICS]
    assert len(set(keys)) == len(keys)


def test_what_is_recorded_is_a_robot_plane_topic() -> None:
    for topic in TOPICS:
        if topic.recorded:
            assert topic.plane is Plane.ROBOT
            assert topic.form is Form.TOPIC


def test_every_robot_plane_type_is_a_ros_type_with_a_hash() -> None:
    from rodeo.ros2 import types

    for topic in TOPICS:
        if topic.plane is Plane.ROBOT and topic.form is Form.TOPIC:
            assert types.type_hash(topic.type).startswith("RIHS01_")


def test_a_name_fills_its_template() -> None:
    from rodeo.topics import ODOM

    assert ODOM.name(ns="panther1") == "panther1/odom"


def test_the_page_of_keys_is_the_table() -> None:
    page = Path(__file__).parents[2] / "docs" / "keys.md"
    assert page.read_text() == markdown(), "run: python -m rodeo.topics > docs/keys.md"


def test_the_page_for_who_brings_a_robot_lists_the_robots_part_of_the_table() -> None:
    page = Path(__file__).parents[2] / "docs" / "bring-your-own-robot.md"
    assert robot_interface() in page.read_text(), "paste what rodeo.topics.robot_interface() returns"
