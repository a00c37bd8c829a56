"""A file declares what is relayed; errors in it are named, with their place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from rodeo_ros1.config import Config, load
from rodeo_ros1.errors import ConfigError
from rodeo_ros1.layouts import Layouts

from rodeo.interfaces.package import asked, commands
from rodeo.site import topics

LAYOUTS = Layouts.load()
PANTHER = Path(__file__).parents[3] / "rodeo_ros1" / "rodeo_ros1" / "config" / "panther.yaml"
ODOM = {"ros1": "/odom", "ros2": "/panther1/odom", "type": "nav_msgs/Odometry"}


def read(folder: Path, said: Any) -> Config:
    path = folder / "relay.yaml"
    path.write_text(said if isinstance(said, str) else yaml.safe_dump(said))
    return load(str(path), LAYOUTS)


def test_types_may_have_their_name_of_either_ros(tmp_path: Path) -> None:
    config = read(
        tmp_path,
        {
            "router": "tcp/127.0.0.1:7447",
            "topics_to_ros2": [ODOM],
            "actions_to_ros1": [
                {"ros1": "/move_base", "ros2": "a/navigate_to_pose", "type": "move_base_msgs/MoveBase"}
            ],
            "actions_to_ros2": [
                {"ros1": "/other", "ros2": "b/navigate_to_pose", "type": "nav2_msgs/action/NavigateToPose"}
            ],
        },
    )
    (odom,) = config.entries["topics_to_ros2"]
    assert (odom.ros1, odom.ros2, odom.type) == ("/odom", "panther1/odom", "nav_msgs/msg/Odometry")
    both = [config.entries[f"actions_to_{side}"][0].type for side in ("ros1", "ros2")]
    assert both == ["nav2_msgs/action/NavigateToPose"] * 2
    assert config.tls is None and config.domain_id == 0


WORK = {"register_service", "update_service", "accept_task", "abandon_task", "submit_proof"}


def test_a_participant_stands_for_what_its_nodes_read_and_for_its_work(tmp_path: Path) -> None:
    config = read(tmp_path, {"router": "tcp/127.0.0.1:7447", "participants": ["lab/anna"]})
    services = {one.ros2 for one in config.entries["services_to_ros2"]}
    # Whoever reaches the master may call them: nothing that spends, judges or votes.
    assert services == {f"lab/anna/{name}" for name in (*WORK, *asked())} and set(commands()) > WORK
    assert {one.ros2 for one in config.entries["topics_to_ros1"]} == {
        one.name(org="lab", participant="anna")
        for one in topics.TOPICS
        if one.plane is topics.Plane.ORGANIZATION and one.form is topics.Form.TOPIC
    }
    assert all(one.latched for one in config.entries["topics_to_ros1"])
    # Each task would be given back where nobody serves it.
    assert config.entries["actions_to_ros1"] == config.entries["actions_to_ros2"] == []


def test_a_command_that_spends_judges_or_votes_is_relayed_where_it_is_named(tmp_path: Path) -> None:
    anna = {"name": "lab/anna", "commands": ["transfer", "create_task"]}
    config = read(tmp_path, {"router": "tcp/127.0.0.1:7447", "participants": [anna, {"name": "lab/ben"}]})
    services = {one.ros2 for one in config.entries["services_to_ros2"]}
    both = {f"lab/{name}/{one}" for name in ("anna", "ben") for one in (*WORK, *asked())}
    assert services == both | {"lab/anna/transfer"}
    assert [one.ros1 for one in config.entries["actions_to_ros2"]] == ["/lab/anna/create_task"]


def test_every_command_can_be_named(tmp_path: Path) -> None:
    every = {"name": "lab/anna", "commands": [*commands(), "create_task"]}
    config = read(tmp_path, {"router": "tcp/127.0.0.1:7447", "participants": [every]})
    services = {one.ros2 for one in config.entries["services_to_ros2"]}
    assert services == {f"lab/anna/{name}" for name in (*commands(), *asked())}


def test_the_shipped_one_has_what_the_interface_of_a_robot_asks_for(tmp_path: Path) -> None:
    said = yaml.safe_load(PANTHER.read_text())
    for name in said["tls"].values():
        (tmp_path / name).touch()
    config = read(tmp_path, said)
    assert config.tls is not None and config.tls.ca == str(tmp_path / "ca.pem")
    carried = {(one.ros2, one.type) for entries in config.entries.values() for one in entries}
    optional = {topics.POSE, topics.MOTOR_POWER, topics.PLAN, topics.ROBOT_DESCRIPTION}
    for topic in topics.TOPICS:
        if topic.plane is topics.Plane.ROBOT and topic.writer == topics.BODY and topic not in optional:
            assert (topic.name(ns="panther1"), topic.type) in carried, topic.key


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"router": None}, "router cannot be None"),
        ({"topics": []}, "unknown 'topics'"),
        ({"domain_id": True}, "domain_id cannot be True"),
        ({"domain_id": 233}, "domain_id is 0 to 232"),
        ({"topics_to_ros2": ["odom"]}, r"topics_to_ros2\[0\] is no mapping"),
        (
            {"topics_to_ros2": [{**ODOM, "type": "nav_msgs/Odometri"}]},
            r"\[0\]: no layout of nav_msgs/msg/Odom",
        ),
        ({"topics_to_ros2": [{**ODOM, "type": "std_srvs/srv/SetBool"}]}, "is no message"),
        ({"topics_to_ros2": [{**ODOM, "ros2": "a//b"}]}, "no name in ROS"),
        ({"topics_to_ros2": [{**ODOM, "ros1": "/**"}]}, "no name in ROS"),
        ({"topics_to_ros2": [{**ODOM, "depth": 0}]}, "depth is 1"),
        ({"topics_to_ros2": [{"ros1": "/odom"}]}, "lacks ros2, type"),
        ({"topics_to_ros2": [ODOM, ODOM]}, "panther1/odom more than once|odom more than once"),
        ({"topics_to_ros2": [ODOM], "topics_to_ros1": [ODOM]}, "more than once"),
        ({"services_to_ros2": [{**ODOM, "timeout_s": 0}]}, "timeout_s is a time"),
        ({"tls": {"ca": "ca.pem"}}, "tls lacks certificate, key"),
        ({"tls": dict.fromkeys(("ca", "certificate", "key"), "no.pem")}, "there is no .*no.pem"),
        ({"participants": ["anna"]}, "is not <organization>/<participant>"),
        ({"participants": [5]}, "is not <organization>/<participant>"),
        ({"participants": [{"commands": []}]}, "is not <organization>/<participant>"),
        ({"participants": [{"name": "lab/anna", "all": True}]}, "participants: unknown 'all'"),
        ({"participants": [{"name": "lab/anna", "commands": "transfer"}]}, "commands cannot be 'transfer'"),
        (
            {"participants": [{"name": "lab/anna", "commands": ["pay"]}]},
            "no command 'pay'; known: abandon_task",
        ),
        ({"participants": [{"name": "lab/anna", "commands": ["get_task"]}]}, "no command 'get_task'"),
        ({"participants": [{"name": "lab/anna", "commands": [["a"]]}]}, r"no command \['a'\]"),
        ({"participants": ["lab/anna", {"name": "lab/anna"}]}, "more than once"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read(tmp_path, {"router": "tcp/127.0.0.1:7447", **changes})


@pytest.mark.parametrize("text", ["", "[1]", "router: [", "\x00"])
def test_a_file_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError):
        read(tmp_path, text)
    with pytest.raises(ConfigError, match="cannot read"):
        load(str(tmp_path / "none.yaml"), LAYOUTS)
