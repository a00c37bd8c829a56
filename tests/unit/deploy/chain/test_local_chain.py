"""The embedded chain mines, refuses, remembers and keeps the site's time."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from deploy.chain.errors import (
    ChainStoreCorrupted,
    ChainStoreUnwritable,
    ExecutionFailed,
    ExecutionReverted,
    TransactionRejected,
    WrongGenesis,
)
from tests.support.chain import GENESIS_S, EmbeddedChain
from tests.support.evm import BURNER, THRIFTY, error_string

SINK = "0x" + "11" * 20
DEV_KEY = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"


def signed(chain: EmbeddedChain, key: str = DEV_KEY, **overrides: Any) -> str:
    fields = {
        "type": 2,
        "chainId": 31_337,
        "nonce": 0,
        "to": SINK,
        "value": 1,
        "gas": 21_000,
        "maxFeePerGas": 10**10,
        "maxPriorityFeePerGas": 1,
    }
    return "0x" + Account.sign_transaction({**fields, **overrides}, key).raw_transaction.hex()


def head_time_s(chain: EmbeddedChain) -> int:
    return int(chain("eth_getBlockByNumber", "latest", False)["timestamp"], 16)


def test_a_sent_transaction_is_in_the_next_block(chain: EmbeddedChain) -> None:
    transaction_hash = chain("eth_sendRawTransaction", signed(chain))
    assert chain("eth_blockNumber") == "0x1"
    block = chain("eth_getBlockByNumber", "latest", True)
    assert [transaction["hash"] for transaction in block["transactions"]] == [transaction_hash]
    assert chain("eth_getBalance", SINK) == "0x1"
    assert chain("eth_getBalance", SINK, "0x0") == "0x0"


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"gas": 20_999}, "intrinsic gas too low: gas 20999, minimum needed 21000"),
        ({"gas": 31_000_000}, "exceeds block gas limit"),
        (
            {"maxFeePerGas": 1},
            "max fee per gas less than block base fee: maxFeePerGas: 1, baseFee: 875000000",
        ),
        ({"value": 10**25}, "insufficient funds for gas * price + value: have "),
        ({"chainId": 1}, "invalid sender: invalid chain id for signer: have 1 want 31337"),
    ],
)
def test_a_refused_transaction_says_why_and_changes_nothing(
    chain: EmbeddedChain, overrides: dict[str, Any], message: str
) -> None:
    with pytest.raises(TransactionRejected) as refused:
        chain("eth_sendRawTransaction", signed(chain, **overrides))
    assert refused.value.message.startswith(message)
    assert chain("eth_blockNumber") == "0x0"
    chain("eth_sendRawTransaction", signed(chain))


def test_nonces_that_come_too_early_wait_for_those_before(chain: EmbeddedChain) -> None:
    hashes = {nonce: chain("eth_sendRawTransaction", signed(chain, nonce=nonce)) for nonce in (2, 1)}
    assert chain("eth_blockNumber") == "0x0"
    assert chain("eth_getTransactionReceipt", hashes[1]) is None
    chain("eth_sendRawTransaction", signed(chain, nonce=0))
    assert chain("eth_blockNumber") == "0x3"
    blocks = [chain("eth_getTransactionReceipt", hashes[nonce])["blockNumber"] for nonce in (1, 2)]
    assert blocks == ["0x2", "0x3"]


def test_a_place_in_the_queue_is_taken_by_a_higher_fee_only(chain: EmbeddedChain) -> None:
    first = chain("eth_sendRawTransaction", signed(chain, nonce=1))
    with pytest.raises(TransactionRejected, match="replacement transaction underpriced"):
        chain("eth_sendRawTransaction", signed(chain, nonce=1, value=2))
    second = chain("eth_sendRawTransaction", signed(chain, nonce=1, value=2, maxFeePerGas=2 * 10**10))
    chain("eth_sendRawTransaction", signed(chain, nonce=0))
    assert chain("eth_getTransactionReceipt", first) is None
    assert chain("eth_getTransactionReceipt", second)["blockNumber"] == "0x2"
    for nonce in range(3, 67):
        chain("eth_sendRawTransaction", signed(chain, nonce=nonce))
    with pytest.raises(TransactionRejected, match="account limit exceeded"):
        chain("eth_sendRawTransaction", signed(chain, nonce=67))


def test_a_used_nonce_and_a_known_transaction_are_told_apart(chain: EmbeddedChain) -> None:
    chain("eth_sendRawTransaction", signed(chain))
    with pytest.raises(TransactionRejected, match="already known"):
        chain("eth_sendRawTransaction", signed(chain))
    with pytest.raises(TransactionRejected, match="nonce too low: next nonce 1, tx nonce 0"):
        chain("eth_sendRawTransaction", signed(chain, value=2))


@pytest.mark.parametrize("raw", ["0x", "0x02", "0x02c0", "0xdeadbeef", "0x03c0", "0x" + "ff" * 200])
def test_bytes_that_are_no_transaction_are_refused(chain: EmbeddedChain, raw: str) -> None:
    with pytest.raises(TransactionRejected):
        chain("eth_sendRawTransaction", raw)
    assert chain("eth_blockNumber") == "0x0"


def test_reopening_gives_the_same_blocks_receipts_and_logs(
    chain: EmbeddedChain, emit: Callable[[int, int], dict[str, Any]]
) -> None:
    receipts = [emit(1, number) for number in range(3)]

    def everything() -> list[Any]:
        blocks = [
            chain("eth_getBlockByNumber", hex(number), True)
            for number in range(int(chain("eth_blockNumber"), 16) + 1)
        ]
        found = [chain("eth_getTransactionReceipt", receipt["transactionHash"]) for receipt in receipts]
        return [blocks, found, chain("eth_getLogs", {"fromBlock": "0x0"})]

    before = everything()
    chain.reopen()
    assert everything() == before
    assert emit(1, 9)["blockNumber"] == "0x5"


def test_an_unfinished_block_is_not_there_after_a_crash(chain: EmbeddedChain) -> None:
    chain("eth_sendRawTransaction", signed(chain))
    chain.store[b"half a block"] = b"written, not committed"
    chain.reopen()
    assert b"half a block" not in chain.store
    assert chain("eth_blockNumber") == "0x1"


def test_a_full_disk_keeps_no_part_of_a_block_and_the_chain_goes_on_when_there_is_room(
    chain: EmbeddedChain, emit: Callable[[int, int], dict[str, Any]]
) -> None:
    emit(1, 1)
    before = chain.methods.local_chain.head
    pages = chain.store._connection.execute("pragma max_page_count = 1").fetchone()[0]
    kept = _rows(chain)
    with pytest.raises(ChainStoreUnwritable, match="full"):
        for number in range(200):  # what is free in the file's pages is used up first
            before, kept = chain.methods.local_chain.head, _rows(chain)
            emit(2, number)
    assert chain.store.failure is not None
    assert chain.methods.local_chain.head == before and _rows(chain) == kept
    with pytest.raises(ChainStoreUnwritable):
        chain.store.try_to_write()
    chain.store._connection.execute(f"pragma max_page_count = {pages + 10_000}")
    chain.store.try_to_write()
    assert chain.store.failure is None
    emit(3, 3)
    assert chain.methods.local_chain.head.block_number == before.block_number + 1
    chain.reopen()
    assert chain.methods.local_chain.head.block_number == before.block_number + 1


def _rows(chain: EmbeddedChain) -> int:
    with closing(sqlite3.connect(chain.path)) as reading:
        return int(reading.execute("select count(*) from state").fetchone()[0])


def test_another_chains_file_is_refused(tmp_path: Path, chain: EmbeddedChain) -> None:
    chain.store.close()
    with pytest.raises(WrongGenesis) as refused:
        chain.open(chain_id=1)
    assert refused.value.details["expected"] == "rodeo/1/"
    assert refused.value.details["found"].startswith("rodeo/31337/")


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "chain.sqlite"
    path.write_bytes(b"SQLite format 3\0" + bytes(range(256)) * 40)
    with pytest.raises(ChainStoreCorrupted) as refused:
        EmbeddedChain(path)
    assert refused.value.details["path"] == str(path)


@pytest.mark.parametrize("left", [None, b"\xc0", b"\xff"])
def test_a_file_whose_newest_block_is_lost_is_refused(chain: EmbeddedChain, left: bytes | None) -> None:
    head = bytes.fromhex(chain.send(to=SINK)["blockHash"][2:])
    chain.store.close()
    with sqlite3.connect(chain.path) as connection:
        assert connection.execute("delete from state where key = ?", (head,)).rowcount == 1
        if left is not None:
            connection.execute("insert into state values (?, ?)", (head, left))
    with pytest.raises(ChainStoreCorrupted):
        chain.open()


def test_two_chains_made_in_the_same_second_differ(tmp_path: Path) -> None:
    genesis = {
        EmbeddedChain(tmp_path / name)("eth_getBlockByNumber", "0x0", False)["hash"] for name in ("a", "b")
    }
    assert len(genesis) == 2


def test_block_time_follows_the_clock_and_never_goes_back(chain: EmbeddedChain) -> None:
    chain.now_s = GENESIS_S + 100
    chain.send(to=SINK)
    assert head_time_s(chain) == GENESIS_S + 100
    chain.now_s = GENESIS_S + 40
    chain.send(to=SINK)
    assert head_time_s(chain) == GENESIS_S + 100


def test_a_burst_of_blocks_does_not_run_ahead_of_the_clock(chain: EmbeddedChain) -> None:
    for _ in range(5):
        chain.send(to=SINK)
    assert head_time_s(chain) == GENESIS_S


def test_while_the_clock_is_unknown_time_stands_still(chain: EmbeddedChain) -> None:
    chain.now_s = GENESIS_S + 100
    chain.send(to=SINK)
    chain.now_s = None
    chain.send(to=SINK)
    assert head_time_s(chain) == GENESIS_S + 100


def test_a_revert_keeps_its_data(chain: EmbeddedChain, reverter: str) -> None:
    for method in ("eth_call", "eth_estimateGas"):
        with pytest.raises(ExecutionReverted) as reverted:
            chain(method, {"to": reverter, "data": "0xc0ffee"})
        assert reverted.value.to_rpc() == {"code": 3, "message": "execution reverted", "data": "0xc0ffee"}


def test_a_revert_with_a_sentence_says_it(chain: EmbeddedChain, reverter: str) -> None:
    with pytest.raises(ExecutionReverted, match="execution reverted: no money"):
        chain("eth_call", {"to": reverter, "data": "0x" + error_string("no money").hex()})


def test_running_out_of_gas_is_no_revert(chain: EmbeddedChain) -> None:
    burner = chain.create(BURNER)
    with pytest.raises(ExecutionFailed, match="OutOfGas"):
        chain("eth_call", {"to": burner, "gas": "0x186a0"})


def test_a_reverted_transaction_is_mined_with_status_0(chain: EmbeddedChain, reverter: str) -> None:
    receipt = chain.send(to=reverter, data="0x01", gas="0x186a0")
    assert receipt["status"] == "0x0"


def test_an_estimate_is_enough_and_close(chain: EmbeddedChain, logger: str) -> None:
    data = f"0x{1:064x}{2:064x}{3:064x}"
    estimate = int(chain("eth_estimateGas", {"to": logger, "data": data}), 16)
    receipt = chain.send(to=logger, data=data, gas=hex(estimate))
    assert receipt["status"] == "0x1"
    assert estimate <= int(receipt["gasUsed"], 16) * 1.2


def test_an_estimate_is_enough_for_code_that_asks_for_more_gas_than_it_uses(chain: EmbeddedChain) -> None:
    thrifty = chain.create(THRIFTY)
    estimate = int(chain("eth_estimateGas", {"to": thrifty, "data": "0x01"}), 16)
    assert chain.send(to=thrifty, data="0x01", gas=hex(estimate))["status"] == "0x1"
    assert int(chain.send(to=thrifty, data="0x01", gas=hex(estimate * 9 // 10))["status"], 16) == 0
