"""A whole site, all its processes: the robot works, is interrupted, fails honestly, explores and charges."""

from __future__ import annotations

import itertools
import math
import os
import signal
from collections.abc import Iterator
from decimal import Decimal
from hashlib import sha256

import numpy as np
import pytest

from rodeo.bus.messages import Task
from rodeo.dao import Participant
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo.host.clock import WallClock
from rodeo.person.statement import judge
from rodeo.robot.decisions import Explained
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.ros_body import RosBody
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.witness.motion import track
from rodeo.witness.statement import Classification, Drop, Motion, parse
from rodeo_testing.waiting import wait_until
from services.robot_agent.energy import Consumption
from tests.support.live import LiveDao, living
from tests.support.site import NewSite

MIN_UPDATE_S = 120.0
ORACLE_BELOW_IEC = 300
SITE = f"""clock.speed = 20
clock.idle_speed = 400
agent.explore_when_idle = true

[[robots]]
name = "panther1"
pose = {{ x_m = 1.4, y_m = 1.3, yaw_rad = 0.0 }}
battery = {{ soc = 0.8 }}

[[kinds]]
name = "waste_disposal"
oracle_below_iec = {ORACLE_BELOW_IEC}

[[kinds]]
name = "battery_charging"

[[things]]
id = "cup"
class = "plastic"
shape = "cup"
pose = {{ x_m = 3.7, y_m = 0.9 }}
mass_kg = 0.03

[[things]]
id = "carton"
class = "cardboard"
shape = "box"
pose = {{ x_m = 1.9, y_m = 3.2, yaw_rad = 0.5 }}
mass_kg = 0.04

[robots.pricing.kinds.waste_disposal]
method = "cost_plus"
margin = 0.5
wear_iec_per_km = 500
min_update_s = {MIN_UPDATE_S}
min_change = 0.01
"""


@pytest.fixture(scope="module")
def organization(new_site: NewSite) -> Iterator[LiveDao]:
    with living(new_site(SITE)) as organization:
        yield organization


@pytest.mark.long
def test_an_idle_robot_explores(organization: LiveDao) -> None:
    running = organization.running
    organization.wait_for_activity("exploring")
    clock = WallClock()
    node, robot = Node(running.bus.session, "test", "", 0, clock), running.site.robots[0]
    body = RosBody(node, running.site, robot, clock, Interrupts())
    start = body.base_pose()

    def moved_m() -> float:
        here = body.base_pose()
        return math.dist((here.x_m, here.y_m), (start.x_m, start.y_m))

    wait_until(lambda: moved_m() > 0.3, "it did not move")


@pytest.mark.long
def test_a_robot_killed_with_the_item_in_its_gripper_starts_again_and_is_paid(
    organization: LiveDao,
) -> None:
    organization.lay("item1")
    organization.activities.clear()
    task_id = organization.clean("item1")
    organization.wait_for_activity("carrying item1")
    running = organization.running
    os.kill(running.children["robot_agent"].pid, signal.SIGSTOP)
    # Who holds the clock for long is named; who dies while it does so holds nothing any more.
    waits = "the clock waits for robot_agent"
    running.wait_for_status("robot_sim", lambda status: waits in status.warnings)
    running.kill("robot_agent")
    running.wait_for_status("robot_sim", lambda status: waits not in status.warnings)
    running.start("robot_agent", ready=False)
    organization.wait_for_event("TaskSettled", task_id)
    task = organization.task(task_id)
    assert (task["state"], task["attempt"], task["verdict"]) == ("settled", 1, "accepted")
    assert "putting item1 back to start again" in organization.activities


@pytest.mark.long
def test_what_cannot_be_done_costs_the_robot_nothing(organization: LiveDao) -> None:
    # What it can tell beforehand it abandons, without a proof that somebody had to reject.
    unknown = {"item_id": "item99", "x_m": 1.0, "y_m": 1.0}
    nowhere = {"item_id": "item2", "x_m": 1.0, "y_m": 1.0, "bin": "nowhere"}
    behind_a_wall = {"item_id": "item2", "x_m": -3.0, "y_m": 1.0}
    for params in (unknown, nowhere, behind_a_wall):
        task_id = organization.clean("item2", params=params, max_attempts=1)
        organization.wait_for_event("TaskRequeued", task_id)
        task = organization.task(task_id)
        assert (task["verdict"], task["proof_sha256"], task["state"]) == ("abandoned", None, "open")
        organization.cancel(task_id)  # no other robot is there, and this one is not offered it again

    # Where it has to look, motion capture vouches for what it does not find.
    pose = organization.running.site.items[1].pose
    beside = {"item_id": "item2", "x_m": pose.x_m, "y_m": pose.y_m - 0.6}
    task_id = organization.clean("item2", params=beside)
    organization.wait_for_event("TaskSettled", task_id)
    task = organization.task(task_id)
    assert (task["verdict"], task["attempt"]) == ("impossible", 1), task["reason"]
    assert Decimal(task["paid_iec"]) == Decimal(task["price_iec"]) / 10


def test_the_robot_goes_on_and_its_proof_holds_every_recorded_topic_the_events_and_the_bins_word(
    organization: LiveDao,
) -> None:
    organization.lay("item3")
    task_id = organization.clean("item3")
    organization.wait_for_event("TaskSettled", task_id)
    running = organization.running
    key = topics.ROBOT_ORDER.name(org=running.site.org, robot="panther1", order="explain")
    explained = Explained.model_validate(running.bus.query(key, parameters={"task_id": task_id, "limit": 5}))
    assert "work" in [one.intent for one in explained.decisions]
    assert {one.task_id for one in explained.decisions} == {task_id}
    task = organization.task(task_id)
    store = Store(running.site)
    proof = open_proof(store.fetch(task["proof_uri"], task["proof_sha256"], 1 << 28))
    assert {
        "/panther1/odom",
        "/panther1/joint_states",
        "/panther1/battery_state",
        "/itrash/blue/load",
    } <= proof.topics.keys()
    assert not [topic for topic in proof.topics if topic.startswith("/mocap/")]
    names = [event.get("name") for event in proof.events()]
    assert names[:2] == ["TaskRegistered", "TaskAssigned"]
    statements = [parse(attestation.payload) for attestation in proof.attestations()]
    # The bin looks at whatever comes before it, now and then also at the empty gripper.
    (fallen,) = [one for one in statements if isinstance(one, Drop)]
    (shown,) = [
        one for one in statements if isinstance(one, Classification) and one.number == fallen.classification
    ]
    assert shown.compartment == fallen.compartment
    assert (task_id, proof.recording) in [(one.task_id, one.recording) for one in fallen.claimants]
    assert proof.end_ns * 1e-9 >= fallen.settled_s + 10.0
    pictures = proof.topics["/itrash/camera/image/compressed"].data
    kept = [types.deserialize(data, topics.BIN_IMAGE.type).data.tobytes() for data in pictures]
    assert shown.image_sha256 in ["0x" + sha256(data).hexdigest() for data in kept]
    motion = sorted((one for one in statements if isinstance(one, Motion)), key=lambda one: one.seq)
    assert [one.seq for one in motion] == list(range(motion[0].seq, motion[-1].seq + 1))
    listed = [one.seq for one in motion if proof.recording in {head.chain for head in one.heads}]
    lying = site_pose(organization, "item3")
    item = track(motion, "item3")
    assert item is not None
    moved = np.hypot(*(item.position_m[:, :2] - lying).T) > 0.03
    assert listed[0] < motion[int(item.statement[moved.argmax()])].seq


def thing_task(organization: LiveDao, thing: str, reward_iec: str) -> int:
    pose = next(one.pose for one in organization.running.site.things if one.id == thing)
    return organization.post(reward_iec, params={"x_m": pose.x_m + 0.1, "y_m": pose.y_m})


@pytest.mark.long
def test_what_nobody_listed_is_taken_from_its_place_and_paid_below_the_price_that_the_oracle_may_accept(
    organization: LiveDao,
) -> None:
    task_id = thing_task(organization, "cup", str(ORACLE_BELOW_IEC - 1))
    organization.wait_for_event("TaskSettled", task_id)
    task = organization.task(task_id)
    assert (task["verdict"], task["attempt"], task["passed_on"]) == ("accepted", 1, False), task["reason"]


@pytest.mark.long
def test_auditors_decide_about_what_nobody_listed_where_the_oracle_only_proposes(
    organization: LiveDao,
) -> None:
    task_id = thing_task(organization, "carton", str(ORACLE_BELOW_IEC))
    organization.wait_for_event("PassedOn", task_id)
    task = organization.task(task_id)
    assert "proposal: accepted. Motion capture signed base and gripper" in task["reason"]
    running = organization.running
    auditor = Participant(running.bus, running.site.org, "organization")
    judge(running.site, auditor, task_id, "accepted", "The pictures show the carton.")
    organization.wait_for_event("TaskSettled", task_id)
    task = organization.task(task_id)
    assert (task["state"], task["verdict"]) == ("settled", "accepted")


def site_pose(organization: LiveDao, item_id: str) -> tuple[float, float]:
    pose = next(item.pose for item in organization.running.site.items if item.id == item_id)
    return pose.x_m, pose.y_m


@pytest.mark.long
def test_the_robots_price_follows_what_its_work_cost_and_changes_seldom(organization: LiveDao) -> None:
    """After the tests above: it has measured what a cleaning takes."""
    robot = Participant(organization.running.bus, organization.running.site.org, "panther1")

    def price() -> Decimal:
        service = robot.own_service("waste_disposal")
        assert service is not None
        return service.price_iec

    wait_until(lambda: price() != 100, lambda: organization.running.log("robot_agent"))
    # How far it had to drive depends on where it was. An IEC buys about a Wh.
    site = organization.running.site
    found = Consumption.load(site.data_dir / "robot_agent/consumption.json", site.robots[0].battery)
    wear_iec = 500 * found.way_of_m["waste_disposal"] / 1000
    iec_per_wh = (float(price()) / 1.5 - wear_iec) / found.energy_of_wh["waste_disposal"]
    assert 0.5 < iec_per_wh < 2 and found.way_of_m["waste_disposal"] > 1
    updates = [event for event in list(organization.events) if event.name == "ServiceUpdated"]
    prices = itertools.groupby(updates, key=lambda event: event.args["price_iec"])
    changes = [next(same).time_s for _price, same in prices]
    assert all(b - a >= MIN_UPDATE_S - 5 for a, b in itertools.pairwise(changes))


def test_a_whole_site_settles_a_cleaning_and_a_charge_and_each_is_paid_by_the_one_it_served(
    organization: LiveDao,
) -> None:
    running = organization.running
    robot = Participant(running.bus, running.site.org, "panther1")

    def settled(kind: str) -> list[Task]:
        return [task for task in robot.tasks(state="settled") if task.kind == kind]

    assert settled("waste_disposal") and not settled("battery_charging")
    before_iec = organization.balances_iec()
    charge_id = max(task.id for task in robot.tasks()) + 1
    running.bus.query(topics.ROBOT_ORDER.name(org=running.site.org, robot="panther1", order="charge"))
    organization.wait_for_event("TaskSettled", charge_id)
    (charge,) = settled("battery_charging")
    assert (charge.id, charge.verdict, charge.creator_name, charge.executor_name) == (
        *(charge_id, "accepted", "panther1", "organization"),
    ), charge.reason
    assert charge.paid_iec is not None and charge.paid_iec > 0
    changed_iec = {name: iec - before_iec[name] for name, iec in organization.balances_iec().items()}
    assert changed_iec == {
        **dict.fromkeys(before_iec, 0),
        "panther1": -charge.paid_iec,
        "organization": charge.paid_iec,
    }
    for name in running.children:
        running.wait_for_status(name, lambda one: one.ready)
