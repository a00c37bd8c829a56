"""The router's rules cover the table of keys."""

import pytest
import zenoh

from deploy.access import access_control, everybody
from rodeo.config import Site
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.processes import PROCESSES
from rodeo.topics import SEAL, TOPICS, WITNESS_STATEMENT, WITNESS_STATEMENTS, Topic
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


@pytest.mark.parametrize("topic", [SEAL, WITNESS_STATEMENT, WITNESS_STATEMENTS], ids=lambda topic: topic.key)
def test_a_device_speaks_through_the_process_that_has_its_key(
    rules: dict[str, dict[str, list[str]]], topic: Topic
) -> None:
    site = Site.load(LAB)
    speakers = {
        device: [
            name
            for name in everybody(site)
            if any(
                zenoh.KeyExpr(topic.name(org=site.org, device=device)).intersects(zenoh.KeyExpr(key))
                for key in rules[f"{name} writes"]["key_exprs"]
            )
        ]
        for device in (site.bin.name, site.dock.name, "panther1", "mocap", "somebody")
    }
    assert speakers == {
        site.bin.name: ["itrash"],
        site.dock.name: ["charger"],
        "panther1": ["robot_agent"],
        "mocap": ["robot_sim"],
        "somebody": [],
    }


@pytest.mark.parametrize("process", ["itrash", "robot_sim"])
def test_a_witness_asks_the_organizations_wallet_for_the_root_of_its_day_and_nothing_else(
    rules: dict[str, dict[str, list[str]]], process: str
) -> None:
    asked = [key for key in rules[f"{process} asks"]["key_exprs"] if "/wallet/" in key]
    assert asked == ["rodeo/lab/wallet/organization/post_root"]


def test_only_robot_sim_tells_the_time(rules: dict[str, dict[str, list[str]]]) -> None:
    clock = zenoh.KeyExpr("0/clock/**")
    speakers = {
        name
        for name in everybody(Site.load(LAB))
        if any(clock.intersects(zenoh.KeyExpr(key)) for key in rules[f"{name} writes"]["key_exprs"])
    }
    assert speakers == {"robot_sim"}
