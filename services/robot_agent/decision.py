"""What the robot does next, from what is so. A pure function: the whole policy can be read here."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from rodeo.config import AgentConfig
from rodeo.lab.config import BatteryConfig
from rodeo.messages import Task

_CLEANING_S = 400.0
"""Site time that a cleaning task may take, retries included."""
_DRIVING_W = 120.0
"""Mean power on top of standing still while driving and handling."""
_WAY_TO_DOCK_WH = 3.0
_RESERVE = 0.1
"""State of charge that is never planned away."""


class Intent(StrEnum):
    CLEAN = "clean"
    DOCK = "dock"
    BUY_CHARGE = "buy charge"
    AWAIT_CHARGE = "await charge"
    """A charge is bought and nobody has taken the task yet."""
    EXPLORE = "explore"
    REST = "rest"


@dataclass(frozen=True)
class Situation:
    soc: float
    assignment: Task | None
    """The cleaning task to do next."""
    charge: Task | None
    """The robot's own charging task, if one is live."""


def enough_energy(soc: float, battery: BatteryConfig) -> bool:
    """Whether the battery lasts for one cleaning task and the way to the dock."""
    task_wh = (battery.idle_power_w + battery.arm_power_w + _DRIVING_W) * _CLEANING_S / 3600
    return (soc - _RESERVE) * battery.capacity_wh >= task_wh + _WAY_TO_DOCK_WH


def decide(now: Situation, agent: AgentConfig, battery: BatteryConfig) -> Intent:
    can_clean = now.assignment is not None and enough_energy(now.soc, battery)
    charge_state = now.charge.state if now.charge is not None else None
    full = now.soc >= agent.charge_target
    if charge_state == "assigned" and not (full and can_clean):
        return Intent.DOCK
    if can_clean:
        return Intent.CLEAN
    low = now.soc < agent.charge_below or now.assignment is not None
    if low and charge_state is None:
        return Intent.BUY_CHARGE
    if low and charge_state == "open":
        return Intent.AWAIT_CHARGE
    return Intent.EXPLORE if agent.explore_when_idle and not low else Intent.REST
