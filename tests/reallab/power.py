"""The robot's battery, and the dock's supply behind meter and contactor."""

from __future__ import annotations

import math
from typing import Any

from rodeo_testing.modbus import Panel

WORKS_W = 60.0
"""Drawn besides while base or arm moves."""


class Power:
    """What flows, from one look to the next.

    Args:
        told: battery and dock as their data sheets say, and where the dock's contacts are.
    """

    def __init__(self, told: dict[str, Any], panel: Panel) -> None:
        self._battery, self._dock, self._panel = told["battery"], told["dock"], panel
        self.soc: float = self._battery["soc"]
        self.voltage_v, self.current_a = self._open_v, 0.0
        panel.present = False

    @property
    def _open_v(self) -> float:
        """Ten cells in series."""
        return 32 + 10 * self.soc

    def docked(self, x_m: float, y_m: float, yaw_rad: float) -> bool:
        """Whether a robot at this pose touches the contacts."""
        dock = self._dock
        off_m = math.dist((x_m, y_m), (dock["x_m"], dock["y_m"]))
        turned = abs(math.remainder(yaw_rad - dock["yaw_rad"], math.tau))
        return off_m < dock["near_m"] and turned < dock["near_rad"]

    def flow(self, seconds: float, docked: bool, works: bool) -> None:
        battery, panel = self._battery, self._panel
        load_a = (battery["idle_w"] + (WORKS_W if works else 0.0)) / self._open_v
        resistance_ohm = battery["resistance_ohm"]
        headroom_a = (self._dock["voltage_v"] - self._open_v) / resistance_ohm
        supply_a = min(self._dock["current_a"], headroom_a + load_a) if docked else 0.0
        flows = docked and (panel.coil or panel.welded)
        self.current_a = (supply_a if flows else 0.0) - load_a
        self.voltage_v = self._open_v + self.current_a * resistance_ohm
        panel.present, panel.flows_w = docked, self.voltage_v * supply_a if flows else 0.0
        panel.flow(seconds)
        self.soc = min(1.0, self.soc + self.current_a * seconds / 3600 / battery["capacity_ah"])
