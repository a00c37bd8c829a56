"""The charger on a real router, chain and bridge; the test plays the dock, the battery and the clock.

The robot signs with what its agent uses.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from decimal import Decimal
from itertools import pairwise
from typing import Any

import pytest

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.charging.metering import STEP_WH
from rodeo.commands.judging import Rule
from rodeo.commands.tasks import RegisterTask
from rodeo.dao import Participant, dock_offers
from rodeo.evidence.proof import Proof, open_proof
from rodeo.evidence.store import Store
from rodeo.signing import keystores
from rodeo.site import topics
from rodeo.witness.statement import MeterRecord, Receipt, parse
from rodeo_kinds.battery_charging.readings import unpack
from rodeo_testing.dock import TARGET_SOC, Buyer, Hardware
from rodeo_testing.waiting import HANG_S, wait_until
from services.charger.attempt import PROOF_SHARE
from tests.support.site import NewSite, RunningSite

pytestmark = pytest.mark.long

ORDERED_WH = 400.0


class Organization:
    """A running organization with a robot that buys charges."""

    def __init__(self, running: RunningSite) -> None:
        self.running = running
        self.robot = Participant(running.bus, running.site.org, running.site.robots[0].name)
        self.oracle = Participant(running.bus, running.site.org, "oracle")
        self._changed = threading.Event()
        running.bus.subscribe_json(
            f"rodeo/{running.site.org}/event/*", lambda _key, _data: self._changed.set()
        )

    def buy(self, **params: Any) -> int:
        wanted = {
            "robot": self.robot.name,
            "dock": "dock1",
            "soc_from": 0.5,
            "soc_target": TARGET_SOC,
            "energy_wh": ORDERED_WH,
            **params,
        }
        params = wanted | params
        request = RegisterTask(
            kind="battery_charging",
            reward_iec=Decimal(200),
            params=params,
            execution_window_s=14400,
            max_attempts=1,
            service_id=dock_offers(self.robot.ask(queries.SERVICES).services, self.running.site)["dock1"].id,
        )
        return self.robot.command("register_task", request).task_id or 0

    def wait_for(self, task_id: int, state: str) -> Task:
        waits = 0
        while (task := self.robot.task(task_id)).state != state:
            assert waits < HANG_S, f"task {task_id} is {task.state}\n{self.running.log('charger')}"
            waits += not self._changed.wait(1.0)
            self._changed.clear()
        return task

    def given_back(self, task_id: int, why: str) -> None:
        """Wait until the dock has given the task back, at no cost."""
        task = self.wait_for(task_id, "failed")
        assert (task.verdict, task.proof_sha256, task.refunded_iec) == ("abandoned", None, task.reward_iec)
        assert f"giving task {task_id} back: {why}" in self.running.log("charger")
        services = self.robot.ask(queries.SERVICES).services
        assert all((one.expired, one.rejected) == (0, 0) for one in services)

    def proof_of(self, task_id: int) -> Proof:
        """The proof once it is submitted, fetched and checked against the assignment; the task is settled."""
        task = self.wait_for(task_id, "submitted")
        path = Store(self.running.site).fetch(str(task.proof_uri), str(task.proof_sha256))
        proof = open_proof(path)
        assert proof.binding == self.robot.binding(task, "dock1")
        assert proof.signer == keystores.address(self.running.site, "dock1-device")
        ruling = Rule(
            task_id=task.id,
            attempt=task.attempt,
            proof_sha256=str(task.proof_sha256),
            ruling="accepted",
            amount_iec=task.price_iec,
            reason="",
            report_sha256="0x" + "00" * 32,
            report_uri="",
        )
        self.oracle.command("rule", ruling)
        self.wait_for(task_id, "settled")
        return proof


def records(proof: Proof) -> list[MeterRecord]:
    said = (parse(one.payload) for one in proof.attestations())
    return [one for one in said if isinstance(one, MeterRecord)]


def receipts(proof: Proof) -> list[Receipt]:
    said = (parse(one.payload) for one in proof.attestations())
    return [one for one in said if isinstance(one, Receipt)]


def readings(proof: Proof) -> list[float]:
    """When they were read, s."""
    return [time_s for one in records(proof) for time_s in unpack(one.since_ms, one.readings).time_s]


def delivered_wh(proof: Proof) -> float:
    """What both signed."""
    said = records(proof)
    assert len({one.begin_wh for one in said}) == 1
    return max(one.register_wh for one in receipts(proof)) - said[0].begin_wh


def session_end(proof: Proof) -> dict[str, Any]:
    return next(event for event in proof.events() if event.get("event") == "session_ended")


@pytest.fixture(scope="module")
def organization(new_site: NewSite) -> Iterator[tuple[Organization, list[Hardware]]]:
    with RunningSite(new_site()) as running:
        running.start("router")
        hardware = [Hardware(running)]
        hardware[0].fast = False
        running.start_founded("bridge")
        yield Organization(running), hardware
        for one in hardware:
            one.close()


@pytest.fixture
def dao(organization: tuple[Organization, list[Hardware]]) -> Organization:
    return organization[0]


@pytest.fixture
def hardware(organization: tuple[Organization, list[Hardware]]) -> Iterator[Hardware]:
    one = organization[1][0]
    one.docked, one.closed, one.soc, one.energy_wh, one.fast = False, False, 0.5, 0.0, False
    one.gauge, one.malformed, one.hurry_until_s = 1.0, False, 0.0
    one.commands.clear()
    yield one
    one.fast = False


@pytest.fixture
def buyer(dao: Organization, hardware: Hardware) -> Iterator[Buyer]:
    one = Buyer(dao.running, hardware)
    yield one
    one.close()


@pytest.fixture(autouse=True)
def charger(dao: Organization, hardware: Hardware) -> Iterator[None]:
    if "charger" not in dao.running.children:
        dao.running.start("charger")
    yield


def docked(dao: Organization, hardware: Hardware, buyer: Buyer | None, **params: Any) -> int:
    """A robot that bought a charge stands on the dock and, if its computer is on, is charged."""
    task_id = dao.buy(**params)
    if buyer is not None:
        buyer.begin(dao.robot.task(task_id))
    hardware.docked = True
    if buyer is not None:
        hardware.wait_for_command(True)
    return task_id


def hurry_to_the_window(dao: Organization, hardware: Hardware, task_id: int) -> None:
    task = dao.wait_for(task_id, "assigned")
    assert task.assigned is not None
    hardware.hurry_until_s = task.assigned + (1 - PROOF_SHARE) * task.execution_window_s - 30
    # Hours of site time; how long they take depends on the machine.
    wait_until(lambda: hardware.now_s() >= hardware.hurry_until_s)


def test_a_charge_is_delivered_metered_countersigned_sealed_and_submitted(
    dao: Organization, hardware: Hardware, buyer: Buyer
) -> None:
    task_id = docked(dao, hardware, buyer)
    hardware.fast = True
    proof = dao.proof_of(task_id)
    assert hardware.commands[-1] is False
    assert TARGET_SOC <= hardware.soc < TARGET_SOC + 0.02
    said = records(proof)
    assert {(s.task_id, s.attempt, s.device, s.recording) for s in said} == {
        (task_id, 1, "dock1", proof.recording)
    }
    assert [one.page for one in said] == list(range(1, len(said) + 1))
    assert (said[0].reason, said[-1].reason) == ("opening", "close")
    assert said[-1].register_wh - said[0].begin_wh == pytest.approx(hardware.energy_wh, rel=0.002)
    signed = receipts(proof)
    assert (signed[0].reason, signed[-1].reason) == ("opening", "close")
    assert delivered_wh(proof) == said[-1].register_wh - said[0].begin_wh
    assert any(head.chain == proof.recording for head in signed[0].heads)
    times = readings(proof)
    assert all(after - before == pytest.approx(1.0) for before, after in pairwise(times))
    gained = proof.table("/panther1/battery_state", topics.BATTERY_STATE.type)["percentage"]
    assert gained[0] == pytest.approx(0.5, abs=0.01)
    assert gained[-1] >= 0.9
    names = [event.get("name") or event["event"] for event in proof.events()]
    assert {"assignment", "TaskRegistered", "TaskAssigned", "session_ended"} <= set(names)
    assert session_end(proof)["reason"] == "target_reached"


def test_a_charger_killed_while_charging_goes_on_and_its_register_too(
    dao: Organization, hardware: Hardware, buyer: Buyer
) -> None:
    task_id = docked(dao, hardware, buyer)
    hardware.fast = True
    wait_until(lambda: hardware.soc >= 0.6, lambda: dao.running.log("charger"))
    hardware.fast = False
    dao.running.kill("charger")
    dao.running.start("charger")
    hardware.fast = True
    proof = dao.proof_of(task_id)
    said = records(proof)
    assert [one.page for one in said] == list(range(1, len(said) + 1))
    register_wh = [said[0].begin_wh, *(one.register_wh for one in said)]
    assert register_wh == sorted(register_wh), "the register continues where it stood when the charger died"
    times = readings(proof)
    gap_s = max(after - before for before, after in pairwise(times))
    assert gap_s >= 2.0, "readings are a second apart: one is missing at least"
    unmetered_wh = gap_s * 42.0 * 11.5 / 3600
    assert hardware.energy_wh - unmetered_wh - 2.0 < delivered_wh(proof) < hardware.energy_wh
    assert "recording_resumed" in {event.get("event") for event in proof.events()}
    assert session_end(proof)["reason"] == "target_reached"
    assert hardware.commands[-1] is False


def test_a_robot_that_signs_nothing_gets_nothing_and_costs_the_seller_nothing(
    dao: Organization, hardware: Hardware
) -> None:
    task_id = docked(dao, hardware, None)
    hardware.fast = True
    dao.given_back(task_id, "not_signed")
    assert True not in hardware.commands
    assert hardware.energy_wh == 0


def test_a_robot_that_falls_silent_costs_the_seller_a_step_and_goes_on_when_it_is_back(
    dao: Organization, hardware: Hardware, buyer: Buyer
) -> None:
    task_id = docked(dao, hardware, buyer)
    wait_until(lambda: hardware.energy_wh > 2 * STEP_WH, lambda: dao.running.log("charger"))
    buyer.close()
    hardware.wait_for_command(False)
    silent_wh = hardware.energy_wh
    back = Buyer(dao.running, hardware)
    try:
        back.begin(dao.robot.task(task_id))
        hardware.wait_for_command(True)
        hardware.fast = True
        proof = dao.proof_of(task_id)
    finally:
        back.close()
    assert session_end(proof)["reason"] == "target_reached"
    before = [one for one in receipts(proof) if one.register_wh - records(proof)[0].begin_wh <= silent_wh]
    assert silent_wh - (before[-1].register_wh - records(proof)[0].begin_wh) < 1.5 * STEP_WH
    assert delivered_wh(proof) == pytest.approx(hardware.energy_wh, rel=0.005)


def test_a_gauge_that_lies_costs_the_seller_a_step_and_what_both_signed_is_what_was_delivered(
    dao: Organization, hardware: Hardware, buyer: Buyer
) -> None:
    task_id = docked(dao, hardware, buyer)
    wait_until(lambda: hardware.energy_wh > 2 * STEP_WH, lambda: dao.running.log("charger"))
    hardware.gauge = 0.5
    hardware.wait_for_command(False)
    hurry_to_the_window(dao, hardware, task_id)
    proof = dao.proof_of(task_id)
    assert session_end(proof)["reason"] == "deadline"
    assert hardware.energy_wh > 2 * STEP_WH
    assert hardware.energy_wh - delivered_wh(proof) < 2 * STEP_WH


def test_a_malformed_message_of_the_battery_is_left_out(
    dao: Organization, hardware: Hardware, buyer: Buyer
) -> None:
    task_id = docked(dao, hardware, buyer)
    wait_until(lambda: hardware.energy_wh > STEP_WH, lambda: dao.running.log("charger"))
    hardware.malformed = True
    until_s = hardware.now_s() + 3
    wait_until(lambda: hardware.now_s() >= until_s)
    hardware.malformed = False
    hardware.fast = True
    proof = dao.proof_of(task_id)
    assert session_end(proof)["reason"] == "target_reached"
    assert session_end(proof)["left_out"].get("message:not_a_number", 0) > 0
    assert delivered_wh(proof) == pytest.approx(hardware.energy_wh, rel=0.005)


def test_a_robot_that_never_comes_is_said_so_and_nothing_is_switched_on(
    dao: Organization, hardware: Hardware
) -> None:
    task_id = dao.buy()
    hardware.fast = True
    dao.given_back(task_id, "no_robot")
    assert True not in hardware.commands


def test_a_robot_that_leaves_early_gets_a_proof_of_what_was_delivered(
    dao: Organization, hardware: Hardware, buyer: Buyer
) -> None:
    task_id = docked(dao, hardware, buyer)
    wait_until(lambda: hardware.soc >= 0.51, lambda: dao.running.log("charger"))
    hardware.docked = False
    hardware.wait_for_command(False)
    hardware.fast = True
    proof = dao.proof_of(task_id)
    assert session_end(proof)["reason"] == "robot_left"
    assert session_end(proof)["closed_by_robot"]
    assert delivered_wh(proof) == pytest.approx(hardware.energy_wh, rel=0.02)
    assert hardware.commands[-1] is False


def test_a_robot_with_another_charge_than_its_task_says_is_not_served(
    dao: Organization, hardware: Hardware, buyer: Buyer
) -> None:
    task_id = dao.buy(soc_from=0.2)
    buyer.begin(dao.robot.task(task_id))
    hardware.docked = True
    dao.given_back(task_id, "other_charge")
    assert True not in hardware.commands


def test_a_task_for_another_dock_is_given_back_at_once(dao: Organization, hardware: Hardware) -> None:
    task_id = dao.buy(dock="dock9")
    dao.given_back(task_id, "bad_task")
    assert True not in hardware.commands
