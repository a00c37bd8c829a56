"""Around a charge: the dock is left when there is nothing to wait for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rodeo.config import Site
from rodeo.lab.layout import dock_parking, on_contacts
from services.robot_agent.charging import Charging, left_s
from services.robot_agent.memory import Memory
from services.robot_agent.navigation import Floor
from tests.support.site import LAB
from tests.unit.services.robot_agent.fakes import KinematicBody, ManualClock

SITE = Site.load(LAB)


def charging(body: KinematicBody, folder: Path) -> Charging:
    dao: Any = None
    memory = Memory(SITE, folder / "memory.json")
    return Charging(SITE, "panther1", dao, body, Floor(SITE), memory, ManualClock())  # type: ignore[arg-type]


def test_a_robot_on_the_contacts_leaves_them(tmp_path: Path) -> None:
    body, said = KinematicBody(SITE, ManualClock()), []
    body.base = dock_parking(SITE.dock)
    charging(body, tmp_path).clear_the_dock(lambda: None, lambda text, share: said.append(text))
    assert not on_contacts(SITE.dock, body.base)
    assert said == ["leaving the dock"]


def test_a_robot_elsewhere_stays_where_it_is(tmp_path: Path) -> None:
    body, said = KinematicBody(SITE, ManualClock()), []
    charging(body, tmp_path).clear_the_dock(lambda: None, lambda text, share: said.append(text))
    assert body.drives == said == []


def test_how_long_a_charge_takes_is_what_is_missing_at_the_pace_so_far() -> None:
    assert left_s((100.0, 0.50), (160.0, 0.56), 0.95) == pytest.approx(390)
    assert left_s((100.0, 0.50), (160.0, 0.96), 0.95) == 0
    assert left_s((100.0, 0.50), (100.0, 0.50), 0.95) is None
