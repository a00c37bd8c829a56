"""What comes of a task at full speed follows from the site alone, whatever the machine has to do besides."""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tests.integration.test_agent import Organization
from tests.support.load import busy_machine
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long

SITE = """clock.speed = 0
clock.idle_speed = 400
clock.seed = 7
clock.holders = ["robot_agent", "itrash", "charger", "bridge"]
agent.explore_when_idle = false
agent.charge_below = 0.1
"""
STOPPED_S = 1.0
"""After it was named. Who is silent for 10 s has left the bus, and is not waited for."""


def stop_for_a_while(running: RunningSite, name: str) -> None:
    """Nobody goes on meanwhile, and it is named whom everybody waits for."""
    pid = running.children[name].pid
    os.kill(pid, signal.SIGSTOP)
    waits = f"the clock waits for {name}"
    before = running.wait_for_status("robot_sim", lambda status: waits in status.warnings)
    threading.Event().wait(STOPPED_S)
    after = running.status("robot_sim")
    os.kill(pid, signal.SIGCONT)
    assert after.details["site_time_s"] == before.details["site_time_s"]
    assert waits in after.warnings
    running.wait_for_status("robot_sim", lambda status: waits not in status.warnings)


def run(folder: Path, chain_backend: str, stopped: str | None) -> dict[str, Any]:
    """What one cleaning came to."""
    running = RunningSite(write_site(folder, chain_backend, SITE))
    running.start("router", "chain")
    running.deploy_contracts()
    running.start("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
    organization = Organization(running)
    try:
        task_id = organization.post("item1")
        if stopped is not None:
            organization.wait_for_activity("carrying item1")
            stop_for_a_while(running, stopped)
        organization.wait_for_event("TaskSettled", task_id)
        task = organization.task(task_id)
        participants = running.bus.query(f"rodeo/{running.site.org}/state/participants")["participants"]
        came_to = {name: task[name] for name in ("state", "attempt", "verdict", "paid_iec")}
        came_to["balances_iec"] = {one["name"]: one["balance_iec"] for one in participants}
        came_to["events"] = Counter(event.name for event in organization.events if event.task_id == task_id)
        return came_to
    finally:
        organization.close()
        running.stop()


@pytest.mark.timeout(900)
def test_a_busy_machine_and_a_process_that_stands_still_change_nothing(
    tmp_path: Path, chain_backend: str
) -> None:
    for name in ("quiet", "busy"):
        (tmp_path / name).mkdir()
    quiet = run(tmp_path / "quiet", chain_backend, None)
    with busy_machine():
        busy = run(tmp_path / "busy", chain_backend, "itrash")
    assert (quiet["state"], quiet["verdict"], quiet["attempt"]) == ("settled", "accepted", 1)
    assert busy == quiet
