"""A lab without motion capture: the robot finds its way and the item by itself, and its proof is paid."""

from __future__ import annotations

import pytest

from rodeo.checks.report import Report
from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo_kinds.waste_disposal.checks.found import NAMED
from tests.support.live import living
from tests.support.site import NewSite

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
    with living(new_site(SITE), "bridge", "oracle", "itrash", "robot_sim", "robot_agent") as organization:
        site = organization.site
        task_id = organization.clean("item1", params={"item_id": "item1", "x_m": 5.3, "y_m": 2.15})
        organization.wait_for_event("TaskSettled", task_id)
        task = organization.task(task_id)
    proof = open_proof(Store(site).fetch(task["proof_uri"], task["proof_sha256"]))
    assert not [topic for topic in proof.topics if topic.startswith("/mocap/")]
    assert proof.count("/panther1/item_pose") >= 1
    stored = (site.data_dir / "store").glob("*.json")
    reports = [Report.model_validate_json(path.read_bytes()) for path in stored]
    (accepted,) = [report for report in reports if report.accepted]
    assert accepted.item_pose_source == "perception"
    skipped = {check.name for check in accepted.checks if check.passed is None and check.detail != NAMED}
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
