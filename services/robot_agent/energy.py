"""How much energy work takes: measured on this robot while it works, guessed from its data sheet before."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field

from rodeo.host.files import read_model, replace_file
from rodeo.lab.config import BatteryConfig
from rodeo.robot.errors import JournalBroken

_FIRST_DRIVING_W = 120.0
"""Mean power on top of standing still while driving and handling, until it is measured."""
_FIRST_SPEED_M_S = 0.3
_FIRST_HANDLING_S = 120.0
_WEIGHT = 0.2
"""Weight of a new measurement against all before it."""
_LONGEST_GAP_S = 10.0
"""Battery messages further apart do not count what was in between."""
_SPEED_MEMORY_S = 300.0
"""Driving time over which the mean speed is taken, about."""
_SHORTEST_S = 5.0
"""Less time says little about the mean power."""

DETOUR = 1.5
"""A way around furniture against the straight line."""
MARGIN = 1.5
"""On what a task is expected to take: a grasp may slip, a way may be blocked."""
RESERVE = 0.1
"""State of charge that is never planned away."""


class Consumption(BaseModel):
    """Means over what the robot did so far."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    working_w: float = Field(gt=0)
    """Electrical power while it works."""
    speed_m_s: float = Field(default=_FIRST_SPEED_M_S, gt=0)
    """While it drives."""
    handling_s: float = Field(default=_FIRST_HANDLING_S, ge=0)
    """What a task takes besides driving (turning, looking, grasping), where the robot has done none of its
    kind."""
    handling_of_s: dict[str, Annotated[float, Field(ge=0)]] = {}
    """Kind of work -> the measured `handling_s` of its tasks."""
    energy_of_wh: dict[str, Annotated[float, Field(ge=0)]] = {}
    """Kind of work -> energy of a task from its beginning to its end, as measured."""
    way_of_m: dict[str, Annotated[float, Field(ge=0)]] = {}
    """Kind of work -> way driven in a task, as measured."""
    driven_m: float = Field(default=0.0, ge=0)
    """Odometer."""

    @classmethod
    def load(cls, path: Path, battery: BatteryConfig) -> Self:
        """Raises JournalBroken."""
        words = (
            "the robot's learned power consumption is damaged: restore the file, or move it away; "
            "then the robot learns it again"
        )
        return read_model(cls, path, JournalBroken, words) or cls(
            working_w=battery.idle_power_w + battery.arm_power_w + _FIRST_DRIVING_W
        )

    def save(self, path: Path) -> None:
        replace_file(path, self.model_dump_json())

    def drive_s(self, way_m: float) -> float:
        """Time (s) for a way of `way_m` in straight lines."""
        return way_m / self.speed_m_s

    def task_s(self, kind: str, way_m: float) -> float:
        """Time for a task that leads over `way_m`."""
        return self.drive_s(way_m) + self.handling_of_s.get(kind, self.handling_s)

    def task_wh(self, kind: str, way_m: float) -> float:
        return self.working_w * self.task_s(kind, way_m) / 3600

    def drive_wh(self, way_m: float) -> float:
        return self.working_w * self.drive_s(way_m) / 3600

    def learn_drive(self, way_m: float, duration_s: float) -> None:
        """A stretch of a drive; the longer it took, the more it counts."""
        weight = min(1.0, duration_s / _SPEED_MEMORY_S)
        self.speed_m_s = (1 - weight) * self.speed_m_s + weight * way_m / duration_s

    def learn_task(
        self, kind: str, duration_s: float, driving_s: float, energy_wh: float, way_m: float
    ) -> None:
        before_s = self.handling_of_s.get(kind, self.handling_s)
        self.handling_of_s[kind] = _mean(before_s, max(0.0, duration_s - driving_s))
        self.energy_of_wh[kind] = _mean(self.energy_of_wh.get(kind, energy_wh), energy_wh)
        self.way_of_m[kind] = _mean(self.way_of_m.get(kind, way_m), way_m)

    def learn_power(self, energy_wh: float, duration_s: float) -> None:
        if duration_s >= _SHORTEST_S and energy_wh > 0:
            self.working_w = _mean(self.working_w, energy_wh * 3600 / duration_s)


def _mean(old: float, new: float) -> float:
    return (1 - _WEIGHT) * old + _WEIGHT * new


class EnergyMeter:
    """Integrates what the battery gives, from its own readings. One thread."""

    def __init__(self) -> None:
        self.energy_wh = 0.0
        self.duration_s = 0.0
        self._last: tuple[float, float] | None = None

    def reading(self, time_s: float, voltage_v: float, current_a: float) -> None:
        """`current_a` is negative while it discharges, as sensor_msgs/BatteryState says."""
        power_w = max(0.0, -voltage_v * current_a)
        if self._last is not None:
            last_s, last_w = self._last
            step_s = time_s - last_s
            if 0 < step_s <= _LONGEST_GAP_S:
                self.energy_wh += (power_w + last_w) / 2 * step_s / 3600
                self.duration_s += step_s
        self._last = time_s, power_w


def battery_suffices(soc: float, battery: BatteryConfig, task_wh: float, home_wh: float) -> bool:
    """Whether the battery gives `task_wh` with a margin and then the way to the dock, above the reserve."""
    return (soc - RESERVE) * battery.capacity_wh >= task_wh * MARGIN + home_wh
