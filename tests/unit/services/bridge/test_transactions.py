"""A wallet's transaction is mined once, whatever fails between signing it and knowing that it was."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy

from deploy.chain.errors import InternalError, TransactionRejected
from rodeo.chain.node.errors import ChainUnavailable, ContractReverted, RpcFailed, TransactionTimeout
from rodeo.commands.errors import DailyLimitReached
from rodeo.errors import RemoteError
from rodeo.money.currency import ETHER, IEC
from rodeo.site.sections import WalletLimits
from services.bridge import orders, outcomes, signer
from services.bridge.errors import (
    BridgeNotReady,
    FeeTooHigh,
    JournalUnwritable,
    RequestIdReused,
    TransactionDropped,
)
from services.bridge.fees import Limits
from services.bridge.index import NOWHERE
from services.bridge.journal import decoded
from services.bridge.orders import Order
from services.bridge.reading import Page
from tests.support.bridge_wallet import Robot
from tests.support.chain import Answer
from tests.support.site import free_port

SEND = "eth_sendRawTransaction"


def lose(method: str, params: Sequence[Any], answer: Answer) -> Any:
    """The node says that it took what it did not take."""
    return "0x" + "00" * 32 if method == SEND else answer(method, params)


def nothing_instead_of(raw: str, robot: Robot) -> str:
    """A transaction of the same wallet with the same nonce that does nothing: raw, 0x hex."""
    ours = decoded(bytes.fromhex(raw.removeprefix("0x")))
    kept = ("type", "chainId", "nonce", "gas", "maxFeePerGas", "maxPriorityFeePerGas", "value")
    theirs = {name: ours[name] for name in kept} | {"to": robot.account.address, "data": "0x"}
    return robot.account.sign_transaction(theirs).raw_transaction.to_0x_hex()


class Rival:
    """Somebody else with the robot's key. Their transaction comes to the node before each of the first
    `times` of ours that it sees."""

    def __init__(self, robot: Robot, times: int) -> None:
        self._robot = robot
        self._times = times
        self._seen: set[str] = set()

    def __call__(self, method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND and params[0] not in self._seen and len(self._seen) < self._times:
            self._seen.add(params[0])
            answer(method, [nothing_instead_of(params[0], self._robot)])
        return answer(method, params)


def test_a_mined_transaction_is_told_with_its_block_once_it_is_indexed(robot: Robot) -> None:
    before = robot.paid()
    reply = robot.pay()
    assert robot.paid() == before + 5
    assert reply["block"] == robot.client.w3.eth.block_number == robot.index.position.block
    assert robot.waiting() == 0


def test_many_are_in_flight_at_once_and_mined_in_their_order(robot: Robot) -> None:
    before = robot.paid()
    futures = [robot.transactions.orders.submit(robot.order(amount)) for amount in range(1, 21)]
    robot.transactions.send_queued()
    assert robot.chain.node.calls.count(SEND) == 20 and not any(future.done() for future in futures)
    blocks = [robot.outcome(future)["block"] for future in futures]
    assert blocks == sorted(blocks)
    assert robot.paid() == before + sum(range(1, 21))


def test_the_same_request_twice_is_one_transaction(robot: Robot) -> None:
    before = robot.paid()
    first, second = (robot.transactions.orders.submit(robot.order(request_id="once")) for _ in range(2))
    assert robot.outcome(first) == robot.outcome(second) == robot.pay(request_id="once")
    assert robot.paid() == before + 5
    with pytest.raises(RequestIdReused):
        robot.pay(6, request_id="once")


@pytest.mark.long
def test_a_full_disk_keeps_what_waits_and_it_is_sent_once_when_there_is_room(robot: Robot) -> None:
    before, full = robot.paid(), True

    @sqlalchemy.event.listens_for(robot.journal._engine, "begin")
    def grow_no_further(connection: sqlalchemy.Connection) -> None:
        connection.exec_driver_sql(f"pragma max_page_count = {1 if full else 2**30}")

    futures = [robot.transactions.orders.submit(robot.order(amount, f"{amount}")) for amount in range(1, 31)]
    for _ in range(3):
        with pytest.raises(JournalUnwritable, match="full"):
            robot.step()
    assert robot.chain.node.calls.count(SEND) == 0 and not any(future.done() for future in futures)
    assert robot.transactions.orders.waiting("panther1") == 30
    full = False
    again = robot.transactions.orders.submit(robot.order(1, "1"))
    blocks = [robot.outcome(future)["block"] for future in futures]
    assert blocks == sorted(blocks) and robot.outcome(again) == futures[0].result()
    assert robot.paid() == before + sum(range(1, 31))
    assert robot.transactions.failure is None


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


def test_a_fee_that_is_too_low_by_the_time_it_is_sent_is_decided_anew(robot: Robot) -> None:
    before = robot.paid()
    refused: list[str] = []

    def ask_for_more_once(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND and len(refused) < 2:
            refused.append(params[0])
            raise TransactionRejected("max fee per gas less than block base fee")
        return answer(method, params)

    robot.chain.node.fault = ask_for_more_once
    both = [robot.transactions.orders.submit(robot.order(amount, f"{amount}")) for amount in (5, 6)]
    blocks = [robot.outcome(future)["block"] for future in both]
    assert len(refused) == 2 and blocks == sorted(blocks)
    assert robot.paid() == before + 11
    assert robot.waiting() == 0


def test_a_transaction_that_the_node_forgets_is_sent_again(robot: Robot) -> None:
    before = robot.paid()
    sent = 0

    def forget_twice(method: str, params: Sequence[Any], answer: Answer) -> Any:
        nonlocal sent
        sent += method == SEND
        return lose(method, params, answer) if sent <= 2 else answer(method, params)

    robot.chain.node.fault = forget_twice
    robot.pay()
    assert (sent, robot.paid()) == (3, before + 5)


def test_a_nonce_that_went_elsewhere_makes_the_transaction_anew(robot: Robot, tmp_path: Path) -> None:
    before = robot.paid()
    (tmp_path / "other").mkdir()
    elsewhere = Robot(robot.chain, tmp_path / "other")
    other = elsewhere.transactions.orders.submit(elsewhere.order(100))

    def come_first(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND:
            robot.chain.node.fault = lose
            answer(method, [theirs])
        return answer(method, params)

    robot.chain.node.fault = lose
    elsewhere.transactions.step()
    (entry,) = elsewhere.journal.unfinished()
    theirs = "0x" + entry.raw.hex()
    robot.chain.node.fault = come_first
    future = robot.transactions.orders.submit(robot.order(request_id="mine"))
    robot.step()
    robot.chain.node.fault = None
    robot.outcome(future)
    elsewhere.outcome(other)
    assert robot.paid() == before + 105
    done = robot.journal.find("panther1", "mine")
    assert done is not None and done.state == "mined"


@pytest.mark.long
def test_a_transaction_that_loses_its_nonce_again_and_again_is_made_until_it_gets_one(robot: Robot) -> None:
    before = robot.paid()
    robot.chain.node.fault = Rival(robot, times=6)
    future = robot.transactions.orders.submit(robot.order(request_id="mine"))
    robot.outcome(future)
    assert robot.paid() == before + 5
    assert robot.journal.count("dropped") == 6 and robot.waiting() == 0


def test_a_transaction_is_given_up_where_every_nonce_goes_elsewhere(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outcomes, "_NONCES", 4)
    before = robot.paid()
    robot.chain.node.fault = Rival(robot, times=1_000)
    with pytest.raises(TransactionDropped):
        robot.pay(request_id="mine")
    assert robot.journal.count("dropped") == 4 and robot.waiting() == 0
    robot.chain.node.fault = None
    robot.pay(request_id="mine")
    assert robot.paid() == before + 5


@pytest.mark.parametrize("mined", ["ours", "theirs"])
def test_what_another_transaction_takes_the_place_of_is_made_anew_once_that_one_is_mined(
    robot: Robot, mined: str
) -> None:
    """A node took it, and passed it on, before it took the other one: either may be mined."""
    before = robot.paid()
    robot.chain.node.fault = lose
    future = robot.transactions.orders.submit(robot.order(request_id="mine"))
    robot.transactions.step()
    (entry,) = robot.journal.unfinished()

    def keep_the_other(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == SEND:
            raise TransactionRejected("replacement transaction underpriced")
        return answer(method, params)

    robot.chain.node.fault = keep_the_other
    sent = robot.chain.node.calls.count(SEND)
    robot.until(lambda: robot.chain.node.calls.count(SEND) >= sent + 5)
    assert robot.journal.unfinished() == [entry]
    raw = "0x" + entry.raw.hex()
    robot.chain.node.chain(SEND, raw if mined == "ours" else nothing_instead_of(raw, robot))
    robot.chain.node.fault = None
    reply = robot.outcome(future)
    assert (reply["tx_hash"] == entry.tx_hash) == (mined == "ours")
    assert robot.paid() == before + 5


def test_a_node_that_does_not_tell_receipts_for_now_has_nothing_made_anew(robot: Robot) -> None:
    before = robot.paid()

    def be_indexing(method: str, params: Sequence[Any], answer: Answer) -> Any:
        if method == "eth_getTransactionReceipt":
            raise InternalError("transaction indexing is in progress")
        return answer(method, params)

    robot.chain.node.fault = be_indexing
    future = robot.transactions.orders.submit(robot.order(request_id="mine"))
    robot.until(lambda: robot.chain.node.calls.count("eth_getTransactionReceipt") >= 10)
    assert robot.paid() == before + 5 and robot.journal.count("dropped") == 0
    robot.chain.node.fault = None
    robot.outcome(future)
    assert robot.paid() == before + 5 and robot.chain.node.calls.count(SEND) == 1


def test_what_was_journaled_but_not_sent_is_sent_after_a_crash(robot: Robot) -> None:
    before = robot.paid()
    robot.chain.node.fault = lose
    robot.transactions.orders.submit(robot.order(request_id="r"))
    robot.transactions.step()
    robot.chain.node.fault = None
    assert robot.paid() == before and robot.waiting() == 1
    robot.restart()
    robot.until(lambda: robot.waiting() == 0)
    assert robot.paid() == before + 5
    entry = robot.journal.find("panther1", "r")
    assert entry is not None and entry.state == "mined"
    assert robot.pay(request_id="r")["tx_hash"] == entry.tx_hash


def test_what_lost_its_nonce_while_no_bridge_ran_is_made_anew_after_the_start(robot: Robot) -> None:
    before = robot.paid()
    robot.chain.node.fault = lose
    robot.transactions.orders.submit(robot.order(request_id="r"))
    robot.transactions.step()
    (entry,) = robot.journal.unfinished()
    robot.chain.node.fault = None
    robot.chain.node.chain(SEND, nothing_instead_of("0x" + entry.raw.hex(), robot))
    robot.restart()
    robot.until(lambda: robot.waiting() == 0)
    assert robot.paid() == before + 5
    done = robot.journal.find("panther1", "r")
    assert done is not None and (done.state, done.nonce) == ("mined", entry.nonce + 1)


def test_what_was_sent_but_not_noted_is_not_sent_twice_after_a_crash(robot: Robot) -> None:
    before = robot.paid()
    robot.transactions.orders.submit(robot.order(request_id="r"))
    robot.transactions.send_queued()
    assert robot.waiting() == 1
    robot.restart()
    robot.until(lambda: robot.waiting() == 0)
    robot.restart()
    robot.step()
    assert robot.paid() == before + 5


def test_an_index_of_another_version_is_rebuilt_beside_a_journal_that_is_migrated(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    reply = robot.pay(request_id="once")
    robot.until(lambda: robot.index.position.block == reply["block"])
    before, paid = answers(robot), robot.paid()
    robot.index.close()
    robot.journal.close()
    edit(robot.folder / "index.sqlite", "update cursor set version = '6-before'", "drop table balances")
    # As before its versions were numbered.
    edit(
        robot.folder / "journal.sqlite",
        "drop table accounted",
        "pragma user_version = 0",
    )
    robot.restart()
    assert "has schema version 6-before" in caplog.text
    assert robot.index.position == NOWHERE
    assert robot.journal.accounted() == {}
    robot.until(lambda: robot.index.position.block == reply["block"])
    assert answers(robot) == before
    assert robot.pay(request_id="once") == reply and robot.paid() == paid


def answers(robot: Robot) -> list[Any]:
    return [
        robot.index.events_after(0, 1_000),
        robot.index.money.balances(),
        robot.index.rules.devices(),
        robot.index.money.transfers(robot.account.address, None, 0, 2**48, Page(1_000)),
    ]


def edit(database: Path, *statements: str) -> None:
    with closing(sqlite3.connect(database)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def test_what_is_never_mined_is_said_not_to_be_known(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orders, "OUTCOME_S", 0.2)
    robot.chain.node.fault = lose
    with pytest.raises(TransactionTimeout) as late:
        robot.pay(request_id="slow")
    (entry,) = robot.journal.unfinished()
    assert late.value.details["tx_hash"] == entry.tx_hash
    robot.chain.node.fault = None
    before = robot.paid()
    robot.until(lambda: robot.waiting() == 0)
    assert robot.paid() == before + 5


def test_a_stuck_transaction_is_sent_again_with_a_higher_fee(robot: Robot) -> None:
    before = robot.paid()
    robot.restart(stuck_s=0.1)
    robot.chain.node.fault = lose
    future = robot.transactions.orders.submit(robot.order(request_id="stuck"))
    robot.until(lambda: robot.journal.unfinished() and len(robot.journal.unfinished()[0].replaced) >= 2)
    (entry,) = robot.journal.unfinished()
    assert entry.max_fee is not None and entry.nonce == robot.journal.unfinished()[0].nonce
    first_fee = robot.transactions.signer.cost(robot.order())["max_fee_per_gas_wei"]
    assert entry.max_fee >= int(first_fee) * 81 // 64
    robot.chain.node.fault = None
    assert robot.outcome(future)["tx_hash"] in robot.journal.find("panther1", "stuck").hashes  # type: ignore[union-attr]
    assert robot.paid() == before + 5


def test_each_line_about_a_transaction_names_its_task(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    for module in (outcomes, signer):
        caplog.set_level("INFO", module.__name__)
    robot.restart(stuck_s=0.1)
    robot.chain.node.fault = lose
    future = robot.transactions.orders.submit(replace(robot.order(), task_id=7))
    robot.until(lambda: robot.journal.unfinished() and robot.journal.unfinished()[0].replaced)
    robot.chain.node.fault = None
    reply = robot.outcome(future)
    robot.transactions.outcomes.undone(reply["block"] - 1)
    robot.transactions.outcomes.reopen_undone()
    robot.until(lambda: robot.waiting() == 0)
    lines = {record.getMessage().partition(";")[0]: record for record in caplog.records}
    assert {"panther1: transfer is stuck", "panther1: transfer was undone"} <= set(lines)
    assert all(vars(record)["task"] == 7 for record in lines.values()), lines


def test_the_first_of_two_prices_may_be_the_one_that_is_mined(robot: Robot) -> None:
    before = robot.paid()
    robot.restart(stuck_s=0.1)
    robot.chain.node.fault = lose
    future = robot.transactions.orders.submit(robot.order())
    robot.transactions.step()
    (first,) = robot.journal.unfinished()
    robot.until(lambda: robot.journal.unfinished()[0].replaced)
    robot.chain.node.chain("eth_sendRawTransaction", "0x" + first.raw.hex())
    robot.chain.node.fault = None
    assert robot.outcome(future)["tx_hash"] == first.tx_hash
    assert robot.paid() == before + 5


def test_a_refusal_before_sending_leaves_nothing_behind(robot: Robot) -> None:
    with pytest.raises(ContractReverted) as refused:
        robot.pay(10**30)
    assert refused.value.code == "erc20_insufficient_balance"
    assert SEND not in robot.chain.node.calls
    assert robot.waiting() == 0


def test_what_is_mined_as_a_failure_says_which_contract_error_it_was(robot: Robot) -> None:
    """Each of two passes alone, together they are more than there is."""
    most = robot.client.token.balance(robot.account.address) * 2 // 3
    submit = robot.transactions.orders.submit
    first, second = (submit(robot.order(most, request)) for request in ("first", "second"))
    robot.outcome(first)
    with pytest.raises(ContractReverted) as refused:
        robot.outcome(second)
    assert refused.value.code == "erc20_insufficient_balance"
    assert refused.value.details["needed_iec"] == f"{IEC.from_units(most):f}"
    with pytest.raises(RemoteError) as again:
        robot.pay(most, "second")
    assert again.value.code == "erc20_insufficient_balance"


def test_a_node_that_is_away_before_signing_is_told_at_once(robot: Robot) -> None:
    robot.url = f"http://127.0.0.1:{free_port()}"
    robot.restart()
    future = robot.transactions.orders.submit(robot.order())
    robot.transactions.step()
    with pytest.raises(ChainUnavailable):
        future.result(timeout=0)
    assert robot.waiting() == 0


def test_stopping_ends_the_wait_and_keeps_the_transaction(robot: Robot) -> None:
    before = robot.paid()
    robot.chain.node.fault = lose
    future = robot.transactions.orders.submit(robot.order())
    robot.transactions.step()
    robot.transactions.close()
    with pytest.raises(BridgeNotReady):
        future.result(timeout=0)
    robot.chain.node.fault = None
    robot.restart()
    robot.until(lambda: robot.waiting() == 0)
    assert robot.paid() == before + 5


def test_a_fee_above_the_wallets_limit_is_not_paid(robot: Robot) -> None:
    robot.limits = Limits(WalletLimits(max_fee_per_gas_gwei=Decimal("0.000000001")), IEC)
    robot.restart()
    with pytest.raises(FeeTooHigh) as refused:
        robot.pay()
    assert refused.value.details["limit_wei_per_gas"] == "1"
    robot.limits = Limits(WalletLimits(max_fee_eth=Decimal("0.000000001")), IEC)
    robot.restart()
    with pytest.raises(FeeTooHigh):
        robot.pay()
    assert SEND not in robot.chain.node.calls


def test_a_wallet_spends_no_more_than_it_may_in_a_day_of_block_time(robot: Robot) -> None:
    robot.limits = Limits(WalletLimits(daily_iec=Decimal("0.000000000000000012")), IEC)
    robot.restart()
    robot.step()
    robot.pay(5)
    # The third would be too much, and in the same batch.
    both = [robot.transactions.orders.submit(robot.order(5)) for _ in range(2)]
    robot.outcome(both[0])
    with pytest.raises(DailyLimitReached) as refused:
        robot.outcome(both[1])
    assert refused.value.details == {
        "what": "IEC",
        "limit_iec": "0.000000000000000012",
        "spent_iec": "0.00000000000000001",
        "more_iec": "0.000000000000000005",
    }
    robot.restart()
    with pytest.raises(DailyLimitReached):
        robot.pay(5)
    chain = robot.chain.node.chain
    chain.now_s = (chain.now_s or 0) + 24 * 3600 + 1
    chain("evm_mine")
    robot.step()
    robot.pay(5)


def test_a_transaction_that_is_made_anew_counts_once(robot: Robot) -> None:
    robot.limits = Limits(WalletLimits(daily_iec=Decimal("0.000000000000000005")), IEC)
    robot.restart()
    robot.step()
    robot.chain.node.fault = Rival(robot, times=2)
    robot.pay(5)
    robot.chain.node.fault = None
    with pytest.raises(DailyLimitReached):
        robot.pay(1)


def test_a_higher_fee_for_a_stuck_transaction_is_within_the_days_limit(robot: Robot) -> None:
    cost = robot.transactions.signer.cost(robot.order())
    first = int(cost["max_fee_wei"])
    robot.limits = Limits(WalletLimits(daily_fee_eth=ETHER.from_units(first * 3 // 2)), IEC)
    robot.restart(stuck_s=0.1)
    robot.chain.node.fault = lose
    robot.transactions.orders.submit(robot.order(request_id="stuck"))
    robot.until(lambda: robot.journal.unfinished() and robot.journal.unfinished()[0].replaced)
    for _ in range(200):
        robot.step()
        robot.wall_s += 0.01
    (entry,) = robot.journal.unfinished()
    assert entry.max_fee is not None
    assert int(decoded(entry.raw)["gas"]) * entry.max_fee <= first * 3 // 2


def test_what_a_reorganization_takes_back_is_sent_again(robot: Robot) -> None:
    before = robot.paid()
    reply = robot.pay(request_id="r")
    entry = robot.journal.find("panther1", "r")
    assert entry is not None
    robot.transactions.outcomes.undone(reply["block"] - 1)
    robot.transactions.outcomes.reopen_undone()
    assert robot.waiting() == 1
    robot.until(lambda: robot.waiting() == 0)
    assert robot.paid() == before + 5
    assert robot.pay(request_id="r")["tx_hash"] == entry.tx_hash


OURS, OTHER = "0x" + "01" * 32, "0x" + "02" * 32


def proof(robot: Robot) -> Order:
    """What is for the first attempt at task 1, as it was assigned."""
    return replace(robot.order(request_id="proof"), task_id=1, attempt=1, assignment=OURS)


def undo(robot: Robot, reply: dict[str, Any]) -> None:
    """A reorganization takes off the chain what is said to be in this block."""
    robot.transactions.outcomes.undone(reply["block"] - 1)
    robot.transactions.outcomes.reopen_undone()


def test_a_proof_that_was_undone_is_sent_again_where_its_task_is_assigned_as_it_was(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    assigned: dict[str, Any] = {"nonce": OURS, "attempt": 1}
    monkeypatch.setattr(robot.index.tasks, "get", lambda _id: assigned)
    reply = robot.outcome(robot.transactions.orders.submit(proof(robot)))
    undo(robot, reply)
    sent = robot.chain.node.calls.count(SEND)
    assigned["nonce"] = None
    robot.transactions.step()
    assert robot.chain.node.calls.count(SEND) == sent
    assigned |= {"nonce": OURS, "attempt": 1}
    robot.until(lambda: robot.waiting() == 0)
    assert robot.outcome(robot.transactions.orders.submit(proof(robot))) == reply


def test_a_proof_that_was_undone_is_taken_back_where_its_task_is_assigned_anew(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = int(robot.transactions.signer.cost(robot.order())["max_fee_per_gas_wei"])
    robot.limits = Limits(WalletLimits(max_fee_per_gas_gwei=Decimal(limit) / 10**9), IEC)
    robot.restart()
    monkeypatch.setattr(robot.index.tasks, "get", lambda _id: {"nonce": OTHER, "attempt": 1})
    reply = robot.outcome(robot.transactions.orders.submit(proof(robot)))
    undo(robot, reply)
    nonce = robot.journal.find("panther1", "proof").nonce  # type: ignore[union-attr]
    robot.transactions.outcomes.look_at_held()
    (instead,) = robot.journal.unfinished()
    assert (instead.command, instead.data, instead.to) == ("nothing", b"", robot.account.address)
    assert instead.nonce == nonce == decoded(instead.raw)["nonce"]
    assert decoded(instead.raw)["maxFeePerGas"] == instead.max_fee <= limit
    # What the wallet sends later does not wait for a nonce that nobody uses.
    robot.until(lambda: robot.waiting() == 0)
    assert robot.pay(7)["tx_hash"]
    assert robot.journal.find("panther1", "proof") is None


def begun_anew(method: str, params: Sequence[Any], answer: Answer) -> Any:
    """Behind the same URL there is another chain, with the same number."""
    found = answer(method, params)
    if method == "eth_getBlockByNumber" and params[0] == "0x0":
        return {**found, "hash": "0x" + "77" * 32}
    return found


def test_what_was_sent_on_a_chain_is_not_sent_on_the_one_that_takes_its_place(robot: Robot) -> None:
    """It would be mined there, and the journal of that chain would lack it."""
    before = robot.paid()
    robot.chain.node.fault = lose
    robot.transactions.orders.submit(robot.order(request_id="r"))
    robot.transactions.step()
    robot.chain.node.fault = begun_anew
    sent = robot.chain.node.calls.count(SEND)
    for _ in range(3):
        robot.wall_s += 2 * outcomes.REBROADCAST_S
        with pytest.raises(ChainUnavailable) as refused:
            robot.transactions.step()
        assert refused.value.details["expected"] == robot.chain.deployment.genesis_hash
    assert robot.chain.node.calls.count(SEND) == sent and robot.paid() == before
    robot.chain.node.fault = None
    robot.until(lambda: robot.waiting() == 0)
    assert robot.paid() == before + 5


def test_nothing_is_signed_for_a_chain_that_takes_the_place_of_ours(robot: Robot) -> None:
    robot.chain.node.fault = begun_anew
    future = robot.transactions.orders.submit(robot.order(request_id="r"))
    robot.transactions.step()
    with pytest.raises(ChainUnavailable, match="another chain"):
        future.result(0)
    assert robot.waiting() == 0 and SEND not in robot.chain.node.calls[-5:]


def test_what_a_reorganization_undid_is_not_sent_on_the_chain_that_takes_the_place_of_ours(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot.index.tasks, "get", lambda _id: {"nonce": OURS, "attempt": 1})
    undo(robot, robot.outcome(robot.transactions.orders.submit(proof(robot))))
    robot.chain.node.fault = begun_anew
    sent = robot.chain.node.calls.count(SEND)
    with pytest.raises(ChainUnavailable, match="another chain"):
        robot.transactions.step()
    assert robot.chain.node.calls.count(SEND) == sent
    robot.chain.node.fault = None
    robot.until(lambda: robot.waiting() == 0)


def test_what_was_signed_elsewhere_for_a_nonce_that_is_gone_is_told_to_be_dropped(robot: Robot) -> None:
    """A wallet that lives elsewhere cannot be signed for anew."""
    account = robot.account
    robot.transactions.orders.add("elsewhere", account.address, None, robot.limits)
    order = Order("elsewhere", "broadcast", robot.order().call, "theirs", "")
    unsigned = robot.transactions.signer.unsigned(Order("panther1", "transfer", order.call))
    raw = bytes(account.sign_transaction(unsigned).raw_transaction)
    robot.pay(6)  # takes the nonce
    with pytest.raises(TransactionDropped):
        robot.outcome(robot.transactions.orders.broadcast(order, raw))


def test_who_waits_is_not_given_up_while_its_wallet_gets_on(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orders, "MAX_IN_FLIGHT", 1)
    first, second = (robot.transactions.orders.submit(robot.order(amount)) for amount in (1, 2))
    robot.transactions.step()
    robot.wall_s += 0.9 * orders.OUTCOME_S
    robot.outcome(first)
    robot.chain.node.fault = lose
    robot.transactions.step()
    robot.wall_s += 0.9 * orders.OUTCOME_S
    robot.transactions.step()
    assert not second.done(), "it was sent a while ago only"
    robot.wall_s += 0.2 * orders.OUTCOME_S
    robot.transactions.step()
    assert isinstance(second.exception(), TransactionTimeout)
