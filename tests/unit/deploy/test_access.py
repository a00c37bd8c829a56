"""The router's rules cover the table of keys."""

import pytest
import zenoh

from deploy.access import access_control, everybody
from deploy.processes import PROCESSES
from rodeo.config import Site
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.topics import TOPICS
from tests.support.site import LAB


@pytest.fixture(scope="module")
def rules() -> dict[str, dict[str, list[str]]]:
    return {rule["id"]: rule for rule in access_control(Site.load(LAB))["rules"]}


def test_every_key_has_a_writer_who_may_be_on_the_bus() -> None:
    known = {*everybody(Site.load(LAB)), "every process", "console"}
    assert {topic.writer for topic in TOPICS} <= known


def test_no_two_processes_may_write_the_same(rules: dict[str, dict[str, list[str]]]) -> None:
    graph = "@ros2_lv/**"
    written = {
        process.name: [key for key in rules[f"{process.name} writes"]["key_exprs"] if key != graph]
        for process in PROCESSES
    }
    for name, keys in written.items():
        for other, others in written.items():
            for key in keys:
                clashes = [o for o in others if zenoh.KeyExpr(key).intersects(zenoh.KeyExpr(o))]
                assert name == other or not clashes, (name, other, key, clashes)


def test_each_of_several_robots_minds_may_spend_from_its_own_wallet_only() -> None:
    robots = [RobotConfig(name=name, pose=Pose2(x_m=1, y_m=1)) for name in ("panther1", "panther2")]
    site = Site.load(LAB).model_copy(update={"robots": robots})
    rules = {rule["id"]: rule["key_exprs"] for rule in access_control(site)["rules"]}
    for name in ("panther1", "panther2"):
        asked = rules[f"robot_agent.{name} asks"]
        assert [key for key in asked if "/wallet/" in key] == [f"rodeo/lab/wallet/{name}/**"]
        assert "0/panther1/cmd_vel/**" in rules[f"robot_agent.{name} writes"]
