"""The robots' batteries, and the dock's supply behind meter and contactor."""

from __future__ import annotations

import math
from typing import Any

from rodeo_testing.modbus import Panel

WORKS_W = 60.0
"""Drawn besides while base or arm moves."""


class Battery:
    """What a robot draws, from one look to the next.

    Args:
        told: the battery as its data sheet says.
    """

    def __init__(self, told: dict[str, Any]) -> None:
        self._told = told
        self.soc: float = told["soc"]
        self.voltage_v, self.current_a = self._open_v, 0.0

    @property
    def _open_v(self) -> float:
        """Ten cells in series."""
        return 32 + 10 * self.soc

    def _load_a(self, works: bool) -> float:
        return (self._told["idle_w"] + (WORKS_W if works else 0.0)) / self._open_v

    def flow(self, seconds: float, _pose: tuple[float, float, float], works: bool) -> None:
        """Take what the robot draws."""
        self._charge(seconds, -self._load_a(works))

    def _charge(self, seconds: float, current_a: float) -> None:
        self.current_a = current_a
        self.voltage_v = self._open_v + current_a * self._told["resistance_ohm"]
        self.soc = min(1.0, self.soc + current_a * seconds / 3600 / self._told["capacity_ah"])


class Power(Battery):
    """The battery of the robot that the dock is for.

    Args:
        dock: as its data sheet says, and where its contacts are.
    """

    def __init__(self, told: dict[str, Any], dock: dict[str, Any], panel: Panel) -> None:
        super().__init__(told)
        self._dock, self._panel = dock, panel
        panel.present = False

    def _docked(self, x_m: float, y_m: float, yaw_rad: float) -> bool:
        """Whether a robot at this pose touches the contacts."""
        dock = self._dock
        off_m = math.dist((x_m, y_m), (dock["x_m"], dock["y_m"]))
        turned = abs(math.remainder(yaw_rad - dock["yaw_rad"], math.tau))
        return off_m < dock["near_m"] and turned < dock["near_rad"]

    def flow(self, seconds: float, pose: tuple[float, float, float], works: bool) -> None:
        """Take what the robot draws, and what the dock gives at this pose."""
        panel, docked, load_a = self._panel, self._docked(*pose), self._load_a(works)
        headroom_a = (self._dock["voltage_v"] - self._open_v) / self._told["resistance_ohm"]
        supply_a = min(self._dock["current_a"], headroom_a + load_a) if docked else 0.0
        flows = docked and (panel.coil or panel.welded)
        self._charge(seconds, (supply_a if flows else 0.0) - load_a)
        panel.present, panel.flows_w = docked, self.voltage_v * supply_a if flows else 0.0
        panel.flow(seconds)
