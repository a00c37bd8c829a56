"""Several tasks at once, and some that nobody can do: work is paid, the rest refunded with its reason."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.integration.test_agent import Organization
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long

SITE = """clock.speed = 20
clock.idle_speed = 400
"""


@pytest.fixture(scope="module")
def organization(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Organization]:
    running = RunningSite(write_site(tmp_path_factory.mktemp("many"), chain_backend, SITE))
    running.start("router", "chain")
    running.deploy_contracts()
    running.start("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
    organization = Organization(running)
    yield organization
    organization.close()
    running.stop()


def robot_iec(organization: Organization) -> float:
    state = organization.running.bus.query(f"rodeo/{organization.running.site.org}/state/wallets")
    return next(float(w["balance_iec"]) for w in state["wallets"] if w["name"] == "panther1")


def ended(organization: Organization, name: str, task_id: int) -> dict[str, Any]:
    organization.wait_for_event(name, task_id)
    return organization.task(task_id)


def test_tasks_that_wait_at_once_are_done_one_after_another(organization: Organization) -> None:
    before_iec = robot_iec(organization)
    task_ids = [organization.post(f"item{n}") for n in (1, 2, 3)]
    for task_id in task_ids:
        task = ended(organization, "TaskSettled", task_id)
        assert (task["state"], task["attempt"], task["verdict"]) == ("settled", 1, "accepted"), task
    assert robot_iec(organization) - before_iec == 300

    # What is in the bin cannot be brought there again, what is not there not at all; both end soon.
    again = organization.post("item1")
    unknown = organization.post("item99")
    cancelled = organization.post("item2")
    organization.cancel(cancelled)
    assert organization.task(cancelled)["state"] == "cancelled"
    pose = organization.running.site.items[0].pose
    place = f"x {pose.x_m:.2f} y {pose.y_m:.2f}"
    for task_id, reason in [
        (
            again,
            f"not_given_up: the executor reports: item1 was not found near {place}: the item is not there",
        ),
        (unknown, "not_given_up: the executor reports: no such item on this site"),
    ]:
        task = ended(organization, "TaskFailed", task_id)
        assert (task["state"], task["attempt"], task["verdict"], task["reason"]) == (
            "failed",
            task["max_attempts"],
            "rejected",
            reason,
        )
        refund = organization.wait_for_event("TaskFailed", task_id).args["refund_iec"]
        assert float(refund) == 100
    assert robot_iec(organization) - before_iec == 300
    assert any("item1 was not found near" in text for text in organization.activities)
