"""An organization moves to new contracts: the processes of a site before, meanwhile and after."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from rodeo.chain.deployment import Deployment
from rodeo_testing.waiting import HANG_S
from tests.integration.test_agent import SITE, Organization
from tests.support.command import rodeo
from tests.support.dao import Dao
from tests.support.site import RunningSite, write_site


@pytest.fixture
def dao(tmp_path: Path, chain_backend: str) -> Iterator[Dao]:
    running = RunningSite(write_site(tmp_path, chain_backend))
    dao = Dao(running)
    dao.start()
    yield dao
    dao.stop()
    running.stop()


def migrate(running: RunningSite, status: int = 0) -> str:
    """What `rodeo organization migrate` prints."""
    path = str(running.path)
    done = rodeo("organization", "migrate", "--yes", "--site", path, env=dict(os.environ), timeout_s=HANG_S)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def offered(dao: Dao) -> dict[str, object]:
    """The robot's service that is not retired."""
    (service,) = [one for one in dao.state("services")["services"] if one["state"] != "retired"]
    return dict(service)


@pytest.mark.long
def test_a_task_ends_where_it_was_posted_and_the_next_one_is_done_in_the_new_organization(dao: Dao) -> None:
    dao.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
    task = dao.post()
    assert "tasks_run_on" in migrate(dao.running, status=1)
    # What runs goes on with the bridge that runs.
    dao.prove(task)
    dao.judge(task, accepted=True)
    old, before = dao.client(), dao.balances()
    reputation = offered(dao)["reputation"]
    assert "rodeo down" in migrate(dao.running, status=1)
    dao.running.kill("bridge")
    said = migrate(dao.running)
    assert "is known for its work" in said and old.organization in said
    dao.running.start("bridge")
    dao.wait_for(lambda: dao.client().organization != old.organization, "another organization")
    assert dao.balances() == before
    assert dao.state("organization")["address"] == dao.client().organization
    dao.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
    assert offered(dao)["reputation"] == reputation
    again = dao.post()
    assert (again, dao.task(again)["executor_name"]) == (1, "panther1")
    dao.prove(again, digit="c")
    dao.judge(again, accepted=True)
    assert dao.task(again)["state"] == "settled"
    kept = dao.site.data_dir / "deployments" / f"31337-{old.organization}.json"
    assert Deployment.model_validate_json(kept.read_text()).is_same(old.deployment)


@pytest.mark.long
def test_robots_work_in_the_new_organization_whose_first_task_has_the_number_of_the_old_one(
    tmp_path: Path,
) -> None:
    running = RunningSite(write_site(tmp_path, extra=SITE))
    organization = None
    try:
        running.start_founded()
        running.start("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
        organization = Organization(running)
        assert organization.post("item1") == 1
        organization.wait_for_event("TaskSettled", 1)
        running.kill("bridge")
        migrate(running)
        running.start("bridge", ready=False)
        running.wait_ready("bridge", "charger", "robot_agent")
        organization.events.clear()
        assert organization.post("item2") == 1
        organization.wait_for_event("TaskSettled", 1)
    finally:
        if organization is not None:
            organization.close()
        running.stop()
