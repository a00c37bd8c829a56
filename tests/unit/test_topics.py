"""The table of keys."""

from pathlib import Path

import pytest
from pydantic import BaseModel

from rodeo import payloads, queries
from rodeo.messages import COMMANDS
from rodeo.payloads import keys_page
from rodeo.topics import TOPICS, Form, Plane, robot_interface


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
    assert page.read_text() == keys_page(), "run: python -m rodeo.payloads > docs/keys.md"


def test_the_page_for_who_brings_a_robot_lists_the_robots_part_of_the_table() -> None:
    page = Path(__file__).parents[2] / "docs" / "bring-your-own-robot.md"
    assert robot_interface() in page.read_text(), "paste what rodeo.topics.robot_interface() returns"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_is_valid(name: str) -> None:
    COMMANDS[name].model_validate(payloads.example_of(COMMANDS[name], name))


@pytest.mark.parametrize("model", payloads.EXAMPLES)
def test_the_example_of_a_payload_is_valid(model: type[BaseModel]) -> None:
    model.model_validate(payloads.EXAMPLES[model])


@pytest.mark.parametrize("what", queries.QUERIES)
def test_the_example_of_a_question_is_valid(what: str) -> None:
    queries.QUERIES[what].parameters.model_validate(payloads.parameters_of(what))


def test_every_command_and_statement_has_its_part_of_the_page() -> None:
    titles = {line.removeprefix("#### ") for line in keys_page().splitlines() if line.startswith("#### ")}
    assert {*COMMANDS, "prepare", "broadcast", *queries.QUERIES} <= titles
    assert {model.__name__ for model in payloads.STATEMENTS} <= titles


def test_the_page_knows_the_commands_that_the_bridge_knows_and_what_each_takes() -> None:
    from services.bridge.commands import _COMMANDS

    assert {name: model for name, (model, _build) in _COMMANDS.items()} == COMMANDS


def test_what_a_field_means_is_read_from_the_model() -> None:
    assert "Queue the task even though every service on offer costs more" in keys_page()
