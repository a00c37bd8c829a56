"""A local chain that is begun anew under a running site: nobody takes its first task for the one it knew."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from deploy.chain.record import give_up_chain
from rodeo.dao import ORGANIZATION, Participant
from tests.integration.test_agent import SITE
from tests.support.live import living
from tests.support.site import write_site


@pytest.mark.long
def test_task_1_of_a_new_chain_is_done_and_paid_and_the_charger_offers_again(tmp_path: Path) -> None:
    processes = "bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent"
    with living(write_site(tmp_path, extra=SITE), *processes) as organization:
        running = organization.running
        assert organization.clean("item1") == 1
        organization.wait_for_event("TaskSettled", 1)

        running.kill("chain")
        shutil.rmtree(running.site.data_dir / "chain")
        assert give_up_chain(running.site) is not None
        running.start("chain", ready=False)
        running.deploy_contracts()
        running.wait_ready("bridge", "charger", "robot_agent")
        organization.events.clear()

        assert organization.clean("item2") == 1
        organization.wait_for_event("TaskSettled", 1)
        assert (
            Participant(running.bus, running.site.org, ORGANIZATION).own_service("battery_charging")
            is not None
        )
        assert "belongs to another chain" in running.log("robot_agent")
        attempts = {path.name for path in (running.site.data_dir / "robot_agent" / "tasks").iterdir()}
        assert attempts == {"1-1", "1-1.of-another-assignment-1"}
