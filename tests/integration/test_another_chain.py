"""docs/how-to/chains.md: a site on a node that is not its own, on the wall's time, from nothing to a
payment."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from web3 import HTTPProvider, Web3

from rodeo.runtime.sim_clock import SimClock
from rodeo.signing import keystores
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support import command
from tests.support.dao import Dao
from tests.support.foundry import program
from tests.support.site import RunningSite, free_port, write_site

pytestmark = pytest.mark.long

CHAIN_ID = 4242
BEHIND_S = 1.0
"""The clock is the wall's, within this."""
SITE = f"""chain.id = {CHAIN_ID}
clock.speed = 1
clock.idle_speed = 1
agent.explore_when_idle = false
"""
PROCESSES = ("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
NEEDED = r"gas money: (0x[0-9a-fA-F]{40}) (\S+): holds 0; send at least (\S+) more to it"


@pytest.fixture
def node() -> Iterator[str]:
    """URL of somebody's node."""
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    with subprocess.Popen(
        [program("anvil"), "--port", str(port), "--chain-id", str(CHAIN_ID), "--silent"]
    ) as anvil:
        w3 = Web3(HTTPProvider(url))
        wait_until(w3.is_connected)
        yield url
        anvil.terminate()


def rodeo(path: Path, *arguments: str, status: int = 0) -> str:
    """What the command line says in a terminal of 80 columns."""
    env = {**os.environ, "COLUMNS": "80"}
    done = command.rodeo(*arguments, "--site", str(path), env=env, timeout_s=HANG_S)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def clock_behind_s(clock: SimClock) -> float:
    return time.time() - clock.now_s()


def test_from_nothing_to_a_payment_over_a_stall(
    tmp_path: Path, node: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The simulator is stopped for a while during the work: its clock skips the time, the others say
    meanwhile that theirs is behind, and the robot is paid."""
    monkeypatch.setenv(keystores.PASSPHRASE_VARIABLE, "secret")
    path = write_site(tmp_path, "external", SITE)
    path.write_text(re.sub("chain.url = .*", f'chain.url = "{node}"', path.read_text()))
    w3 = Web3(HTTPProvider(node))
    asked = re.findall(NEEDED, rodeo(path, "site", "prepare", status=1))
    assert [name for _, name, _ in asked] == ["organization", "panther1", "oracle"]
    for address, _, amount in asked:
        sent = {"from": w3.eth.accounts[0], "to": address, "value": w3.to_wei(amount, "ether")}
        w3.eth.wait_for_transaction_receipt(w3.eth.send_transaction(sent))
    assert "the site is prepared" in rodeo(path, "site", "prepare")
    with RunningSite(path, wallets=False) as running:
        dao = Dao(running)
        running.start("router", *PROCESSES)
        clock = SimClock(running.bus.session, running.site.bus.domain_id)
        assert clock.wait_ready(threading.Event(), HANG_S)
        wait_until(lambda: abs(clock_behind_s(clock)) < BEHIND_S, "the clock is not the wall's")
        item = next(item for item in running.site.items if item.id == "item1")
        task_id = dao.post(params={"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m})
        wait_until(lambda: "carr" in running.status("robot_agent").activity, "the robot does not hold it")

        simulator = running.children["robot_sim"]
        simulator.send_signal(signal.SIGSTOP)
        for name in ("bridge", "robot_agent", "itrash"):
            running.wait_for_status(name, lambda status: bool(re.match(r"clock \d+ s behind", status.reason)))
        simulator.send_signal(signal.SIGCONT)
        wait_until(lambda: abs(clock_behind_s(clock)) < BEHIND_S, "the clock is not the wall's again")
        running.wait_ready("bridge", "robot_agent", "itrash")

        def settled() -> dict[str, Any] | None:
            task = dao.task(task_id)
            return task if task["state"] in ("settled", "failed", "undecided") else None

        task = wait_until(settled, "the task is not settled")
        assert task["attempt"] == 1 and dao.balances()["panther1"] > 2000, task
