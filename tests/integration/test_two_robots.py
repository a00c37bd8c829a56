"""Two robots on one site: each with its own mind, wallet and recordings, one bin between them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest

from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from tests.support.live import LiveDao
from tests.support.site import NewSite, RunningSite

pytestmark = pytest.mark.long

ROBOTS = ("panther1", "panther2")
SITE = """clock.speed = 20
clock.seed = 7
agent.explore_when_idle = false

[[robots]]
name = "panther1"
pose = { x_m = 1.4, y_m = 1.3 }

[[robots]]
name = "panther2"
pose = { x_m = 3.6, y_m = 4.1 }
"""


@pytest.fixture
def organization(new_site: NewSite) -> Iterator[LiveDao]:
    with RunningSite(new_site(SITE)) as running:
        running.start_founded()
        agents = [f"robot_agent.{name}" for name in ROBOTS]
        running.start("bridge", "oracle", "itrash", "robot_sim")
        # The last one first: it waits for the others, however long they take.
        running.start(agents[1], ready=False)
        first = f"waiting for {ROBOTS[0]} to offer its work first"
        running.wait_for_status(agents[1], lambda status: status.activity == first)
        running.start(agents[0])
        running.wait_ready(agents[1])
        with closing(LiveDao(running, wait_s=350.0)) as organization:
            yield organization


def test_two_tasks_are_done_by_two_robots_which_are_both_paid(organization: LiveDao) -> None:
    running = organization.running
    offers = running.bus.query(f"rodeo/{running.site.org}/state/services")["services"]
    offers = [one for one in offers if one["kind"] == "waste_disposal"]
    assert [one["provider_name"] for one in sorted(offers, key=lambda one: one["id"])] == list(ROBOTS)
    tasks = []
    for task_id in [organization.clean(item) for item in ("item1", "item2")]:
        organization.wait_for_event("TaskSettled", task_id)
        tasks.append(organization.task(task_id))
    assert {task["executor_name"] for task in tasks} == set(ROBOTS)
    assert [(task["attempt"], task["verdict"]) for task in tasks] == [(1, "accepted")] * 2, "\n".join(
        [str(event) for event in organization.events]
        + [running.log(f"robot_agent.{name}") for name in ROBOTS]
    )
    for task in tasks:
        proof = open_proof(Store(running.site).fetch(task["proof_uri"], task["proof_sha256"]))
        recorded = {name for name in ROBOTS if f"/{name}/odom" in proof.topics}
        assert recorded == {task["executor_name"]}
    wallets = running.bus.query(f"rodeo/{running.site.org}/state/wallets")["wallets"]
    earned = {w["name"]: float(w["balance_iec"]) - 2000 for w in wallets if w["name"] in ROBOTS}
    assert earned == dict.fromkeys(ROBOTS, 100.0)
