"""The table of keys."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from rodeo import payloads
from rodeo.bus import queries
from rodeo.commands import COMMANDS
from rodeo.commands.declare import example_of
from rodeo.interfaces.package import register
from rodeo.payloads import keys_page
from rodeo.ros2 import definitions
from rodeo.site import topics
from rodeo.site.topics import TOPICS, Form, Plane, robot_interface


def test_keys_are_unique() -> None:
    keys = [topic.key for topic in TOPICS]
    assert len(set(keys)) == len(keys)


def test_what_is_recorded_is_a_robot_plane_topic() -> None:
    for topic in TOPICS:
        if topic.recorded:
            assert topic.plane is Plane.ROBOT
            assert topic.form is Form.TOPIC


def test_every_robot_plane_type_is_a_ros_type_with_a_hash() -> None:
    register()
    for topic in TOPICS:
        if topic.plane is Plane.ROBOT and topic.form is Form.TOPIC:
            assert definitions.type_hash(topic.type).startswith("RIHS01_")


def test_a_name_fills_its_template() -> None:
    from rodeo.site.topics import ODOM

    assert ODOM.name(ns="panther1") == "panther1/odom"


def test_a_part_that_a_pattern_leaves_out_matches_any_one_name() -> None:
    assert topics.STATUS.pattern(org="lab") == "rodeo/lab/status/*"
    assert topics.STATUS.pattern() == "rodeo/*/status/*"
    assert topics.BIN_LOAD.pattern(bin="bin") == "bin/*/load"


def test_what_a_querys_pattern_leaves_out_at_its_end_is_the_whole_branch() -> None:
    assert topics.STATE.pattern(org="lab") == "rodeo/lab/state/**"
    assert topics.COMMAND.pattern(org="lab") == "rodeo/lab/wallet/**"
    assert topics.COMMAND.pattern(org="lab", participant="alice") == "rodeo/lab/wallet/alice/**"


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.key)
def test_the_parts_of_a_name_are_those_that_it_was_made_of(topic: topics.Topic) -> None:
    given = {part: f"{part}-1" for part in re.findall(r"{(\w+)}", topic.key)}
    assert topic.parts(topic.name(**given)) == given
    assert topic.parts("another/" + topic.name(**given) + "/key") is None or not given


def test_the_last_part_of_a_key_may_hold_slashes() -> None:
    assert topics.STATE.parts("rodeo/lab/state/task/7") == {"org": "lab", "what": "task/7"}
    assert topics.MOCAP_POSE.parts("mocap/panther1/gripper/pose") == {"body": "panther1/gripper"}
    assert topics.STATE.parts("rodeo/lab/event/Transfer") is None


ROOT = Path(__file__).parents[2]
SOURCES = ("rodeo", "services", "deploy", "rodeo_cli", "bench", "tests/support")
NO_TOPICS = {
    "deploy/chain/methods.py": "rodeo/eth-tester/{}/py-evm/{}",  # what web3_clientVersion answers
    "deploy/chain/local_chain.py": "rodeo/{}/",  # what the development keys are derived from
    "rodeo/lab/world.py": "{}/presence",  # a site of the MuJoCo model
    "services/robot_sim/simulation.py": "{}/presence",  # the same
    "services/robot_sim/messages.py": "{}/odom",  # a frame of TF
    "services/robot_sim/plane.py": "{}/odom",  # the same
}
"""Strings that only look like topics, by file."""
_ENDPOINTS = {"publisher", "raw_publisher", "subscription", "raw_subscription", "client", "service"}
_BRANCHES = {topic.key.split("/")[2] for topic in TOPICS if topic.plane is Plane.DAO}
_ROBOT_KEYS = [
    re.compile(re.sub(r"\\{\w+\\}", r"[^/\\s]+", re.escape(topic.key)))
    for topic in TOPICS
    if topic.plane is Plane.ROBOT and "/" in topic.key
]


def _text(node: ast.AST) -> str | None:
    """A string, or an f-string with {} for what is filled in."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(str(one.value) if isinstance(one, ast.Constant) else "{}" for one in node.values)
    return None


def _by_hand(source: str) -> Iterator[str]:
    """Keys and topic names that `source` writes itself; docstrings may."""
    tree = ast.parse(source)
    skipped: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):
            skipped.add(node.value)
        elif isinstance(node, ast.JoinedStr):
            skipped.update(node.values)
        text = None if node in skipped else _text(node)
        if text is not None and (
            text.lstrip("`").startswith("rodeo/")
            or any(f"/{branch}/" == text for branch in _BRANCHES)
            or any(key.fullmatch(text.strip("/")) for key in _ROBOT_KEYS)
        ):
            yield text
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args:
            name = _text(node.args[0])
            if node.func.attr in _ENDPOINTS and name is not None and name in {topic.key for topic in TOPICS}:
                yield name


def test_no_file_beside_the_table_writes_a_key_or_topic_by_hand() -> None:
    found = {
        (str(path.relative_to(ROOT)), text)
        for folder in SOURCES
        for path in (ROOT / folder).rglob("*.py")
        if path != ROOT / "rodeo" / "site" / "topics.py"
        for text in _by_hand(path.read_text())
    }
    assert found == set(NO_TOPICS.items())


@pytest.mark.parametrize(
    "source",
    [
        'bus.query(f"rodeo/{org}/state/tasks")',
        'bus.subscribe_json("rodeo/*/status/*", listen)',
        'bus.put_json("rodeo/" + org + "/event/Transfer", event)',
        'key.partition("/wallet/")',
        'node.publisher(f"{robot.namespace}/odom", type_)',
        'node.subscription("/panther1/battery_state", type_, listen)',
        'node.publisher("clock", type_)',
        'recorder.write_json("rodeo/event", note)',
    ],
)
def test_a_key_or_topic_that_is_written_by_hand_is_found(source: str) -> None:
    assert list(_by_hand(source))


@pytest.mark.parametrize(
    "source",
    [
        '"""On `rodeo/{org}/state/{what}`."""',
        "bus.query(topics.STATE.name(org=org, what='tasks'))",
        'print("rodeo status")',
        'site["clock"]',
    ],
)
def test_what_is_no_key_written_by_hand_is_let_be(source: str) -> None:
    assert not list(_by_hand(source))


@pytest.fixture(scope="module")
def page() -> str:
    return keys_page()


def test_the_page_of_keys_is_the_table(page: str) -> None:
    file = Path(__file__).parents[2] / "docs" / "reference" / "keys.md"
    assert file.read_text() == page, "run: python -m rodeo.payloads > docs/reference/keys.md"


def test_the_page_for_who_brings_a_robot_lists_the_robots_part_of_the_table() -> None:
    page = Path(__file__).parents[2] / "docs" / "tutorials" / "robot.md"
    assert robot_interface() in page.read_text(), "paste what rodeo.site.topics.robot_interface() returns"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_is_valid(name: str) -> None:
    COMMANDS[name].model_validate(example_of(COMMANDS[name]))


@pytest.mark.parametrize("model", payloads.EXAMPLES)
def test_the_example_of_a_payload_is_valid(model: type[BaseModel]) -> None:
    model.model_validate(payloads.EXAMPLES[model])


@pytest.mark.parametrize("what", queries.QUERIES)
def test_the_example_of_a_question_is_valid(what: str) -> None:
    queries.QUERIES[what].parameters.model_validate(payloads.parameters_of(what))


def test_every_command_and_statement_has_its_part_of_the_page(page: str) -> None:
    titles = {line.removeprefix("#### ") for line in page.splitlines() if line.startswith("#### ")}
    assert {*COMMANDS, "prepare", "broadcast", *queries.QUERIES} <= titles
    assert {model.__name__ for model in payloads.STATEMENTS} <= titles


def test_what_a_field_means_is_read_from_the_model(page: str) -> None:
    assert "Queue the task even if every offered service costs more" in page
