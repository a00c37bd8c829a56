"""The charger on a real router, chain and bridge; the test plays the dock, the battery and the clock."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest

from rodeo import topics, wallets
from rodeo.dao import CHARGING, Participant
from rodeo.evidence import Proof, Store, open_proof
from rodeo.messages import PostVerdict, RegisterTask, Task
from rodeo.metering import MeterStatement, chain_breaks
from rodeo.ros2 import Node
from rodeo.ros2.types import new
from tests.support.site import WAIT_S, RunningSite, write_site

TICK_S = 0.001
"""Wall time between two readings, which are 1 s of site time apart."""
SLOW_TICK_S = 0.05
"""The same while the processes have to keep up, which on a busy machine takes them wall time."""
TARGET_SOC = 0.9


class Hardware:
    """Dock, contactor and battery, and the site's clock, hundreds of times faster than real time."""

    def __init__(self, site: RunningSite) -> None:
        self.docked = False
        self.closed = False
        self.soc = 0.5
        self.energy_wh = 0.0
        self.commands: list[bool] = []
        self._time_ns = 1_800_000_000_000_000_000
        dock, robot = site.site.dock.name, site.site.robots[0]
        self._supply, self._battery = site.site.dock, robot.battery
        node = Node(site.bus.session, "hardware", "", site.site.bus.domain_id, self)
        self._clock = node.publisher("clock", topics.CLOCK.type)
        self._output = node.publisher(topics.DOCK_OUTPUT.name(dock=dock), topics.DOCK_OUTPUT.type)
        self._state = node.publisher(topics.BATTERY_STATE.name(ns=robot.name), topics.BATTERY_STATE.type)
        node.service(topics.DOCK_ENABLE.name(dock=dock), topics.DOCK_ENABLE.type, self._enable)
        self._node = node
        self.fast = True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def now_ns(self) -> int:
        return self._time_ns

    def _enable(self, request: Any) -> Any:
        self.closed = bool(request.data)
        # What comes after a session, sealing and submitting, must not take half its window.
        self.fast = self.fast and self.closed
        self.commands.append(self.closed)
        return new("std_srvs/srv/SetBool_Response", success=True)

    def _run(self) -> None:
        # At the target a second of lag must not overcharge the battery.
        while not self._stop.wait(TICK_S if self.fast and self.soc < TARGET_SOC else SLOW_TICK_S):
            self._time_ns += 1_000_000_000
            open_circuit_v = 32 + 10 * self.soc
            current_a = 0.0
            if self.closed and self.docked:
                headroom_a = (self._supply.voltage_v - open_circuit_v) / self._battery.resistance_ohm
                current_a = min(self._supply.current_a, headroom_a)
            voltage_v = open_circuit_v + current_a * self._battery.resistance_ohm
            self.soc += current_a / 3600 / self._battery.capacity_ah
            self.energy_wh += voltage_v * current_a / 3600
            sec, nanosec = divmod(self._time_ns, 1_000_000_000)
            stamp = new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
            header = new("std_msgs/msg/Header", stamp=stamp)
            battery = "sensor_msgs/msg/BatteryState"
            self._clock.publish(new("rosgraph_msgs/msg/Clock", clock=stamp))
            self._state.publish(new(battery, header=header, voltage=voltage_v, percentage=self.soc))
            self._output.publish(
                new(battery, header=header, voltage=voltage_v, current=current_a, present=self.docked)
            )

    def wait_for_command(self, closed: bool) -> None:
        waited = threading.Event()
        for _ in range(int(WAIT_S * 100)):
            if self.commands and self.commands[-1] is closed:
                return
            waited.wait(0.01)
        raise AssertionError(f"the contactor was not told to be {closed}: {self.commands}")

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._node.close()


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
            **params,
        }
        request = RegisterTask.model_validate({
            "kind": CHARGING, "reward_iec": "200", "params": wanted | params, "execution_window_s": 14400
        })  # fmt: skip
        return int(self.robot.command("register_task", request)["task_id"])

    def wait_for(self, task_id: int, state: str) -> Task:
        waits = 0
        while (task := self.robot.task(task_id)).state != state:
            assert waits < WAIT_S, f"task {task_id} is {task.state}\n{self.running.log('charger')}"
            waits += not self._changed.wait(1.0)
            self._changed.clear()
        return task

    def proof_of(self, task_id: int) -> Proof:
        """The proof once it is submitted, fetched and checked against the assignment; the task is settled."""
        task = self.wait_for(task_id, "submitted")
        path = Store(self.running.site).fetch(str(task.proof_uri), str(task.proof_sha256))
        proof = open_proof(path)
        assert proof.binding == self.robot.binding(task, "dock1")
        assert proof.signer == wallets.address(self.running.site, "meter-device")
        verdict = PostVerdict(
            task_id=task.id,
            attempt=task.attempt,
            proof_sha256=str(task.proof_sha256),
            outcome="accepted",
            amount_iec=task.price_iec,
            reason="",
            report_sha256="0x" + "00" * 32,
            report_uri="",
        )
        self.oracle.command("post_verdict", verdict)
        self.wait_for(task_id, "settled")
        return proof


def statements(proof: Proof) -> list[MeterStatement]:
    return [MeterStatement.model_validate(a.payload) for a in proof.attestations()]


def session_end(proof: Proof) -> dict[str, Any]:
    return next(event for event in proof.events() if event.get("event") == "session_ended")


@pytest.fixture(scope="module")
def organization(
    tmp_path_factory: pytest.TempPathFactory, chain_backend: str
) -> Iterator[tuple[Organization, list[Hardware]]]:
    running = RunningSite(write_site(tmp_path_factory.mktemp("charger"), chain_backend))
    hardware: list[Hardware] = []
    try:
        running.start("router")
        hardware.append(Hardware(running))
        hardware[0].fast = False
        running.start("chain")
        running.deploy_contracts()
        running.start("bridge")
        yield Organization(running), hardware
    finally:
        for one in hardware:
            one.close()
        running.stop()


@pytest.fixture
def dao(organization: tuple[Organization, list[Hardware]]) -> Organization:
    return organization[0]


@pytest.fixture
def hardware(organization: tuple[Organization, list[Hardware]]) -> Iterator[Hardware]:
    one = organization[1][0]
    one.docked, one.closed, one.soc, one.energy_wh, one.fast = False, False, 0.5, 0.0, False
    one.commands.clear()
    yield one
    one.fast = False


@pytest.fixture(autouse=True)
def charger(dao: Organization, hardware: Hardware) -> Iterator[None]:
    if "charger" not in dao.running.children:
        dao.running.start("charger")
    yield


def test_a_charge_is_delivered_metered_sealed_and_submitted(dao: Organization, hardware: Hardware) -> None:
    task_id = dao.buy()
    hardware.docked = True
    hardware.wait_for_command(True)
    hardware.fast = True
    proof = dao.proof_of(task_id)
    assert hardware.commands == [True, False]
    assert TARGET_SOC <= hardware.soc < TARGET_SOC + 0.02
    said = statements(proof)
    assert chain_breaks(said) == []
    assert {(s.task_id, s.attempt, s.meter) for s in said} == {(task_id, 1, "dock1")}
    assert said[-1].energy_wh == pytest.approx(hardware.energy_wh, rel=0.002)
    times = [sample.time_s for statement in said for sample in statement.samples]
    assert all(after - before == pytest.approx(1.0) for before, after in pairwise(times))
    assert len(times) == proof.count("/dock1/output")
    gained = proof.table("/panther1/battery_state", topics.BATTERY_STATE.type)["percentage"]
    assert gained[0] == pytest.approx(0.5, abs=0.01)
    assert gained[-1] >= 0.9
    names = [event.get("name") or event["event"] for event in proof.events()]
    assert {"assignment", "TaskRegistered", "TaskAssigned", "session_ended"} <= set(names)
    assert session_end(proof)["reason"] == "target_reached"


def test_a_charger_killed_while_charging_goes_on_and_its_proof_is_whole(
    dao: Organization, hardware: Hardware
) -> None:
    task_id = dao.buy()
    hardware.docked = True
    hardware.wait_for_command(True)
    hardware.fast = True
    while hardware.soc < 0.6:
        dao._changed.wait(0.05)
    hardware.fast = False
    dao.running.kill("charger")
    dao.running.start("charger")
    hardware.fast = True
    proof = dao.proof_of(task_id)
    said = statements(proof)
    assert chain_breaks(said) == []
    times = [sample.time_s for statement in said for sample in statement.samples]
    assert len(times) == proof.count("/dock1/output")
    gap_s = max(after - before for before, after in pairwise(times))
    assert gap_s > 5.0
    unmetered_wh = gap_s * 42.0 * 10.0 / 3600
    assert hardware.energy_wh - unmetered_wh - 2.0 < said[-1].energy_wh < hardware.energy_wh
    assert "recording_resumed" in {event.get("event") for event in proof.events()}
    assert session_end(proof)["reason"] == "target_reached"
    assert hardware.commands[-1] is False


def test_a_robot_that_never_comes_is_said_so_and_nothing_is_switched_on(
    dao: Organization, hardware: Hardware
) -> None:
    task_id = dao.buy()
    hardware.fast = True
    proof = dao.proof_of(task_id)
    assert session_end(proof)["reason"] == "no_robot"
    assert statements(proof)[-1].energy_wh == 0.0
    assert True not in hardware.commands


def test_a_robot_that_leaves_early_gets_a_proof_of_what_was_delivered(
    dao: Organization, hardware: Hardware
) -> None:
    task_id = dao.buy()
    hardware.docked = True
    hardware.wait_for_command(True)
    while hardware.soc < 0.51:
        dao._changed.wait(0.05)
    hardware.docked = False
    hardware.wait_for_command(False)
    hardware.fast = True
    proof = dao.proof_of(task_id)
    assert session_end(proof)["reason"] == "robot_left"
    assert statements(proof)[-1].energy_wh == pytest.approx(hardware.energy_wh, rel=0.02)
    assert hardware.commands == [True, False, False]


def test_a_task_for_another_dock_is_refused_on_record(dao: Organization, hardware: Hardware) -> None:
    task_id = dao.buy(dock="dock9")
    proof = dao.proof_of(task_id)
    assert session_end(proof)["reason"] == "bad_task"
    assert True not in hardware.commands
