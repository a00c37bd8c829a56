"""Processes start alone and in any order, as their units say: each waits, and says for what."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from rodeo.bus.messages import Status
from rodeo_testing.waiting import wait_until
from tests.support.site import LAB_PROCESSES
from tests.support.units import UnitsOfSite

pytestmark = pytest.mark.long

LAST = ("chain", "router")


@pytest.fixture
def bare(site_path: Path) -> Iterator[UnitsOfSite]:
    """A site on which nothing was ever done: not even keystores."""
    site = UnitsOfSite(site_path)
    yield site
    site.stop()


def says_what_is_missing(status: Status) -> bool:
    return status.reason.startswith("waiting for ") or "run `rodeo site prepare`" in status.reason


def test_the_last_comes_first_and_all_become_ready(bare: UnitsOfSite) -> None:
    first = [process.name for process in reversed(LAB_PROCESSES) if process.name not in LAST]
    bare.start(*first, ready=False)
    bare.start(*LAST, ready=False)
    bare.wait_ready("chain", "router", "robot_sim", "oracle")
    for name in ("robot_agent", "itrash", "charger", "bridge"):
        status = bare.wait_for_status(name, says_what_is_missing)
        assert not status.ready
        wait_until(lambda name=name: "WATCHDOG=1" in bare.manager(name).said, f"{name} is alive")
        assert "READY=1" not in bare.manager(name).said, "who waits is not ready"
    bare.deploy_contracts()
    bare.wait_ready(*first)
    for name in (*first, *LAST):
        wait_until(lambda name=name: "READY=1" in bare.manager(name).said, f"systemd hears of {name}")
