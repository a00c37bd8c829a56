"""Dock, contactor, battery and buyer of a charge, played for a real charger, and the site's clock, too."""

from __future__ import annotations

import math
import threading
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple, Protocol, cast

from rodeo.bus.messages import Task
from rodeo.bus.session import Bus
from rodeo.host.clock import Clock
from rodeo.lab.config import BatteryConfig, DockConfig
from rodeo.robot.receipts import Receipts
from rodeo.ros2.node import Node
from rodeo.ros2.types import new, time_message
from rodeo.signing import wallets
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.witness import Witness
from rodeo_testing.waiting import wait_until

TICK_S = 0.001
"""Wall time between two readings, which are 1 s of site time apart."""
SLOW_TICK_S = 0.05
"""The same while the processes have to keep up, which on a busy machine takes them wall time."""
TARGET_SOC = 0.9


class SiteOnABus(Protocol):
    @property
    def site(self) -> Site: ...

    @property
    def bus(self) -> Bus: ...


class Circuit(NamedTuple):
    """A supply, the robot's battery and what the robot uses itself."""

    supply: DockConfig
    battery: BatteryConfig

    def flow(self, soc: float, closed: bool) -> tuple[float, float, float]:
        """Voltage (V), current through the contacts and current into the battery (A)."""
        open_circuit_v = 32 + 10 * soc
        load_a = self.battery.idle_power_w / open_circuit_v
        current_a = 0.0
        if closed:
            headroom_a = (self.supply.voltage_v - open_circuit_v) / self.battery.resistance_ohm
            current_a = min(self.supply.current_a, headroom_a + load_a)
        net_a = current_a - load_a
        return open_circuit_v + net_a * self.battery.resistance_ohm, current_a, net_a


class Topics:
    """What the dock, the robot's gauge and the clock publish."""

    def __init__(self, site: Site, node: Node) -> None:
        dock, robot = site.docks[0].name, site.robots[0].name
        self.node = node
        self._clock = node.publisher(topics.CLOCK.name(), topics.CLOCK.type)
        self._output = node.publisher(topics.DOCK_OUTPUT.name(dock=dock), topics.DOCK_OUTPUT.type)
        self._gauge = node.publisher(topics.BATTERY_STATE.name(ns=robot), topics.BATTERY_STATE.type)

    def publish(self, time_ns: int, gauge: dict[str, float], output: dict[str, float | bool]) -> None:
        stamp = time_message(time_ns)
        header = new("std_msgs/msg/Header", stamp=stamp)
        self._clock.publish(new("rosgraph_msgs/msg/Clock", clock=stamp))
        self._gauge.publish(new(topics.BATTERY_STATE.type, header=header, **gauge))
        self._output.publish(new(topics.DOCK_OUTPUT.type, header=header, **output))


class Hardware:
    """Dock, contactor and battery, and the site's clock, hundreds of times faster than real time."""

    def __init__(self, running: SiteOnABus) -> None:
        site = running
        self.docked = False
        self.closed = False
        self.soc = 0.5
        self.energy_wh = 0.0
        self.commands: list[bool] = []
        self.gauge = 1.0
        """Factor of the robot's gauge on the current."""
        self.malformed = False
        """Whether its readings are not numbers."""
        self._time_ns = 1_800_000_000_000_000_000
        dock = site.site.docks[0]
        self._circuit = Circuit(dock, site.site.robots[0].battery)
        node = Node(site.bus.session, "hardware", "", site.site.bus.domain_id, self)
        self._topics = Topics(site.site, node)
        node.service(topics.DOCK_ENABLE.name(dock=dock.name), topics.DOCK_ENABLE.type, self._enable)
        self.fast = True
        """While current flows, and before."""
        self.target_soc = TARGET_SOC
        """State of charge after which readings are slow."""
        self.hurry_until_s = 0.0
        """Whatever happens until then."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def now_ns(self) -> int:
        return self._time_ns

    def now_s(self) -> float:
        return self._time_ns * 1e-9

    def hold(self, within: bool = False) -> AbstractContextManager[None]:
        return nullcontext()  # it waits for nobody

    @property
    def _hurries(self) -> bool:
        if self.now_s() < self.hurry_until_s:
            return True
        # What comes after a session, sealing and submitting, must not take half its window.
        return self.fast and (self.closed or not self.commands) and self.soc < self.target_soc

    def _enable(self, request: Any) -> Any:
        self.closed = bool(request.data)
        self.commands.append(self.closed)
        return new("std_srvs/srv/SetBool_Response", success=True)

    def _run(self) -> None:
        # At the target a second of lag must not overcharge the battery.
        while not self._stop.wait(TICK_S if self._hurries else SLOW_TICK_S):
            self._time_ns += 1_000_000_000
            voltage_v, current_a, net_a = self._circuit.flow(self.soc, self.closed and self.docked)
            if self.closed and self.docked:
                self.soc += net_a / 3600 / self._circuit.battery.capacity_ah
            self.energy_wh += voltage_v * current_a / 3600
            gauge_v = math.nan if self.malformed else voltage_v
            self._topics.publish(
                self._time_ns,
                {"voltage": gauge_v, "current": net_a * self.gauge, "percentage": self.soc},
                {"voltage": voltage_v, "current": current_a, "present": self.docked},
            )

    def wait_for_command(self, closed: bool) -> None:
        wait_until(
            lambda: self.commands and self.commands[-1] is closed,
            lambda: f"the contactor was not told to be {closed}: {self.commands}",
        )

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._topics.node.close()


class Buyer:
    """The robot's computer, while it is on: it signs for what the meter of its task shows."""

    def __init__(self, running: SiteOnABus, clock: Hardware) -> None:
        site, bus, robot = running.site, running.bus, running.site.robots[0]
        self._node = Node(bus.session, "robot", "", site.bus.domain_id, clock)
        account = wallets.load(site, f"{robot.name}-device")
        folder = site.data_dir / "robot"
        self._witness = Witness(bus, site.org, robot.name, account, folder, "closed_bus", clock.now_ns)
        self._receipts = Receipts(site, robot, self._witness, bus, self._node, cast(Clock, clock))
        self._task: Task | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def begin(self, task: Task) -> None:
        self._task = task

    def _run(self) -> None:
        while not self._stop.wait(0.2):
            if self._task is not None:
                self._receipts.begin(self._task)
                self._receipts.remind()

    def close(self) -> None:
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        self._receipts.close()
        self._witness.close()
        self._node.close()
