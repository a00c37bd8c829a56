"""A lab without the simulator: real time, and a world that speaks NatNet, Modbus, MJPEG and ROS 2 alone."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rodeo.site.processes import processes_of
from rodeo.site.providers import SIMULATOR, devices
from tests.support.reallab import RealLab, work

pytestmark = [pytest.mark.long, pytest.mark.alone]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealLab]:
    with RealLab(tmp_path_factory.mktemp("reallab")) as lab:
        yield lab


def test_a_lab_without_the_simulator_pays_for_two_robots_cleanings_and_a_charge(lab: RealLab) -> None:
    assert {one.source for one in devices(lab.site)} == {"natnet", "ros2", "modbus"}
    assert SIMULATOR not in {one.name for one in processes_of(lab.site)}
    paid = [(one["kind"], one["creator_name"], one["executor_name"]) for one in work(lab)]
    first, second = lab.robots
    assert [executor for kind, _, executor in paid if kind == "waste_disposal"] == [first, second]
    assert [creator for kind, creator, _ in paid if kind == "battery_charging"] == [first]
