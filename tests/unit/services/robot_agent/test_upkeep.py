"""A robot offers more for care that nobody takes."""

from __future__ import annotations

from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.messages import Task
from rodeo.commands.tasks import RegisterTask
from rodeo.errors import RemoteError
from rodeo.money.rewards import Rise
from rodeo.site.config import Site
from rodeo.site.sections import MaintenanceConfig
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.upkeep import Care
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.robot.fakes import ManualClock

CARE = MaintenanceConfig(
    kind="wheel_cleaning",
    every_km=1,
    reward_iec=Decimal(50),
    description="Clean my wheels",
    rise=Rise(up_to_iec=Decimal(60), by=0.1, every_s=3600),
)


class Organization(RobotParticipant):
    """Its tasks, and no bridge."""

    def __init__(self, clock: ManualClock) -> None:
        self.name, self.clock = "panther1", clock
        self.known: list[Task] = []
        self.refuses: RemoteError | None = None

    def tasks(self, **_filters: Any) -> list[Task]:
        return self.known[::-1]

    def post(self, request: RegisterTask, now_s: float, cap_iec: Decimal) -> int:
        return self.add(request.reward_iec)

    def add(self, reward_iec: Decimal) -> int:
        known = {"id": len(self.known) + 1, "registered": self.clock.now_s(), "reward_iec": reward_iec}
        known |= {"kind": CARE.kind, "params": {"number": 1}}
        self.known.append(task("open").model_copy(update=known))
        return len(self.known)

    def becomes(self, state: str) -> None:
        self.known[-1] = self.known[-1].model_copy(
            update={
                "state": state,
                "refunded_iec": self.known[-1].reward_iec if state == "cancelled" else Decimal(0),
            }
        )

    def raise_reward(self, task_id: int, reward_iec: Decimal) -> int:
        assert task_id == self.known[-1].id
        self.becomes("cancelled")
        if self.refuses is not None:
            raise self.refuses
        return self.add(reward_iec)


class Robot:
    def __init__(self, cap_iec: Decimal) -> None:
        site = Site.load(LAB)
        agent = site.agent.model_copy(update={"maintenance": [CARE], "daily_spending_cap_iec": cap_iec})
        site = site.model_copy(update={"agent": agent})
        self.clock = ManualClock()
        self.dao = Organization(self.clock)
        driven: Any = SimpleNamespace(state=lambda: {"driven_km": 1.5})
        self.care = Care(site, "panther1", self.dao, self.clock, driven, refused_wall_s=0.0)

    def asks(self, after_s: float = 0.0) -> list[tuple[str, int]]:
        """The tasks after it asked for care, with their rewards."""
        self.clock.wait_until(self.clock.now_s() + after_s)
        self.care.ask()
        return [(one.state, int(one.reward_iec)) for one in self.dao.known]


def test_what_nobody_takes_pays_more_and_more_up_to_the_highest() -> None:
    robot = Robot(Decimal(1000))
    assert robot.asks() == [("open", 50)]
    assert robot.asks(3599) == [("open", 50)]
    assert robot.asks(1) == [("cancelled", 50), ("open", 55)]
    assert robot.asks(3600)[1:] == [("cancelled", 55), ("open", 60)]
    assert len(robot.asks(36_000)) == 3


def test_what_somebody_has_taken_stays_as_it_is() -> None:
    robot = Robot(Decimal(1000))
    robot.asks()
    robot.dao.becomes("assigned")
    assert robot.asks(7200) == [("assigned", 50)]


def test_the_daily_cap_is_the_budget() -> None:
    robot = Robot(Decimal(56))
    robot.asks()
    assert robot.asks(3600)[1:] == [("open", 55)]
    assert robot.asks(3600)[1:] == [("open", 55)]


def test_a_task_that_was_cancelled_and_not_posted_again_is_posted_later() -> None:
    robot = Robot(Decimal(1000))
    robot.asks()
    robot.dao.refuses = RemoteError("chain_unavailable", "the chain is away")
    assert robot.asks(3600) == [("cancelled", 50)]
    robot.dao.refuses = None
    assert robot.asks() == [("cancelled", 50), ("open", 55)]


@pytest.mark.parametrize("state", ["settled", "failed"])
def test_what_cannot_be_raised_is_given_up(state: str) -> None:
    robot = Robot(Decimal(1000))
    robot.asks()
    robot.dao.refuses = RemoteError("cannot_raise", "nobody raises this")
    robot.asks(3600)
    robot.dao.becomes(state)
    robot.dao.refuses = None
    assert robot.asks(3600) == [(state, 50)]
