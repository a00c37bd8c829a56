"""The bridge beside nodes that misbehave."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from deploy.chain.server import RpcServer
from rodeo import wallets
from rodeo.errors import NoResponder
from tests.support.chain import Answer, EmbeddedChain, FaultyNode
from tests.support.dao import PARAMS, Dao
from tests.support.site import WAIT_S, RunningSite

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
    robot = wallets.address(running.site, "panther1")

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
            killed.wait(WAIT_S)
        return result

    node.fault = answer_nobody
    with ThreadPoolExecutor(max_workers=1) as asker:
        first = asker.submit(dao.post, request_id="the task")
        assert mined.wait(WAIT_S)
        running.kill("bridge")
        killed.set()
        with pytest.raises(NoResponder):
            first.result()
    running.start("bridge")
    request = {"kind": "waste_disposal", "reward_iec": "100", "params": PARAMS, "request_id": "the task"}
    reply = dao.command("organization", "register_task", **request)
    assert reply["tx_hash"] == sent[0]
    assert dao.command("organization", "register_task", **request) == reply
    assert dao.client().task_count() == dao.state("tasks")["total"] == 1


def test_a_chain_that_was_made_anew_is_taken_for_another(running: RunningSite) -> None:
    dao = Dao(running)
    dao.start()
    first = dao.state("chain")
    dao.post(request_id="first")
    dao.stop()
    running.kill("chain")
    shutil.rmtree(running.site.data_dir / "chain")
    running.start("chain", ready=False)
    running.deploy_contracts()
    running.wait_ready("bridge")
    again = dao.state("chain")
    assert again["genesis_hash"] != first["genesis_hash"]
    assert dao.state("tasks")["total"] == 0
    assert dao.post(request_id="first") == 1
