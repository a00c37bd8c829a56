"""A Li-ion battery as a voltage source with a resistance, and a dock's CC/CV supply."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from rodeo.lab.config import BatteryConfig, DockConfig

EMPTY_V = 32.0
FULL_V = 42.0
"""Open-circuit voltage, linear in the state of charge (battery plug-in of Husarion's description)."""


class SupplyStatus(IntEnum):
    """sensor_msgs/BatteryState POWER_SUPPLY_STATUS_*."""

    CHARGING = 1
    DISCHARGING = 2
    NOT_CHARGING = 3
    FULL = 4


@dataclass
class Battery:
    """State of one pack; positive current charges it."""

    config: BatteryConfig
    soc: float
    current_a: float = 0.0

    @property
    def open_circuit_v(self) -> float:
        return EMPTY_V + (FULL_V - EMPTY_V) * self.soc

    @property
    def voltage_v(self) -> float:
        return self.open_circuit_v + self.current_a * self.config.resistance_ohm

    def copy(self) -> Battery:
        return Battery(self.config, self.soc, self.current_a)

    def step(self, load_w: float, supply_a: float, dt_s: float) -> None:
        """Give `load_w` to the robot and take `supply_a` from the dock for `dt_s`."""
        self.current_a = supply_a - self.load_current_a(load_w)
        self.soc = min(1.0, max(0.0, self.soc + self.current_a * dt_s / 3600 / self.config.capacity_ah))

    def load_current_a(self, load_w: float) -> float:
        """Current that the load draws: P = (V - I R) I, the smaller root; at most what the pack can give."""
        v, r = self.open_circuit_v, self.config.resistance_ohm
        return (v - math.sqrt(max(0.0, v * v - 4 * r * load_w))) / (2 * r)


@dataclass
class Supply:
    """The dock's power supply behind its contactor."""

    config: DockConfig
    enabled: bool = False
    """The contactor is closed."""
    finished: bool = False
    """The current has fallen to the cut-off since the contactor was closed."""
    connected: bool = False
    """A battery is on the contacts: their sense line tells with an open contactor, too."""
    voltage_v: float = 0.0
    current_a: float = 0.0

    def copy(self) -> Supply:
        return Supply(
            self.config, self.enabled, self.finished, self.connected, self.voltage_v, self.current_a
        )

    def enable(self, closed: bool) -> None:
        if closed != self.enabled:
            self.enabled, self.finished = closed, False

    def deliver(self, battery: Battery | None, load_w: float) -> float:
        """Current into the robot whose battery is on the contacts; 0 if none is, or nothing is due."""
        self.connected = battery is not None
        if not self.enabled or battery is None:
            self.current_a = 0.0
            self.voltage_v = self.config.voltage_v if self.enabled else 0.0
            self.finished = False
            return 0.0
        load_a = battery.load_current_a(load_w)
        headroom_a = (self.config.voltage_v - battery.open_circuit_v) / battery.config.resistance_ohm
        current_a = max(0.0, min(self.config.current_a, headroom_a + load_a))
        if current_a <= self.config.cutoff_a:
            self.finished = True
        self.current_a = 0.0 if self.finished else current_a
        net_a = self.current_a - load_a
        self.voltage_v = battery.open_circuit_v + net_a * battery.config.resistance_ohm
        return self.current_a

    @property
    def status(self) -> SupplyStatus:
        if self.finished:
            return SupplyStatus.FULL
        return SupplyStatus.CHARGING if self.current_a > 0 else SupplyStatus.NOT_CHARGING
