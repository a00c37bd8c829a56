"""A robot whose mind is a ROS 2 node: its recorder records, signs and takes orders."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from typing import Any

import pytest

from rodeo.bus.session import Bus
from rodeo.dao import Participant
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo.host.clock import WallClock
from rodeo.interfaces.package import register
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient
from rodeo.ros2.errors import GoalAborted, GoalRejected
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo.site.topics import Topic
from rodeo.witness.witness import unverified_seal
from rodeo_cli.site import read_rows
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import NewSite, RunningSite

pytestmark = pytest.mark.long

ROBOTS = ("panther1", "panther2", "panther3")
SITE = "clock.speed = 5\nagent.explore_when_idle = false\n" + "".join(
    f'[[robots]]\nname = "{name}"\nmind = "node.{name}"\npose = {{ x_m = {1.4 + number}, y_m = 1.3 }}\n'
    for number, name in enumerate(ROBOTS)
)


class Mind:
    """A node that moves the body and asks the recorder; `close` is its death."""

    def __init__(self, running: RunningSite, robot: str) -> None:
        register()
        self.bus = Bus.open(running.site.bus.router, timeout_s=HANG_S)
        self.node = Node(self.bus.session, "mind", robot, running.site.bus.domain_id, WallClock())
        self._robot = robot
        self._clients = {
            topic: self.node.client(topic.name(ns=robot), topic.type)
            for topic in (topics.START_RECORDING, topics.PRESENT, topics.STOP_RECORDING)
        }
        go = topics.NAVIGATE_TO_POSE
        self.base = ActionClient(self.node, go.name(ns=robot), go.type)

    def ask(self, topic: Topic, **fields: Any) -> Any:
        client = self._clients[topic]
        assert client.wait_for_server(HANG_S)
        return client.call(types.new(f"{topic.type}_Request", **fields), HANG_S)

    def drive(self, x_m: float, y_m: float) -> Any:
        pose = types.new("geometry_msgs/msg/PoseStamped")
        pose.header.frame_id = "map"
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = x_m, y_m, 1.0
        assert self.base.wait_for_server(HANG_S)
        return self.base.send_goal(
            types.new(f"{topics.NAVIGATE_TO_POSE.type}_Goal", pose=pose), timeout_s=HANG_S
        )

    def close(self) -> None:
        self.node.close()
        self.bus.close()


class Lab:
    """The site, whose robots have one task each, and the organization's side of it."""

    def __init__(self, running: RunningSite) -> None:
        self.running = running
        self.org = running.site.org
        self.clock = SimClock(running.bus.session, running.site.bus.domain_id)
        assert self.clock.wait_ready(threading.Event(), HANG_S)
        self.tasks = {robot: self._assigned(robot) for robot in ROBOTS}

    def _assigned(self, robot: str) -> int:
        """A task that the robot has accepted."""
        dao, item = Participant(self.running.bus, self.org, robot), self.running.site.items[0]
        dao.offer_service("waste_disposal", Decimal(100), "cleans")
        params = {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
        request = {"kind": "waste_disposal", "reward_iec": "100", "params": params, "provider": robot}
        key = topics.COMMAND.name(org=self.org, participant="organization", command="register_task")
        task_id = int(self.running.bus.query(key, request, timeout_s=HANG_S)["task_id"])
        wait_until(lambda: dao.task(task_id).state == "assigned", f"task {task_id} is not assigned")
        dao.accept_task(dao.task(task_id))
        return task_id

    def order(self, robot: str, word: str) -> dict[str, Any]:
        key = topics.ROBOT_ORDER.name(org=self.org, robot=robot, order=word)
        return self.running.bus.query(key, timeout_s=HANG_S)


def recorder(robot: str) -> str:
    return f"robot_recorder.{robot}"


@pytest.fixture(scope="module")
def lab(new_site: NewSite) -> Iterator[Lab]:
    with RunningSite(new_site(SITE)) as running:
        running.start_founded("bridge", "robot_sim", *map(recorder, ROBOTS))
        yield Lab(running)


@contextmanager
def mind_of(lab: Lab, robot: str) -> Iterator[Mind]:
    mind = Mind(lab.running, robot)
    try:
        yield mind
    finally:
        mind.close()


def minds(lab: Lab) -> dict[str, str]:
    """What `rodeo status` says of the minds."""
    return {row.name: row.state for row in read_rows(lab.running.site) if row.name.startswith("node.")}


def code(response: Any) -> str:
    return str(response.problem[0].code) if response.problem else ""


def test_an_attempt_is_recorded_for_a_mind_and_stored(lab: Lab) -> None:
    robot, task_id = ROBOTS[0], lab.tasks[ROBOTS[0]]
    attempt = {"task_id": task_id, "attempt": 1}
    with mind_of(lab, robot) as mind:
        lab.running.wait_for_status(
            recorder(robot), lambda one: one.details.get("mind") == [f"/{robot}/mind"]
        )
        assert minds(lab) == {f"node.{one}": "ready" if one == robot else "down" for one in ROBOTS}
        started = mind.ask(topics.START_RECORDING, **attempt)
        assert (code(started), started.resumed) == ("", False)
        assert mind.ask(topics.START_RECORDING, **attempt).recording == started.recording
        assert code(mind.ask(topics.START_RECORDING, task_id=task_id, attempt=2)) == "recording_runs"

        grasped = {"grasped": types.time_message(lab.clock.now_ns())}
        assert code(mind.ask(topics.PRESENT, bin="itrash", **grasped)) == "nothing_grasped"
        assert code(mind.ask(topics.PRESENT, bin="elsewhere", **grasped)) == "unknown_bin"

        stopped = mind.ask(topics.STOP_RECORDING, **attempt, failure="the item is stuck")
        assert (code(stopped), stopped.missing) == ("", "the item is stuck")
        proof = open_proof(Store(lab.running.site).fetch(stopped.proof_uri, stopped.proof_sha256))
        assert proof.binding is not None and proof.recording == started.recording
        assert (proof.binding.task_id, proof.binding.device) == (task_id, robot)
        assert f"/{robot}/odom" in proof.topics
        assert mind.ask(topics.STOP_RECORDING, **attempt) == stopped
        assert code(mind.ask(topics.START_RECORDING, **attempt)) == "recording_over"
        assert code(mind.ask(topics.PRESENT, bin="itrash", **grasped)) == "nothing_recorded"


def test_a_recorder_records_its_own_robots_tasks_only(lab: Lab) -> None:
    with mind_of(lab, ROBOTS[0]) as mind:
        attempt = {"task_id": lab.tasks[ROBOTS[1]], "attempt": 1}
        assert code(mind.ask(topics.STOP_RECORDING, **attempt)) == "nothing_recorded"
        assert code(mind.ask(topics.START_RECORDING, **attempt)) in ("not_assigned", "recording_runs")


def test_a_stop_holds_the_body_when_the_mind_has_died_and_the_recording_goes_on(lab: Lab) -> None:
    robot = ROBOTS[1]
    attempt = {"task_id": lab.tasks[robot], "attempt": 1}
    with mind_of(lab, robot) as mind:
        started = mind.ask(topics.START_RECORDING, **attempt)
        assert code(started) == ""
        mind.drive(5.0, 3.5)
    lab.running.wait_for_status(recorder(robot), lambda one: any("no mind" in said for said in one.warnings))
    assert lab.order(robot, "stop")["stopped"] is True
    # What is ordered holds for the next mind, too.
    with mind_of(lab, robot) as mind:
        with pytest.raises((GoalRejected, GoalAborted)):
            mind.drive(2.0, 2.0).result(HANG_S)
        assert mind.ask(topics.START_RECORDING, **attempt).recording == started.recording
        assert lab.order(robot, "resume")["stopped"] is False
        assert lab.order(robot, "cancel")["task_id"] == lab.tasks[robot]
        stopped = mind.ask(topics.STOP_RECORDING, **attempt)
        assert (code(stopped), stopped.missing) == ("", "given up by an operator")


def test_a_recorder_that_is_killed_never_lets_two_recordings_grow(lab: Lab) -> None:
    """A second one that grows beside the first would be a fork."""
    robot, seals = ROBOTS[2], list[str]()

    def on_seal(_key: str, data: bytes) -> None:
        seals.append(unverified_seal(data).spoken.head.chain)

    heard = lab.running.bus.subscribe_bytes(topics.SEAL.name(org=lab.org, device=robot), on_seal)
    attempt = {"task_id": lab.tasks[robot], "attempt": 1}
    with mind_of(lab, robot) as mind:
        first = mind.ask(topics.START_RECORDING, **attempt).recording
        lab.running.kill(recorder(robot))
        lab.running.start(recorder(robot))
        second = mind.ask(topics.START_RECORDING, **attempt).recording
        wait_until(lambda: seals.count(second) >= 2, "the second recording is not sealed")
        assert first != second
        assert seals == [first] * seals.count(first) + [second] * seals.count(second)

        lab.running.kill(recorder(robot))
        lab.running.start(recorder(robot))
        # A mind that has not noticed stops it: what there is is finished as it is.
        stopped = mind.ask(topics.STOP_RECORDING, **attempt)
        assert code(stopped) == "" and "restarted" in stopped.missing
        proof = open_proof(Store(lab.running.site).fetch(stopped.proof_uri, stopped.proof_sha256))
        assert proof.recording == second
    heard.undeclare()
