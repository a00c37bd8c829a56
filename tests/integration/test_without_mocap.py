"""A lab without motion capture: the robot finds its way and the item by itself, and its proof is paid."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.checks.report import Report
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo_testing.waiting import HANG_S
from tests.support.site import NewSite, RunningSite

pytestmark = pytest.mark.long

SITE = """lab.mocap = false
lab.furniture = []
agent.explore_when_idle = false
[[robots]]
name = "panther1"
pose = { x_m = 4.2, y_m = 2.2 }

[[items]]
id = "item1"
class = "metal"
shape = "can"
pose = { x_m = 5.2, y_m = 2.2, yaw_rad = 0.3 }
mass_kg = 0.03
"""


def test_the_robots_own_sight_is_proof_enough_and_the_report_says_that_it_is_weaker(
    new_site: NewSite,
) -> None:
    ended, events = threading.Event(), list[DaoEvent]()

    def on_event(event: DaoEvent) -> None:
        events.append(event)
        if event.name in ("TaskSettled", "TaskFailed"):
            ended.set()

    with RunningSite(new_site(SITE)) as running:
        running.start_founded()
        running.start("bridge", "oracle", "itrash", "robot_sim", "robot_agent")
        site = running.site
        dao = DaoEvents(running.bus, site.org, on_event)
        params: dict[str, Any] = {"item_id": "item1", "x_m": 5.3, "y_m": 2.15}
        request = {"kind": "waste_disposal", "reward_iec": "100", "params": params}
        key = f"rodeo/{site.org}/wallet/organization/register_task"
        task_id = int(running.bus.query(key, request, timeout_s=HANG_S)["task_id"])
        came = ended.wait(HANG_S)
        names = [event.name for event in events]  # others may have come after the last
        assert came and "TaskSettled" in names, f"{events}\n{running.log('robot_agent')}"
        task = running.bus.query(f"rodeo/{site.org}/state/task/{task_id}", timeout_s=HANG_S)
        dao.close()
    proof = open_proof(Store(site).fetch(task["proof_uri"], task["proof_sha256"]))
    assert not [topic for topic in proof.topics if topic.startswith("/mocap/")]
    assert proof.count("/panther1/item_pose") >= 1
    stored = (site.data_dir / "store").glob("*.json")
    reports = [Report.model_validate_json(path.read_bytes()) for path in stored]
    (accepted,) = [report for report in reports if report.accepted]
    assert accepted.item_pose_source == "perception"
    skipped = {check.name for check in accepted.checks if check.passed is None}
    seen_by_motion_capture = {
        "gripper_agrees",
        "item_in_gripper",
        "item_outside_bin",
        "motion_capture",
        "odometry",
        "order",
        "seen_throughout",
        "witnessed",
    }
    assert skipped == seen_by_motion_capture
