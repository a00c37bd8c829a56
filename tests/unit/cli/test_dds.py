"""`rodeo ros2 relay`: whose names are carried, and where the bridge may connect."""

from __future__ import annotations

import threading

import pytest

from rodeo.errors import ConfigError
from rodeo.site.config import Site
from rodeo.site.topics import Form
from rodeo_cli.dds import names_of_node, relayed
from tests.support.site import LAB

SITE = Site.load(LAB)
HERE = "tcp/127.0.0.1:0"


def test_a_participants_nodes_have_the_organizations_names() -> None:
    gives, takes = names_of_node(SITE, "panther1")
    assert [name for _, name in gives] == ["lab/panther1/do_task"]
    forms = {name: topic.form for topic, name in takes}
    assert forms["lab/panther1/register_task"] is forms["lab/panther1/get_tasks"] is Form.SERVICE
    assert (forms["lab/panther1/create_task"], forms["lab/panther1/events"]) == (Form.ACTION, Form.TOPIC)
    assert {topic.type for topic, _ in takes if "..." in topic.type} == set()


def test_a_robots_mind_has_its_recorders_names_too() -> None:
    (robot,) = SITE.robots
    mind = robot.model_copy(update={"mind": "node.anna", "namespace": "fleet/panther1"})
    _, takes = names_of_node(SITE.model_copy(update={"robots": [mind]}), "anna")
    names = {name for _, name in takes}
    assert {"fleet/panther1/start_recording", "fleet/panther1/orders", "lab/anna/tasks"} <= names


@pytest.mark.parametrize(
    ("name", "listen", "says"),
    [
        ("panther1", "tcp/0.0.0.0:7450", "on this computer alone"),
        ("panther1", HERE, "no robot with body"),
        ("nobody", HERE, "nobody is no robot"),
    ],
)
def test_nobody_else_can_speak_as_the_robot(name: str, listen: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says), relayed(SITE, name, listen, threading.Event()):
        pass
