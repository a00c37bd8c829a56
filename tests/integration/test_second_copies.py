"""A second copy of each process, with the same keys and another data folder, on the bus of a running site."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rodeo.host.instance import GAVE_UP
from rodeo.runtime.serving import Claim, served_by
from rodeo_cli.site import read_rows
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.dao import Dao
from tests.support.site import NewSite, RunningSite, free_port

pytestmark = pytest.mark.long

SERVES = {
    "bridge": "wallet oracle, wallet organization, wallet panther1",
    "oracle": "oracle oracle",
    "itrash": "bin itrash",
    "charger": "dock dock1",
    "console": "console console",
    "robot_sim": "clock domain0",
    "robot_agent": "robot panther1",
}


@pytest.fixture
def dao(new_site: NewSite) -> Iterator[Dao]:
    """Router, chain and bridge, and somebody who holds what the other processes serve."""
    with RunningSite(new_site('clock.source = "wall"')) as running:
        dao = Dao(running)
        dao.start()
        others = [thing for name in SERVES if name != "bridge" for thing in served_by(running.site, name)]
        claim = Claim(running.bus.session, running.site.org, others, lambda: running.bus.connected)
        claim.take(threading.Event())
        yield dao
        claim.close()
        dao.close()


@pytest.fixture
def elsewhere(dao: Dao, tmp_path: Path) -> Iterator[RunningSite]:
    """The same site on another machine: its own data, the same keys, the same chain."""
    first = dao.running
    path = tmp_path / "elsewhere.toml"
    path.write_text(
        f"extends = {json.dumps(str(first.path))}\n"
        'data_dir = "elsewhere"\n'
        f"console.port = {free_port()}\n"
        f"bus.router = {json.dumps(first.site.bus.router)}\n"
    )
    for name in first.site.data_dir.iterdir():
        if name.name in ("keys", "deployments"):
            copy = tmp_path / "elsewhere" / name.name
            copy.parent.mkdir(exist_ok=True)
            shutil.copytree(name, copy)
    with RunningSite(path) as site:
        yield site


def test_a_second_copy_refuses_to_serve_and_each_task_is_posted_once(
    dao: Dao, elsewhere: RunningSite
) -> None:
    elsewhere.start(*SERVES, ready=False)

    wait_until(
        lambda: {row.here for row in read_rows(dao.running.site) if row.name != "bridge"} != {True, False},
        lambda: elsewhere.log("bridge"),
    )
    before = len(dao.state("tasks")["tasks"])
    balance_iec = dao.balances()["organization"]
    with ThreadPoolExecutor(max_workers=20) as askers:
        tasks = list(askers.map(lambda n: dao.post("10", request_id=f"post {n}"), range(20)))
    statuses = {name: child.wait(timeout=HANG_S) for name, child in elsewhere.children.items()}
    assert statuses == dict.fromkeys(SERVES, GAVE_UP)
    for name, things in SERVES.items():
        log = elsewhere.log(name)
        assert "served_elsewhere: already served by process" in log and f": {things};" in log, log
        assert ": ready" not in log
    assert len(set(tasks)) == 20
    assert dao.balances()["organization"] == balance_iec - 200
    assert len(dao.state("tasks")["tasks"]) == before + 20
    rows = {row.name: row for row in read_rows(elsewhere.site)}
    assert all(rows[name].state == "gave up" for name in SERVES)
    assert "already served by process" in rows["bridge"].reason
    (bridge,) = [row for row in read_rows(dao.running.site) if row.name == "bridge"]
    assert bridge.here and bridge.state == "ready" and bridge.status is not None
    assert any("tries to serve" in text and "wallet organization" in text for text in bridge.status.warnings)
