"""The bin of examples/my_bin.py, run as it stands there, until a robot is paid."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.host.instance import PARENT_VARIABLE
from rodeo_testing.waiting import HANG_S
from tests.support.site import NewSite, RunningSite

pytestmark = pytest.mark.long

PROGRAM = Path(__file__).parents[2] / "examples" / "my_bin.py"
SITE = "clock.speed = 4\nagent.explore_when_idle = false\nlab.furniture = []"


def test_the_foreign_bin_imports_nothing_of_the_services() -> None:
    for node in ast.walk(ast.parse(PROGRAM.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith(("services", "deploy", "tests")), node.module


@pytest.fixture
def running(new_site: NewSite) -> Iterator[RunningSite]:
    with RunningSite(new_site(SITE)) as running:
        logs = running.site.data_dir / "logs"
        running.start_founded()
        running.start("robot_sim", "bridge", "oracle")
        with (logs / "itrash.log").open("ab") as output:
            running.children["itrash"] = subprocess.Popen(
                [sys.executable, str(PROGRAM), "--site", str(running.path)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, PARENT_VARIABLE: str(os.getpid())},
            )
        running.wait_ready("itrash")
        running.start("robot_agent")
        yield running


def test_a_robot_is_paid_on_the_word_of_a_bin_of_another_make(running: RunningSite) -> None:
    ended = threading.Event()
    events: list[DaoEvent] = []

    def on_event(event: DaoEvent) -> None:
        events.append(event)
        if event.name in ("TaskSettled", "TaskRequeued", "TaskFailed"):
            ended.set()

    dao = DaoEvents(running.bus, running.site.org, on_event)
    item = running.site.items[0]
    params: dict[str, Any] = {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
    key = f"rodeo/{running.site.org}/wallet/organization/register_task"
    running.bus.query(
        key, {"kind": "waste_disposal", "reward_iec": "100", "params": params}, timeout_s=HANG_S
    )
    came = ended.wait(HANG_S)
    dao.close()
    names = [event.name for event in events]
    why = f"{names}\n{running.log('itrash')}\n{running.log('robot_agent')}\n{running.log('oracle')}"
    assert came and "TaskSettled" in names, why
