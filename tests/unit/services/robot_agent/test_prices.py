"""A robot's price follows what it measured and what it earned, and changes seldom."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rodeo.bus.messages import Task
from rodeo.kinds import kinds_of
from rodeo.money.pricing import Experience, PricingConfig
from rodeo.site.config import Site
from services.robot_agent.prices import Period, Prices, experience
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.robot.fakes import ManualClock

SITE = Site.load(LAB)
CLEANING = kinds_of(SITE)["waste_disposal"]
COST_PLUS = {"method": "cost_plus", "margin": 0.0, "min_update_s": 600.0, "min_change": 0.1}
LEARNED = {"method": "learned", "prices_iec": [60, 90], "min_update_s": 600.0, "explore": 0.0}


class Organization:
    """One that the robot bought 400 Wh for 200 IEC of, and that pays what is in `done`."""

    name = "panther1"

    def __init__(self) -> None:
        self.genesis = "0x1"
        self.done: list[Task] = []

    def ask(self, _query: object) -> Any:
        return SimpleNamespace(genesis_hash=self.genesis)

    def tasks(self, kind: str, **_filters: Any) -> list[Task]:
        if kind == "waste_disposal":
            return self.done
        charge = {"reward_iec": Decimal(200), "paid_iec": Decimal(200), "params": {"energy_wh": 400.0}}
        return [task("settled").model_copy(update=charge)]


class Upkeep:
    used: tuple[float, float] | None = None

    def measured(self, _kind: str) -> tuple[float, float] | None:
        return self.used


class Robot:
    def __init__(self, folder: Path, pricing: dict[str, Any]) -> None:
        self.clock, self.dao, self.upkeep = ManualClock(), Organization(), Upkeep()
        self._folder = folder
        self._config = SITE.robots[0].model_copy(
            update={"pricing": PricingConfig.model_validate({"default": pricing})}
        )
        self.starts()

    def starts(self) -> None:
        dao: Any = self.dao
        upkeep: Any = self.upkeep
        self.prices = Prices(SITE, self._config, dao, upkeep, self.clock, self._folder)

    def asks(self) -> Decimal:
        return self.prices.asked(CLEANING)

    def later(self, seconds: float) -> None:
        self.clock.wait_until(self.clock.now_s() + seconds)


def test_a_measured_cost_changes_the_price_when_it_is_time_and_a_small_one_does_not(tmp_path: Path) -> None:
    robot = Robot(tmp_path, COST_PLUS)
    assert robot.asks() == 100
    robot.upkeep.used = 20.0, 0.0
    robot.later(599)
    assert robot.asks() == 100
    robot.later(1)
    assert robot.asks() == 10  # 20 Wh at half an IEC
    robot.upkeep.used = 21.0, 0.0
    robot.later(601)
    assert robot.asks() == 10
    robot.upkeep.used = 24.0, 0.0
    assert robot.asks() == 12


def test_the_last_change_is_remembered_across_a_restart_and_not_on_another_chain(tmp_path: Path) -> None:
    robot = Robot(tmp_path, COST_PLUS)
    robot.asks()
    robot.upkeep.used = 20.0, 0.0
    robot.starts()
    assert robot.asks() == 100
    robot.dao.genesis = "0x2"
    assert robot.asks() == 10


def test_a_learned_price_is_the_one_that_brought_most_in_an_hour(tmp_path: Path) -> None:
    robot = Robot(tmp_path, LEARNED)
    assert robot.asks() == 90
    robot.later(3600)
    assert robot.asks() == 60
    earned = {"price_iec": Decimal(60), "paid_iec": Decimal(60), "settled": robot.clock.now_s() + 10}
    robot.dao.done = [task("settled").model_copy(update=earned)]
    robot.later(3600)
    assert robot.asks() == 60
    earned = {"price_iec": Decimal(90), "paid_iec": Decimal(90), "settled": 30.0}
    robot.dao.done.append(task("settled").model_copy(update=earned))
    robot.later(3600)
    assert robot.asks() == 90


def test_time_in_which_the_service_is_paused_is_no_experience(tmp_path: Path) -> None:
    robot = Robot(tmp_path, LEARNED)
    robot.asks()
    robot.later(100)
    robot.prices.withdrawn("waste_disposal")
    robot.later(10_000)
    robot.starts()
    assert robot.asks() == 60
    periods = robot.prices._kept.kinds["waste_disposal"].periods
    assert [(one.price_iec, one.end_s - one.begin_s) for one in periods] == [(90, 100), (60, 0)]


def test_experience_before_the_memory_begins_does_not_count() -> None:
    periods = [
        Period(price_iec=Decimal(90), begin_s=0, end_s=100),
        Period(price_iec=Decimal(90), begin_s=200, end_s=300),
    ]
    done = [
        task("settled").model_copy(
            update={"price_iec": Decimal(90), "paid_iec": Decimal(90), "settled": at_s}
        )
        for at_s in (40.0, 250.0)
    ]
    assert experience(periods, done, since_s=50) == {Decimal(90): Experience(150, Decimal(90))}
