"""The README's "Another chain": a site on a node that is not its own, on the wall's time, from nothing to a
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

from rodeo import wallets
from rodeo.sim_clock import SimClock
from tests.support import command
from tests.support.dao import Dao
from tests.support.foundry import program
from tests.support.site import RunningSite, free_port, write_site

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

CHAIN_ID = 4242
STAYS_S = 0.5
"""The clock is the wall's, within this."""
HEARD_S = 0.5
"""And later where it is heard, on a machine that does much else."""
STALL_S = 7.0
SITE = f"""chain.id = {CHAIN_ID}
clock.speed = 1
clock.idle_speed = 1
agent.explore_when_idle = false
"""
PROCESSES = ("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")
SETTLED_S = 280.0
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
        deadline_s = time.monotonic() + 30
        while not w3.is_connected():
            assert time.monotonic() < deadline_s
        yield url
        anvil.terminate()


def rodeo(path: Path, *arguments: str, status: int = 0) -> str:
    """What the command line says in a terminal of 80 columns."""
    env = {**os.environ, "COLUMNS": "80"}
    done = command.rodeo(*arguments, "--site", str(path), env=env, timeout_s=240)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def clock_behind_s(clock: SimClock) -> float:
    return time.time() - clock.now_s()


def wait(what: str, holds: Any, for_s: float) -> Any:
    deadline_s = time.monotonic() + for_s
    while not (found := holds()):
        assert time.monotonic() < deadline_s, what
        threading.Event().wait(0.2)
    return found


def test_from_nothing_to_a_payment_over_a_stall(
    tmp_path: Path, node: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The simulator is stopped for a while during the work: its clock skips the time, the others say
    meanwhile that theirs is behind, and the robot is paid."""
    monkeypatch.setenv(wallets.PASSPHRASE_VARIABLE, "secret")
    path = write_site(tmp_path, "external", SITE)
    path.write_text(re.sub("chain.url = .*", f'chain.url = "{node}"', path.read_text()))
    w3 = Web3(HTTPProvider(node))
    asked = re.findall(NEEDED, rodeo(path, "site", "prepare", status=1))
    assert [name for _, name, _ in asked] == ["organization", "panther1", "oracle"]
    for address, _, amount in asked:
        sent = {"from": w3.eth.accounts[0], "to": address, "value": w3.to_wei(amount, "ether")}
        w3.eth.wait_for_transaction_receipt(w3.eth.send_transaction(sent))
    assert "the site is prepared" in rodeo(path, "site", "prepare")
    running = RunningSite(path, wallets=False)
    dao = Dao(running)
    try:
        running.start("router", *PROCESSES)
        clock = SimClock(running.bus.session, running.site.bus.domain_id)
        assert clock.wait_ready(threading.Event(), 10)
        wait("the clock is the wall's", lambda: abs(clock_behind_s(clock)) < STAYS_S + HEARD_S, 10)
        item = next(item for item in running.site.items if item.id == "item1")
        task_id = dao.post(params={"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m})
        wait("the robot holds it", lambda: "carr" in running.status("robot_agent").activity, SETTLED_S)

        simulator = running.children["robot_sim"]
        simulator.send_signal(signal.SIGSTOP)
        threading.Event().wait(STALL_S)
        meanwhile = [running.status(name) for name in ("bridge", "robot_agent", "itrash")]
        simulator.send_signal(signal.SIGCONT)
        assert all(re.match(r"clock \d+ s behind", status.reason) for status in meanwhile), meanwhile
        wait("the clock is the wall's again", lambda: abs(clock_behind_s(clock)) < STAYS_S + HEARD_S, 10)
        running.wait_ready("bridge", "robot_agent", "itrash")

        def settled() -> dict[str, Any] | None:
            task = dao.task(task_id)
            return task if task["state"] in ("settled", "failed", "undecided") else None

        task = wait("the task is settled", settled, SETTLED_S)
        assert task["attempt"] == 1 and dao.balances()["panther1"] > 2000, task
    finally:
        running.stop()
