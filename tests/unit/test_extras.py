"""Each process imports what its extra installs, and nothing else."""

import os
import subprocess
import sys

import pytest

from rodeo.kinds import GROUP
from rodeo.site.processes import PROCESSES
from tests.support.extras import PROJECT, ROOT, closure
from tests.support.sweep import sweep

KINDS = sorted(one.partition(":")[0] for one in PROJECT["entry-points"][GROUP].values())
CODE = {
    "robot_agent": ["rodeo_kinds.waste_disposal.behaviour"],
    "mocap": ["services.mocap.sources.recorded", "services.mocap.sources.ros2"],
    "oracle": ["rodeo_kinds.waste_disposal.checks", "rodeo_kinds.battery_charging.checks"],
}
"""Process -> what it imports by name."""

NEVER = {
    "": {"numpy", "rosbags", "web3", "eth-account", "py-ecc", "mujoco", "starlette"},
    "router": {"numpy", "rosbags", "web3", "eth-account", "py-ecc", "mujoco"},
    "charger": {"numpy", "rosbags", "web3", "eth-account", "py-ecc", "mujoco", "opencv-python-headless"},
    "ros-dao": {"web3", "eth-account", "py-ecc", "mujoco", "opencv-python-headless"},
    "itrash": {"web3", "eth-account", "py-ecc", "mujoco"},
    "mocap": {"web3", "eth-account", "py-ecc", "mujoco"},
    "robot-sim": {"web3", "eth-account", "py-ecc"},
    "robot-agent": {"web3", "eth-account", "py-ecc"},
    "robot-recorder": {"web3", "eth-account", "py-ecc"},
    "oracle": {"web3", "eth-account", "py-ecc"},
    "console": {"web3", "eth-account", "py-ecc"},
    "chain": {"web3", "numpy", "mujoco"},
    "bridge": {"numpy", "rosbags", "mujoco", "opencv-python-headless"},
}


def imported(extra: str, *modules: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.support.extras", extra, *modules],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
    )


@pytest.mark.parametrize("process", sweep(PROCESSES, 6), ids=lambda one: one.name)
def test_a_process_imports_only_what_its_extra_installs(process) -> None:  # type: ignore[no-untyped-def]
    main = process.module if process.name == "router" else f"{process.module}.process"
    own = [] if process.name in ("router", "chain") else KINDS
    found = imported(process.extra, main, *own, *CODE.get(process.name, ()))
    assert found.returncode == 0, found.stderr


def test_a_client_imports_only_what_the_base_installs() -> None:
    found = imported("", "rodeo.dao", *KINDS)
    assert found.returncode == 0, found.stderr


def test_a_dock_that_imports_web3_is_found() -> None:
    found = imported("charger", "services.charger.process", "web3")
    assert "web3 belongs to web3" in found.stderr


@pytest.mark.parametrize(
    ("extra", "never"), NEVER.items(), ids=lambda one: one if isinstance(one, str) else ""
)
def test_an_extra_leaves_out_what_its_process_does_not_need(extra: str, never: set[str]) -> None:
    assert not closure(extra) & never


def test_every_process_has_an_extra_and_a_site_installs_all_of_them() -> None:
    extras = {one.extra for one in PROCESSES}
    assert extras <= PROJECT["optional-dependencies"].keys()
    together = set().union(*map(closure, extras))
    assert together <= closure("site")
