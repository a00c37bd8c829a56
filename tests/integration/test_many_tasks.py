"""Several tasks at once, and some that nobody can do: work is paid, the rest refunded with its reason."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.live import LiveDao, living
from tests.support.site import NewSite

pytestmark = pytest.mark.long

SITE = """clock.speed = 20
clock.idle_speed = 400
"""


@pytest.fixture(scope="module")
def organization(new_site: NewSite) -> Iterator[LiveDao]:
    path = new_site(SITE)
    with living(path, "bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent") as organization:
        yield organization


def ended(organization: LiveDao, name: str, task_id: int) -> dict[str, Any]:
    organization.wait_for_event(name, task_id)
    return organization.task(task_id)


def test_tasks_that_wait_at_once_are_done_one_after_another(organization: LiveDao) -> None:
    before_iec = organization.balances_iec()["panther1"]
    task_ids = [organization.clean(f"item{n}") for n in (1, 2, 3)]
    for task_id in task_ids:
        task = ended(organization, "TaskSettled", task_id)
        assert (task["state"], task["attempt"], task["verdict"]) == ("settled", 1, "accepted"), task
    assert organization.balances_iec()["panther1"] - before_iec == 300

    # What is in the bin cannot be brought there again: motion capture shows that it is not where the task
    # says, and the robot is paid a tenth for its trouble. It lies alone in its compartment: two would creep
    # over each other, and nobody could tell since when each lies there. What the site does not have is given
    # back at once.
    again = organization.clean("item3")
    unknown = organization.clean("item99")
    # No service is that cheap, so that nobody begins it before it is cancelled.
    cancelled = organization.clean("item2", reward_iec="1", allow_wait=True)
    organization.cancel(cancelled)
    assert organization.task(cancelled)["state"] == "cancelled"
    task = ended(organization, "TaskSettled", again)
    assert (task["attempt"], task["verdict"], task["paid_iec"], task["refunded_iec"]) == (
        1,
        "impossible",
        "10",
        "90",
    ), task
    assert task["reason"].startswith("not_given_up: how near the item was to the task's place"), task
    task = ended(organization, "TaskRequeued", unknown)
    assert (task["state"], task["verdict"]) == ("open", "abandoned")
    assert [one["provider_name"] for one in task["passed"]] == ["panther1"], "it is not offered it again"
    organization.cancel(unknown)
    assert organization.task(unknown)["refunded_iec"] == "100"
    assert organization.balances_iec()["panther1"] - before_iec == 310
    assert any("item3 was not found near" in text for text in organization.activities)
