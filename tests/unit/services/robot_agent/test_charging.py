"""Around a charge: the dock is left when there is nothing to wait for."""

from __future__ import annotations

import threading
from collections.abc import Collection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.charging.orders import ChargingParams
from rodeo.commands.tasks import RegisterTask
from rodeo.dao import ORGANIZATION
from rodeo.host.clocked import ClockedEvent
from rodeo.lab.layout import dock_parking, on_contacts
from rodeo.robot.manipulator import MobileBase
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor
from rodeo.site.config import Site
from services.robot_agent.charging import Charging, left_s
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.robot.fakes import KinematicBody, ManualClock, RayCamera, manipulator

SITE = Site.load(LAB)


def charging(
    body: KinematicBody, folder: Path, dao: Any = None, site: Site = SITE, armed: bool = True
) -> Charging:
    receipts: Any = SimpleNamespace(begin=lambda _task: None, remind=lambda: None)
    ros: Any = body
    memory, clock = Memory(site, folder / "memory.json"), body.clock
    hands: Any = manipulator(site, body, RayCamera(body), memory)
    if not armed:
        hands = MobileBase(ros, Floor(site), memory, clock, np.random.default_rng(1), threading.Event())
    return Charging(site, "panther1", dao, ros, hands, clock, receipts, ["sweeping"])


def test_a_robot_on_the_contacts_leaves_them(tmp_path: Path) -> None:
    body, said = KinematicBody(SITE, ManualClock()), []
    body.base = dock_parking(SITE.docks[0])
    charging(body, tmp_path).clear_the_dock(lambda text, share: said.append(text))
    assert not on_contacts(SITE.docks[0], body.base)
    assert said == ["leaving the dock"]


def test_a_robot_elsewhere_stays_where_it_is(tmp_path: Path) -> None:
    body, said = KinematicBody(SITE, ManualClock()), []
    charging(body, tmp_path).clear_the_dock(lambda text, share: said.append(text))
    assert body.drives == said == []


def test_how_long_a_charge_takes_is_what_is_missing_at_the_pace_so_far() -> None:
    assert left_s((100.0, 0.50), (160.0, 0.56), 0.95) == pytest.approx(390)
    assert left_s((100.0, 0.50), (160.0, 0.96), 0.95) == 0
    assert left_s((100.0, 0.50), (100.0, 0.50), 0.95) is None


class ChargedBody(KinematicBody):
    """Its battery gains a tenth with each look at it on the dock's contacts."""

    soc = 0.5

    def battery(self) -> Any:
        docked = on_contacts(self.site.docks[0], self.base)
        self.soc = min(1.0, self.soc + 0.1) if docked else self.soc
        return SimpleNamespace(soc=self.soc, charging=docked)


class Organization:
    """Takes orders for charges at these services, (id, state)."""

    def __init__(self, *services: tuple[int, str]) -> None:
        self.posted: list[RegisterTask] = []
        self.standing: Task | None = None
        self.services = [SimpleNamespace(id=number, state=state) for number, state in services]

    def ask(self, query: object, provider: str, **_filters: Any) -> Any:
        assert (query, provider) == (queries.SERVICES, ORGANIZATION)
        return SimpleNamespace(services=self.services)

    def tasks(self, state: str, **_filters: Any) -> list[Any]:
        return [SimpleNamespace(params=request.params) for request in self.posted if state == "open"]

    def count(self, kind: str) -> int:
        return len(self.posted)

    def task(self, number: int) -> Task:
        assert self.standing is not None and self.standing.id == number
        return self.standing

    def given(self, kinds: Collection[str]) -> bool:
        """Whether work waits."""
        return True

    def post(self, request: RegisterTask, now_s: float, cap_iec: object) -> int:
        self.posted.append(request)
        return len(self.posted)


def test_a_robot_orders_the_energy_that_its_battery_takes_and_what_it_uses_meanwhile(tmp_path: Path) -> None:
    organization = Organization()
    charging(KinematicBody(SITE, ManualClock()), tmp_path, organization).buy(0.5)
    params = ChargingParams.model_validate(organization.posted[0].params)
    battery = SITE.robots[0].battery
    stored_wh = (params.soc_target - 0.5) * battery.capacity_wh
    assert params.soc_from == 0.5
    assert stored_wh < params.energy_wh < 1.5 * stored_wh


def test_a_robot_without_an_arm_buys_a_charge_docks_stays_until_it_is_full_and_leaves(
    tmp_path: Path,
) -> None:
    organization, body, dock = Organization(), ChargedBody(SITE, ManualClock()), SITE.docks[0]
    cart = charging(body, tmp_path, organization, armed=False)
    number = cart.buy(body.soc)
    params = organization.posted[0].params
    ordered = task("assigned").model_copy(
        update={"id": number, "kind": "battery_charging", "params": dict(params)}
    )
    organization.standing = ordered
    charges: list[str] = []
    cart.take(ordered, ClockedEvent(body.clock), lambda text, *_: charges.append(text))
    assert body.drives[0] == dock_parking(dock)
    assert charges[0] == f"driving to {dock.name}" and charges[-1] == "leaving the dock"
    assert body.soc >= params["soc_target"] and not on_contacts(dock, body.base)


def test_a_robot_orders_at_the_nearest_dock_where_nobody_is_to_be_charged(tmp_path: Path) -> None:
    site, organization = Site.load(LAB.with_name("plural.toml")), Organization()
    body = KinematicBody(site, ManualClock())
    body.base = dock_parking(site.dock("dock_east"))
    order = charging(body, tmp_path, organization, site)
    for _ in range(3):
        order.buy(0.5)
    docks = [request.params["dock"] for request in organization.posted]
    assert docks == ["dock_east", "dock_west", "dock_east"]


def test_a_robot_hires_the_service_of_the_dock_where_it_will_stand(tmp_path: Path) -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    organization = Organization((4, "retired"), (9, "active"), (7, "active"))
    body = KinematicBody(site, ManualClock())
    order = charging(body, tmp_path, organization, site)
    for _ in range(2):
        order.buy(0.5)
    hired = {request.params["dock"]: request.service_id for request in organization.posted}
    assert hired == dict(zip([dock.name for dock in site.docks], [7, 9], strict=True))


def test_a_robot_does_not_order_at_a_dock_that_takes_no_tasks(tmp_path: Path) -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    organization = Organization((7, "paused"), (9, "active"))
    body = KinematicBody(site, ManualClock())
    body.base = dock_parking(site.docks[0])
    charging(body, tmp_path, organization, site).buy(0.5)
    assert organization.posted[0].params["dock"] == site.docks[1].name


def test_a_robot_docks_where_it_is_told(tmp_path: Path) -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    body = KinematicBody(site, ManualClock())
    body.base = dock_parking(site.dock("dock_west"))
    memory = Memory(site, tmp_path / "memory.json")
    hands = manipulator(site, body, RayCamera(body), memory)
    assert hands.docked() == site.dock("dock_west")
    hands.dock(site.dock("dock_east"))
    assert hands.docked() == site.dock("dock_east")
