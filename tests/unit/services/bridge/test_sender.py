"""A wallet's transaction is mined once, whatever fails between signing it and knowing that it was."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from deploy.chain.errors import InternalError, TransactionRejected
from rodeo import wallets
from rodeo.chain import ChainClient, ChainUnavailable, ContractReverted, RpcFailed, TransactionTimeout
from services.bridge import sender as sender_module
from services.bridge.errors import BridgeNotReady
from services.bridge.journal import Journal
from services.bridge.sender import Sender
from tests.support.chain import Answer
from tests.support.deployed import DeployedChain
from tests.support.site import free_port

SEND = "eth_sendRawTransaction"


class Robot:
    """panther1's sender, as one process of the bridge after the other has it."""

    def __init__(self, chain: DeployedChain, journal_path: Path) -> None:
        self.chain = chain
        self.account = wallets.load(chain.site, "panther1")
        self.client = chain.client()
        self.oracle = wallets.address(chain.site, "oracle")
        self.journal_path = journal_path
        self.restart()

    def restart(self) -> None:
        """A new process finds the journal as the last one left it."""
        self.stop = threading.Event()
        self.journal = Journal(self.journal_path)
        self.sender = Sender("panther1", self.account, self.client, self.journal, self.stop)

    def pay(self, amount: int = 5, request_id: str | None = None) -> dict[str, Any]:
        return self.sender.send("transfer", self.client.calls.transfer(self.oracle, amount), request_id)

    def paid(self) -> int:
        return self.client.balance(self.oracle)


@pytest.fixture
def robot(chain: DeployedChain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Robot:
    monkeypatch.setattr(sender_module, "_REBROADCAST_S", 0.05)
    return Robot(chain, tmp_path / "journal.sqlite")


def test_a_mined_transaction_is_told_with_its_block(robot: Robot) -> None:
    before = robot.paid()
    reply = robot.pay()
    assert robot.paid() == before + 5
    assert reply["block"] == robot.client.w3.eth.block_number
    assert robot.journal.unfinished("panther1") is None


def test_an_error_after_the_node_took_it_does_not_send_twice(robot: Robot) -> None:
    before = robot.paid()

    def fail_after_the_fact(method: str, params: Sequence[Any], answer: Answer) -> Any:
        result = answer(method, params)
        if method == SEND:
            raise InternalError("broken")
        return result

    robot.chain.node.fault = fail_after_the_fact
    robot.pay()
    assert robot.paid() == before + 5
    assert robot.chain.node.calls.count(SEND) == 1


def test_an_error_instead_of_taking_it_is_told_and_forgotten(robot: Robot) -> None:
    before = robot.paid()

    def refuse(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND:
            raise TransactionRejected("transaction underpriced")
        return answer(method, params)

    robot.chain.node.fault = refuse
    with pytest.raises(RpcFailed) as refused:
        robot.pay(request_id="cheap")
    assert refused.value.details["reason"] == "transaction underpriced"
    assert robot.paid() == before
    robot.chain.node.fault = None
    robot.pay(request_id="cheap")
    assert robot.paid() == before + 5


def test_a_transaction_that_the_node_forgets_is_sent_again(robot: Robot) -> None:
    before = robot.paid()
    sent = 0

    def forget_twice(method: str, params: Sequence[Any], answer: Answer) -> Any:
        nonlocal sent
        if method == SEND:
            sent += 1
            if sent <= 2:
                return "0x" + "00" * 32
        return answer(method, params)

    robot.chain.node.fault = forget_twice
    robot.pay()
    assert (sent, robot.paid()) == (3, before + 5)


def test_a_nonce_that_went_elsewhere_makes_the_transaction_anew(robot: Robot) -> None:
    before = robot.paid()
    elsewhere = robot.sender._sign("transfer", robot.client.calls.transfer(robot.oracle, 100), None, "")
    robot.journal.forget(elsewhere)

    def come_first(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND:
            robot.chain.node.fault = None
            answer(SEND, ["0x" + elsewhere.raw.hex()])
        return answer(method, params)

    robot.chain.node.fault = come_first
    robot.pay(request_id="mine")
    assert robot.paid() == before + 105
    entry = robot.journal.find("panther1", "mine")
    assert entry is not None and entry.state == "mined"


def test_what_was_journaled_but_not_sent_is_sent_after_a_crash(robot: Robot) -> None:
    before = robot.paid()
    robot.sender._sign("transfer", robot.client.calls.transfer(robot.oracle, 5), "r", "")
    robot.restart()
    robot.sender.recover()
    assert robot.paid() == before + 5
    entry = robot.journal.find("panther1", "r")
    assert entry is not None and entry.state == "mined"
    assert robot.sender.finish(entry)["tx_hash"] == entry.tx_hash


def test_what_was_sent_but_not_noted_is_not_sent_twice_after_a_crash(robot: Robot) -> None:
    before = robot.paid()
    entry = robot.sender._sign("transfer", robot.client.calls.transfer(robot.oracle, 5), "r", "")
    robot.client.w3.eth.send_raw_transaction(entry.raw)
    robot.restart()
    robot.sender.recover()
    robot.sender.recover()
    assert robot.paid() == before + 5


def test_what_is_never_mined_is_said_not_to_be_known(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sender_module, "OUTCOME_S", 0.2)
    robot.chain.node.fault = lambda method, params, answer: (
        "0x" + "00" * 32 if method == SEND else answer(method, params)
    )
    with pytest.raises(TransactionTimeout) as late:
        robot.pay(request_id="slow")
    entry = robot.journal.unfinished("panther1")
    assert entry is not None and late.value.details["tx_hash"] == entry.tx_hash
    robot.chain.node.fault = None
    before = robot.paid()
    robot.sender.recover()
    assert robot.paid() == before + 5


def test_a_refusal_before_sending_leaves_nothing_behind(robot: Robot) -> None:
    with pytest.raises(ContractReverted) as refused:
        robot.pay(10**30)
    assert refused.value.code == "erc20_insufficient_balance"
    assert SEND not in robot.chain.node.calls
    assert robot.journal.unfinished("panther1") is None


def test_a_node_that_is_away_before_signing_is_told_at_once(robot: Robot, tmp_path: Path) -> None:
    away = ChainClient(f"http://127.0.0.1:{free_port()}", robot.chain.deployment)
    sender = Sender("panther1", robot.account, away, robot.journal, robot.stop)
    with pytest.raises(ChainUnavailable):
        sender.send("transfer", away.calls.transfer(robot.oracle, 5))
    assert robot.journal.unfinished("panther1") is None


def test_stopping_ends_the_wait_and_keeps_the_transaction(robot: Robot) -> None:
    def stop_at_send(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND:
            robot.stop.set()
            return "0x" + "00" * 32
        return answer(method, params)

    robot.chain.node.fault = stop_at_send
    before = robot.paid()
    with pytest.raises(BridgeNotReady):
        robot.pay()
    robot.chain.node.fault = None
    robot.restart()
    robot.sender.recover()
    assert robot.paid() == before + 5
