"""Nodes that know ROS 2 and nothing of this project post a task, do it for pay, and hear every event."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from bench.faults.net import Link
from deploy.certificates import ensure_certificates
from rodeo.interfaces.package import register
from rodeo.site.config import Site
from rodeo_testing.waiting import wait_until
from tests.integration.test_ros_dao import Caller, done
from tests.support.dao import Dao, founded
from tests.support.ros_nodes import RosNode
from tests.support.site import NewSite, free_port

pytestmark = pytest.mark.long

CUT_OFF_S = 10.0
SITE = """bus.router = "tls/127.0.0.1:{port}"
clock.speed = 1
ros = [
    {{ owner = "annas", participants = ["anna"] }},
    {{ owner = "mine", participants = ["panther1"] }},
]
[[participants]]
name = "anna"

[[robots]]
name = "panther1"
mind = "node.panther1"
pose = {{ x_m = 3.6, y_m = 1.5 }}

[[items]]
id = "item1"
class = "metal"
shape = "can"
pose = {{ x_m = 5.0, y_m = 2.2 }}
mass_kg = 0.03
"""
OURS = {"rodeo", "rodeo_kinds", "rodeo_cli", "services", "deploy"}
BRIDGES = ("ros_dao.annas", "ros_dao.mine")


@pytest.fixture
def dao(new_site: NewSite) -> Iterator[Dao]:
    path = new_site(SITE.format(port=free_port()))
    ensure_certificates(Site.load(path))
    with founded(path, "robot_sim", "itrash", "oracle", "robot_recorder", *BRIDGES) as organization:
        register()
        robot = Caller(organization, "panther1")
        done(robot.call("transfer", to="anna", amount_iec="200"))
        robot.close()
        wait_until(lambda: organization.balances()["anna"] == 200)
        yield organization


def events_in(log: str) -> list[int]:
    return [int(number) for number in re.findall(r"event (\d+): ", log)]


def test_a_mind_of_foreign_nodes_cleans_for_pay_while_processes_die_and_links_break(dao: Dao) -> None:
    site, item = dao.site, dao.site.items[0]
    first, before = int(dao.state("chain")["last_seq"]), dao.balances()
    with ExitStack() as closing:
        link = closing.enter_context(Link(int(site.bus.router.rpartition(":")[2])))

        def node(name: str, participant: str, router: str = "", **parameters: object) -> RosNode:
            started = RosNode(site, name, participant, router, **parameters)
            closing.callback(started.kill)
            return started

        board = node("balances", "anna", f"tls/127.0.0.1:{link.port}", after=first)
        mind = node("mind", "panther1")

        def story() -> str:
            logs = [dao.running.log(name) for name in ("robot_recorder", "oracle", *BRIDGES)]
            return "\n".join([mind.log[-4000:], board.log[-2000:], *logs])

        wait_until(lambda: "ServiceRegistered" in board.log, story)
        link.cut()
        cut_s = time.monotonic()
        place = [item.pose.x_m, item.pose.y_m]
        poster = node("post_a_task", "anna", item=item.id, place=place)
        wait_until(lambda: "driving to" in mind.log, story)
        for name in BRIDGES:
            dao.running.kill(name)
        dao.running.start(*BRIDGES)
        wait_until(lambda: time.monotonic() - cut_s >= CUT_OFF_S)
        assert dao.state("tasks", creator="anna")["tasks"] and "TaskRegistered" not in board.log
        link.heal()

        wait_until(lambda: poster.process.poll() is not None, story)
        assert poster.process.returncode == 0, poster.log + story()
        assert "90 IEC paid, verdict accepted" in poster.log
        (task,) = dao.state("tasks", creator="anna")["tasks"]
        assert (task["state"], task["attempt"], task["executor_name"]) == ("settled", 1, "panther1"), story()
        assert mind.log.count("driving to") == 1
        after = dao.balances()
        assert (after["anna"] - before["anna"], after["panther1"] - before["panther1"]) == (-90, 90)

        last = int(dao.state("chain")["last_seq"])
        wait_until(lambda: last in events_in(board.log), story)
        assert events_in(board.log) == list(range(first + 1, last + 1))
        for one in (mind, board):
            assert one.interrupt() == 0, one.log
        for one in (mind, board, poster):
            assert not one.modules & OURS
