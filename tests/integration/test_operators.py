"""People around a robot: operators give it orders that hold, a person does what it asks for and is paid."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from decimal import Decimal
from typing import Any

import cv2
import numpy as np
import pytest

from rodeo.dao import Participant
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo.person.statement import Executor, NotAccepted, NotYourTask, read_statement
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.ros_body import RosBody
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo.signing import wallets
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.live import LiveDao, living
from tests.support.site import NewSite

pytestmark = pytest.mark.long

SITE = """clock.speed = 20
clock.idle_speed = 400
agent.explore_when_idle = true
people.min_window_s = 60
participants = [{ name = "alice" }]
kinds = [
    { name = "waste_disposal" },
    { name = "battery_charging" },
    { name = "wheel_cleaning", judge = "auditor" },
]

[[agent.maintenance]]
kind = "wheel_cleaning"
every_km = 0.002
reward_iec = 50
description = "Clean my wheels"
"""
PNG = cv2.imencode(".png", np.full((48, 64, 3), 120, np.uint8))[1].tobytes()


@pytest.fixture(scope="module")
def organization(new_site: NewSite) -> Iterator[LiveDao]:
    path = new_site(SITE)
    with living(path, "bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent") as organization:
        yield organization


def order(organization: LiveDao, name: str) -> dict[str, Any]:
    bus, org = organization.running.bus, organization.running.site.org
    return bus.query(f"rodeo/{org}/robot/panther1/{name}")


def service_state(organization: LiveDao) -> str:
    dao = Participant(organization.running.bus, organization.running.site.org, "panther1")
    service = dao.own_service("waste_disposal")
    assert service is not None
    return service.state


def test_a_robot_asks_a_person_to_clean_its_wheels_and_an_auditor_has_it_paid(
    organization: LiveDao,
) -> None:
    running, site = organization.running, organization.running.site
    alice = Participant(running.bus, site.org, "alice")
    alice.offer_service("wheel_cleaning", Decimal(40), "I clean wheels")
    wait_until(lambda: alice.assignments("wheel_cleaning"), "waited for the robot to ask")
    (task, *_) = alice.assignments("wheel_cleaning")
    assert (task.creator_name, task.description) == ("panther1", "Clean my wheels")

    clock = SimClock(running.bus.session, site.bus.domain_id)
    assert clock.wait_ready(threading.Event(), HANG_S)
    person = Executor(site, alice, wallets.load(site, "alice"), clock)
    with pytest.raises(NotAccepted):
        person.submit(task.id, "clean", [PNG])
    person.accept(task.id)
    stranger = Executor(
        site, Participant(running.bus, site.org, "panther1"), wallets.load(site, "alice"), clock
    )
    with pytest.raises(NotYourTask):
        stranger.accept(task.id)
    sha256 = person.submit(task.id, "They are clean again.", [PNG])

    organization.wait_for_event("ProofSubmitted", task.id)
    submitted = organization.task(task.id)
    proof = open_proof(Store(site).fetch(submitted["proof_uri"], sha256))
    assert read_statement(proof).photos == (PNG,)
    auditor = Participant(running.bus, site.org, "organization")
    ruling = {
        "task_id": task.id,
        "attempt": task.attempt,
        "proof_sha256": sha256,
        "ruling": "accepted",
        "amount_iec": "40",
        "reason": "seen",
        "report_sha256": sha256,
        "report_uri": submitted["proof_uri"],
    }
    running.bus.query(f"rodeo/{site.org}/wallet/{auditor.name}/rule", ruling, timeout_s=HANG_S)
    organization.wait_for_event("TaskSettled", task.id)
    assert Decimal(organization.task(task.id)["paid_iec"]) == 40


def test_a_pause_holds_across_a_restart_and_the_service_is_paused_on_chain(
    organization: LiveDao,
) -> None:
    assert order(organization, "pause")["paused"] is True
    wait_until(lambda: service_state(organization) == "paused", "waited for the service to pause")
    organization.running.kill("robot_agent")
    organization.running.start("robot_agent")
    assert order(organization, "state")["paused"] is True
    assert service_state(organization) == "paused"
    organization.lay("item1")
    task_id = organization.clean("item1", allow_wait=True)
    assert organization.task(task_id)["state"] == "open"
    assert order(organization, "resume")["paused"] is False
    organization.wait_for_event("TaskSettled", task_id)


def test_a_stopped_robot_stands_still_in_the_middle_of_its_work_and_goes_on_when_resumed(
    organization: LiveDao,
) -> None:
    running = organization.running
    clock = SimClock(running.bus.session, running.site.bus.domain_id)
    assert clock.wait_ready(threading.Event(), HANG_S)
    node, robot = Node(running.bus.session, "test", "", 0, clock), running.site.robots[0]
    body = RosBody(node, running.site, robot, clock, Interrupts())
    organization.lay("item3")
    task_id = organization.clean("item3")
    wait_until(lambda: order(organization, "state")["task_id"] == task_id, "waited for the robot to work")
    assert order(organization, "stop")["stopped"] is True
    wait_until(lambda: "stopped" in order(organization, "state")["activity"], "waited for it to say so")
    first = body.base_pose(), body.joints().arm_rad
    clock.wait_until(clock.now_s() + 2.0)
    here = body.base_pose(), body.joints().arm_rad
    assert math.dist((first[0].x_m, first[0].y_m), (here[0].x_m, here[0].y_m)) < 0.02
    assert np.abs(first[1] - here[1]).max() < 0.02
    order(organization, "resume")
    organization.wait_for_event("TaskSettled", task_id)


def test_a_cancelled_attempt_fails_on_chain_with_its_reason_and_the_arm_folded(
    organization: LiveDao,
) -> None:
    task_id = organization.clean("item2", max_attempts=1)
    wait_until(lambda: order(organization, "state")["task_id"] == task_id, "waited for the robot to work")
    order(organization, "cancel")
    organization.wait_for_event("TaskFailed", task_id)
    reason = organization.task(task_id)["reason"]
    assert reason.startswith('not_given_up: the executor reports: "given up by an operator"')


def test_an_ordered_charge_is_bought_at_once(organization: LiveDao) -> None:
    assert order(organization, "charge")["charge_ordered"] is True
    organization._wait(
        lambda: any(
            e.name == "TaskAssigned" and organization.task(e.task_id or 0)["kind"] == "battery_charging"
            for e in list(organization.events)
        ),
        "a charging task",
    )
    wait_until(lambda: not order(organization, "state")["charge_ordered"], "waited for the order to be done")
