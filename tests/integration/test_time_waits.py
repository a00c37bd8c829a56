"""What comes of a task at full speed follows from the site alone, whatever the machine has to do besides."""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from rodeo.chain.client import ChainClient
from rodeo.chain.contracts import events
from rodeo.chain.deployment import Deployment
from rodeo.checks.report import Report
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo.site import topics
from rodeo_testing.waiting import HANG_S
from tests.support.live import LiveDao, living
from tests.support.load import busy_machine
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long

FULL_SPEED = "clock.speed = 0\nclock.idle_speed = 0\n"
REAL_TIME = "clock.speed = 1\nclock.idle_speed = 1\n"
SITE = """clock.seed = 7
clock.holders = ["robot_agent", "itrash", "charger", "bridge", "oracle", "chain"]
agent.explore_when_idle = false
agent.charge_below = 0.1
"""
CHAIN_ID = 31_337
WINDOW_S, LATE_S = 7200, 2
"""Site time: a window in which nobody does anything, and by how much it may end late."""
STOPPED_BEATS = 20
"""Heartbeats of the simulator after it was named: a silent session lasts half as long elsewhere."""


def stop_for_a_while(running: RunningSite, name: str) -> None:
    """No process advances meanwhile, and an error names whom everybody waits for."""
    pid = running.children[name].pid
    os.kill(pid, signal.SIGSTOP)
    waits = f"the clock waits for {name}"
    before = running.wait_for_status("robot_sim", lambda status: waits in status.warnings)
    beats = threading.Semaphore(0)
    key = topics.STATUS.name(org=running.site.org, process="robot_sim")
    heartbeats = running.bus.subscribe_json(key, lambda *_: beats.release())
    for _ in range(STOPPED_BEATS):
        assert beats.acquire(timeout=HANG_S)
    heartbeats.undeclare()
    after = running.status("robot_sim")
    os.kill(pid, signal.SIGCONT)
    assert after.details["site_time_s"] == before.details["site_time_s"]
    assert waits in after.warnings
    running.wait_for_status("robot_sim", lambda status: waits not in status.warnings)


def expire(running: RunningSite, organization: LiveDao) -> None:
    """Nothing moves while a window runs: the clock jumps to its end, and not over it."""
    task_id = organization.clean("item2", execution_window_s=WINDOW_S, max_attempts=1)
    organization.wait_for_event("TaskAssigned", task_id)
    order = topics.ROBOT_ORDER.name(org=running.site.org, robot="panther1", order="stop")
    running.bus.query(order, timeout_s=HANG_S)
    failed = organization.wait_for_event("TaskFailed", task_id)
    assigned = next(
        one for one in organization.events if (one.name, one.task_id) == ("TaskAssigned", task_id)
    )
    assert WINDOW_S < failed.time_s - assigned.time_s <= WINDOW_S + LATE_S


def charge(running: RunningSite, organization: LiveDao, task_id: int) -> None:
    """The dock hears each of its readings, although many seconds pass at once."""
    for order in ("resume", "charge"):
        running.bus.query(topics.ROBOT_ORDER.name(org=running.site.org, robot="panther1", order=order))
    organization.wait_for_event("TaskSettled", task_id)
    task = organization.task(task_id)
    proof = open_proof(Store(running.site).fetch(task["proof_uri"], task["proof_sha256"]))
    ended = next(event for event in proof.events() if event.get("event") == "session_ended")
    assert (task["kind"], task["verdict"], ended["left_out"]) == ("battery_charging", "accepted", {})


def balances_iec(running: RunningSite, block: int) -> dict[str, int]:
    """What each participant had at the end of `block`: the chain does not stand still while it is asked."""
    client = ChainClient(running.site.chain.url, Deployment.load(running.site.data_dir, CHAIN_ID))
    balances: Counter[str] = Counter()
    for log in client.logs(0, block):
        if isinstance(log.event, events.Transfer):
            balances[log.event.to] += log.event.value
            balances[log.event.sender] -= log.event.value
    participants = running.bus.query(f"rodeo/{running.site.org}/state/participants")["participants"]
    return {one["name"]: balances[one["address"]] // 10**18 for one in participants}


def run(folder: Path, chain_backend: str, stopped: str | None) -> dict[str, Any]:
    """What one cleaning came to."""
    path = write_site(folder, chain_backend, FULL_SPEED + SITE)
    with living(path, "bridge", "oracle", "itrash", "charger", "robot_sim") as organization:
        running = organization.running
        # With nothing to do a robot lets days pass in seconds: how many would be the machine's choice.
        task_id = organization.clean("item1")
        running.start("robot_agent")
        if stopped is not None:
            organization.wait_for_activity("carrying item1")
            stop_for_a_while(running, stopped)
        settled = organization.wait_for_event("TaskSettled", task_id)
        task = organization.task(task_id)
        came_to = {name: task[name] for name in ("state", "attempt", "verdict", "paid_iec")}
        came_to["balances_iec"] = balances_iec(running, settled.block)
        came_to["events"] = Counter(event.name for event in organization.events if event.task_id == task_id)
        if stopped is None:
            expire(running, organization)
            charge(running, organization, task_id + 2)
        return came_to


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


def checked(folder: Path, chain_backend: str, clock: str) -> list[tuple[str, bool | None]]:
    """The checks of one cleaning's recording, in their order, and whether it passed them."""
    folder.mkdir()
    path = write_site(folder, chain_backend, clock + SITE)
    with living(path, "bridge", "oracle", "itrash", "robot_sim") as organization:
        running = organization.running
        task_id = organization.clean("item1")
        running.start("robot_agent")
        organization.wait_for_event("TaskSettled", task_id)
        task = organization.task(task_id)
        path = Store(running.site).fetch(task["report_uri"], task["report_sha256"], folder=folder / "report")
        report = Report.model_validate_json(path.read_bytes())
        assert report.accepted and task["attempt"] == 1
        return [(check.name, check.passed) for check in report.checks]


def test_a_recording_made_at_full_speed_verifies_like_one_made_in_real_time(
    tmp_path: Path, chain_backend: str
) -> None:
    fast, slow = (
        checked(tmp_path / name, chain_backend, clock)
        for name, clock in (("fast", FULL_SPEED), ("slow", REAL_TIME))
    )
    assert fast == slow and len(fast) > 20
