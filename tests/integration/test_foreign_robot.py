"""A robot of another make does a task: a process that knows zenoh-ros2-sdk and nothing of this project."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from rodeo.host.instance import PARENT_VARIABLE
from rodeo.lab.items import shape_of
from rodeo.lab.world import robot_model
from services.robot_sim.urdf import to_urdf
from tests.support.imports import packages_of
from tests.support.live import LiveDao
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long

FOREIGN = Path(__file__).parents[1] / "foreign_robot"
SITE = """clock.speed = 2
agent.explore_when_idle = false
lab.furniture = []
lab.mocap_gripper = false
[[robots]]
name = "arthur"
namespace = "fleet/arthur"
body = "ros2"
kinematics = "arthur.urdf"
wallet = "purse"
pose = { x_m = 3.1, y_m = 2.0 }

[[items]]
id = "item1"
class = "metal"
shape = "can"
pose = { x_m = 4.3, y_m = 2.0 }
mass_kg = 0.03
"""
BESIDE = """
[[items]]
id = "item2"
class = "metal"
shape = "can"
pose = { x_m = 2.4, y_m = 3.4 }
mass_kg = 0.05

[[robots]]
name = "panther1"
pose = { x_m = 1.2, y_m = 3.4 }
"""
"""One of ours, with an item of its own."""


def test_the_foreign_robot_imports_nothing_of_ours() -> None:
    own = {path.stem for path in FOREIGN.glob("*.py")}
    allowed = {*sys.stdlib_module_names, "numpy", "mujoco", "rosbags", "zenoh_ros2_sdk", *own}
    for path in FOREIGN.glob("*.py"):
        assert packages_of(path) <= allowed, path.name


class ForeignRobot:
    """Its process, which starts with the site's router."""

    def __init__(self, running: RunningSite) -> None:
        site = running.site
        robot, item = site.robots[0], site.items[0]
        radius_m, _, half_height_m = shape_of(item).half_m
        self._log = open(site.data_dir / "foreign.log", "wb")  # noqa: SIM115 - closed with the process
        arguments = {
            "--namespace": robot.namespace,
            "--body": robot.name,
            "--urdf": str(robot.kinematics),
            "--item": item.id,
            "--item-radius": str(radius_m),
            "--item-half-height": str(half_height_m),
        }
        self._process = subprocess.Popen(
            [
                *(sys.executable, str(FOREIGN / "robot.py"), "--pose", "3.1", "2.0", "0"),
                *(word for pair in arguments.items() for word in pair),
            ],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            cwd=site.data_dir,
            env={
                **{k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", PARENT_VARIABLE)},
                "ZENOH_CONFIG_OVERRIDE": f'mode="client";connect/endpoints=["{site.bus.router}"]',
            },
        )

    def stop(self) -> None:
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        self._log.close()


@contextmanager
def running_site(folder: Path, chain_backend: str, site: str, *minds: str) -> Iterator[RunningSite]:
    (folder / "arthur.urdf").write_text(to_urdf(robot_model(), "arthur"))
    with RunningSite(write_site(folder, chain_backend, site)) as running:
        running.start_founded("robot_sim")
        foreign = ForeignRobot(running)
        try:
            running.start("bridge", "oracle", "itrash", *minds)
            yield running
        finally:
            foreign.stop()


@pytest.fixture
def running(tmp_path: Path, chain_backend: str) -> Iterator[RunningSite]:
    with running_site(tmp_path, chain_backend, SITE, "robot_agent") as running:
        yield running


def test_the_agent_does_a_task_with_a_robot_of_another_make(running: RunningSite) -> None:
    item = running.site.items[0]
    params = {"item_id": item.id, "x_m": item.pose.x_m + 0.1, "y_m": item.pose.y_m - 0.1}
    with closing(LiveDao(running)) as organization:
        organization.wait_for_event("TaskSettled", organization.clean(item.id, params=params))


def test_one_of_ours_works_beside_it_on_a_clock_that_waits_for_minds_and_jumps_where_nobody_works(
    tmp_path: Path, chain_backend: str
) -> None:
    """What the foreign robot does nobody here simulates, and time is not jumped over while it does it."""
    with (
        running_site(tmp_path, chain_backend, f"clock.idle_speed = 0\n{SITE}{BESIDE}") as running,
        closing(LiveDao(running)) as organization,
    ):
        # Before there are minds: this robot lives through the time that is jumped over, and is late then.
        tasks = [organization.clean("item1")]
        running.start("robot_agent.arthur")
        organization.wait_for_event("TaskAssigned", tasks[0])
        running.start("robot_agent.panther1")
        settled = [organization.wait_for_event("TaskSettled", tasks[0])]
        tasks.append(organization.clean("item2", provider="panther1"))
        settled.append(organization.wait_for_event("TaskSettled", tasks[1]))
        for number, executor in enumerate(("arthur", "panther1")):
            task = organization.task(tasks[number])
            assert (task["verdict"], task["attempt"], task["executor_name"]) == ("accepted", 1, executor)
            # Minutes of work: had the clock jumped meanwhile, it would be hours.
            assert 20 < settled[number].time_s - task["assigned"] < 900
