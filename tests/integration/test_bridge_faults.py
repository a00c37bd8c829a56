"""The bridge beside nodes that misbehave."""

from __future__ import annotations

import shutil
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from deploy.chain.errors import ChainLost, RpcError
from deploy.chain.process import run as serve_chain
from deploy.chain.record import give_up_chain
from deploy.chain.server import RpcServer
from deploy.contracts import run as deploy
from rodeo.chain.client import connect
from rodeo.chain.node.errors import WrongChain
from rodeo.errors import NoResponder, RemoteError
from rodeo.signing import keystores
from rodeo_testing.waiting import HANG_S
from services.bridge.node import Node
from tests.support import soak
from tests.support.chain import Answer, EmbeddedChain, FaultyNode
from tests.support.dao import PARAMS, Dao
from tests.support.site import RunningSite, readyz

pytestmark = pytest.mark.long

SEND = "eth_sendRawTransaction"


@pytest.fixture
def node(running: RunningSite, tmp_path: Path) -> Iterator[FaultyNode]:
    """The site's chain, inside the test."""
    faulty = FaultyNode(EmbeddedChain(tmp_path / "chain.sqlite"))
    with RpcServer(running.site.chain.url, faulty):
        yield faulty


def test_a_wallet_that_is_stuck_holds_up_nobody_else(running: RunningSite, node: FaultyNode) -> None:
    dao = Dao(running)
    running.start("router", "bridge", ready=False)
    running.deploy_contracts()
    running.wait_ready("bridge")
    robot = keystores.address(running.site, "panther1")

    def lose_what_the_robot_sends(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND and Account.recover_transaction(params[0]) == robot:
            return "0x" + "00" * 32
        return answer(method, params)

    node.fault = lose_what_the_robot_sends
    # More than the bus has threads that are shared by everything else.
    with ThreadPoolExecutor(max_workers=20) as askers:
        stuck = [
            askers.submit(
                dao.command,
                "panther1",
                "register_service",
                kind="waste_disposal",
                price_iec="100",
                request_id="the service",
            )
            for _ in range(20)
        ]
        task_id = dao.post()
        assert dao.task(task_id)["state"] == "open"
        assert not any(request.done() for request in stuck)
        node.fault = None
        service_ids = {request.result()["service_id"] for request in stuck}
    assert service_ids == {1}
    assert dao.task(task_id)["state"] == "assigned"


def test_a_bridge_is_ready_only_while_node_and_index_tell_of_now(site_path: Path, tmp_path: Path) -> None:
    text = site_path.read_text()
    site_path.write_text(f"bridge.max_behind_s = 0.2\nchain.max_block_age_s = 3600\n{text}")
    running = RunningSite(site_path)
    node = FaultyNode(EmbeddedChain(tmp_path / "chain.sqlite"))
    asker = Node(running.site.chain.url)
    asked, seen, goes_on = 0, threading.Event(), threading.Event()

    def one_block_at_a_time(method: str, params: Sequence[Any], answer: Answer) -> Any:
        nonlocal asked
        if method == "eth_getLogs":
            if params[0]["fromBlock"] != params[0]["toBlock"]:
                raise RpcError("query returned more than 10000 results")
            asked += 1
            # The first take their time, the others until the test has seen what it waits for.
            seen.wait(0.05 if asked < 10 else 5.0)
        return answer(method, params)

    def answer_late(method: str, params: Sequence[Any], answer: Answer) -> Any:
        goes_on.wait(HANG_S)
        return answer(method, params)

    try:
        with RpcServer(running.site.chain.url, node):
            running.start("router", "bridge", ready=False)
            running.deploy_contracts()
            old = running.wait_for_status("bridge", lambda status: "older than 3600 s" in status.reason)
            assert not old.ready and readyz(old.metrics_url)[0] == 503
            node.chain.now_s = int(time.time())
            asker.call("evm_mine")
            running.wait_ready("bridge")

            node.fault = one_block_at_a_time
            asker.batch([("evm_mine", [])] * 20)
            late = running.wait_for_status("bridge", lambda status: "blocks behind" in status.reason)
            assert not late.ready and readyz(late.metrics_url)[0] == 503
            with urllib.request.urlopen(f"{late.metrics_url}/metrics") as metrics:
                assert "rodeo_bridge_blocks_behind 0.0" not in metrics.read().decode()
            seen.set()
            running.wait_ready("bridge")

            node.fault = answer_late
            hung = running.wait_for_status("bridge", lambda status: not status.ready)
            assert readyz(hung.metrics_url)[0] == 503
            goes_on.set()
            running.wait_ready("bridge")
    finally:
        seen.set()
        goes_on.set()
        running.stop()
        asker.close()


def test_a_bridge_that_is_killed_before_the_receipt_gives_the_same_one(
    running: RunningSite, node: FaultyNode
) -> None:
    dao = Dao(running)
    running.start("router", "bridge", ready=False)
    running.deploy_contracts()
    running.wait_ready("bridge")
    mined, killed = threading.Event(), threading.Event()
    sent: list[str] = []

    def answer_nobody(method: str, params: Sequence[Any], answer: Answer) -> Any:
        result = answer(method, params)
        if method == SEND and not mined.is_set():
            sent.append(result)
            mined.set()
            killed.wait(HANG_S)
        return result

    node.fault = answer_nobody
    with ThreadPoolExecutor(max_workers=1) as asker:
        first = asker.submit(dao.post, request_id="the task")
        assert mined.wait(HANG_S)
        running.kill("bridge")
        killed.set()
        with pytest.raises(NoResponder):
            first.result()
    running.start("bridge")
    request = {"kind": "waste_disposal", "reward_iec": "100", "params": PARAMS, "request_id": "the task"}
    reply = dao.command("organization", "register_task", **request)
    assert reply["tx_hash"] == sent[0]
    assert dao.command("organization", "register_task", **request) == reply
    assert dao.client().tasks.count() == dao.state("tasks")["total"] == 1


def test_bridge_node_and_router_killed_at_random_moments_settle_every_task_once(chain_backend: str) -> None:
    """A short run of `make bench ONLY=soak`."""
    found = soak.faults(tasks=5, kills=2, backend=chain_backend, at_once=4)
    assert found.pop("faults_s") > 0
    assert [found.pop(f"faults_kills_{name}") for name in soak.KILLED] == [2, 2, 2]
    assert set(found.values()) == {0}, found


def test_a_bridge_whose_journal_is_gone_says_so_and_posts_nothing_twice(running: RunningSite) -> None:
    dao = Dao(running)
    dao.start()
    dao.post(request_id="once")
    dao.close()
    running.kill("bridge")
    (journal,) = (running.site.data_dir / "bridge").glob("*/journal.sqlite")
    journal.rename(journal.with_name("copy.sqlite"))
    for beside in journal.parent.glob("journal.sqlite-*"):
        beside.rename(beside.with_name(beside.name.replace("journal", "copy")))
    running.start("bridge", ready=False)
    status = running.wait_for_status("bridge", lambda one: "the journal lacks" in one.reason)
    assert "rodeo up --new-journal" in status.reason
    with pytest.raises(RemoteError):
        dao.post(request_id="once")

    running.kill("bridge")
    for kept in journal.parent.glob("copy.sqlite*"):
        kept.rename(kept.with_name(kept.name.replace("copy", "journal")))
    running.start("bridge")
    assert dao.post(request_id="once") == 1
    assert dao.client().tasks.count() == 1


def test_nothing_is_deployed_on_a_chain_that_the_site_file_does_not_name(
    running: RunningSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as stranger:
        stranger.setenv("RODEO__CHAIN__ID", "4242")
        running.start("router", "chain")
    running.start("bridge", ready=False)
    status = running.wait_for_status("bridge", lambda one: "4242" in one.reason)
    assert not status.ready
    assert "is one of chain 4242, and the site's chain is 31337" in status.reason
    assert "deploy.contracts" not in status.reason

    with pytest.raises(WrongChain) as wrong:
        deploy(running.site, threading.Event())
    assert wrong.value.details == {"node_chain_id": 4242, "site_chain_id": 31_337}
    assert connect(running.site.chain.url).eth.block_number == 0


def test_a_chain_that_was_made_anew_is_taken_for_another(running: RunningSite) -> None:
    dao = Dao(running)
    dao.start()
    first = dao.state("chain")
    dao.post(request_id="first")
    dao.close()
    running.kill("chain")
    shutil.rmtree(running.site.data_dir / "chain")
    with pytest.raises(ChainLost, match="--new-chain"):
        serve_chain(running.site, threading.Event())
    assert give_up_chain(running.site) is not None
    running.start("chain", ready=False)
    running.deploy_contracts()
    running.wait_ready("bridge")
    again = dao.state("chain")
    assert again["genesis_hash"] != first["genesis_hash"]
    assert dao.state("tasks")["total"] == 0
    assert dao.post(request_id="first") == 1
