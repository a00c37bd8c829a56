"""Decision: the robot's policy, row by row."""

from __future__ import annotations

import pytest

from rodeo.config import AgentConfig
from rodeo.lab.config import BatteryConfig
from rodeo.messages import Task
from services.robot_agent.decision import Intent, Situation, decide, enough_energy

BATTERY = BatteryConfig()
AGENT = AgentConfig(charge_below=0.5, charge_target=0.95, explore_when_idle=True)


def task(state: str) -> Task:
    unknown = dict.fromkeys(Task.model_fields)
    known = {
        "id": 1,
        "kind": "waste_disposal",
        "state": state,
        "attempt": 1,
        "max_attempts": 3,
        "creator": "0x0",
        "reward_iec": "100",
        "paid_iec": "0",
        "params": {},
        "description": "",
        "registered": 0.0,
    }
    return Task.model_validate(unknown | known)


JOB = task("assigned")


@pytest.mark.parametrize(
    ("soc", "assignment", "charge", "intent"),
    [
        (0.9, None, None, Intent.EXPLORE),
        (0.9, JOB, None, Intent.CLEAN),
        (0.4, JOB, None, Intent.CLEAN),  # enough energy: finish what was taken on first
        (0.4, None, None, Intent.BUY_CHARGE),
        (0.12, JOB, None, Intent.BUY_CHARGE),  # it would not get back to the dock
        (0.4, None, "open", Intent.AWAIT_CHARGE),
        (0.4, None, "assigned", Intent.DOCK),
        (0.4, JOB, "assigned", Intent.DOCK),
        (0.96, JOB, "assigned", Intent.CLEAN),  # full, and somebody waits
        (0.96, None, "assigned", Intent.DOCK),  # full, but the session is not over
        (0.96, None, "submitted", Intent.EXPLORE),
        (0.4, None, "submitted", Intent.REST),  # paid for less than hoped; do not buy two at once
    ],
)
def test_what_the_robot_does_next(
    soc: float, assignment: Task | None, charge: str | None, intent: Intent
) -> None:
    situation = Situation(soc, assignment, task(charge) if charge else None)
    assert decide(situation, AGENT, BATTERY) == intent


def test_exploring_can_be_turned_off() -> None:
    stay = AGENT.model_copy(update={"explore_when_idle": False})
    assert decide(Situation(0.9, None, None), stay, BATTERY) == Intent.REST


def test_energy_for_a_task_includes_a_reserve() -> None:
    assert enough_energy(0.5, BATTERY)
    assert not enough_energy(0.1, BATTERY)
