"""The JSON-RPC methods answer in the shapes and with the refusals that clients expect."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from deploy.chain.errors import InvalidParams, MethodNotFound, RpcError
from tests.support.chain import EmbeddedChain
from tests.support.evm import LOGGER

SINK = "0x" + "11" * 20
Emit = Callable[[int, int], dict[str, Any]]


def topic(value: int) -> str:
    return f"0x{value:064x}"


def test_dev_accounts_are_those_of_anvil(chain: EmbeddedChain) -> None:
    accounts = chain("eth_accounts")
    assert accounts[0] == "0xf39Fd6e51aad88F6F4ce6aB8827279cffFb92266"
    assert len(accounts) == 10
    assert int(chain("eth_getBalance", accounts[9]), 16) == 10**24


def test_an_unknown_method_is_said_to_be_unknown(chain: EmbeddedChain) -> None:
    with pytest.raises(MethodNotFound) as refused:
        chain("eth_makeCoffee")
    assert refused.value.to_rpc()["code"] == -32601


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("eth_getBalance", []),
        ("eth_getBalance", ["0x1234"]),
        ("eth_getBalance", [SINK, "0x01"]),
        ("eth_getBalance", [SINK, "yesterday"]),
        ("eth_getBlockByNumber", [7, False]),
        ("eth_getBlockByHash", ["0x00", False]),
        ("eth_chainId", ["0x1"]),
        ("eth_call", ["0x"]),
        ("eth_call", [{"to": SINK, "data": "0x123"}]),
        ("eth_sendRawTransaction", [{}]),
        ("eth_getLogs", [{"topics": "0x"}]),
        ("eth_getLogs", [{"topics": ["0x01"]}]),
        ("eth_getLogs", [{"fromBlock": "0x5", "toBlock": "0x1"}]),
        ("eth_feeHistory", ["0x0", "latest", []]),
    ],
)
def test_parameters_of_the_wrong_shape_are_refused(
    chain: EmbeddedChain, method: str, params: list[Any]
) -> None:
    with pytest.raises(InvalidParams) as refused:
        chain(method, *params)
    assert refused.value.to_rpc()["code"] == -32602


def test_what_does_not_exist_is_null(chain: EmbeddedChain) -> None:
    assert chain("eth_getBlockByNumber", "0x99", False) is None
    assert chain("eth_getBlockByHash", topic(1), False) is None
    assert chain("eth_getTransactionByHash", topic(1)) is None
    assert chain("eth_getTransactionReceipt", topic(1)) is None


def test_state_of_a_future_block_is_an_error(chain: EmbeddedChain) -> None:
    with pytest.raises(RpcError, match="header not found"):
        chain("eth_getBalance", SINK, "0x99")


def test_state_can_be_asked_by_block_hash(chain: EmbeddedChain) -> None:
    receipt = chain.send(to=SINK, value="0x5")
    chain.send(to=SINK, value="0x5")
    assert chain("eth_getBalance", SINK, {"blockHash": receipt["blockHash"]}) == "0x5"
    assert chain("eth_getBalance", SINK, {"blockNumber": "0x2"}) == "0xa"


def test_the_pending_block_has_the_clocks_time(chain: EmbeddedChain) -> None:
    # TIMESTAMP, PUSH1 0, MSTORE, PUSH1 32, PUSH1 0, RETURN
    teller = chain.create(bytes.fromhex("4260005260206000f3"))
    assert chain.now_s is not None
    chain.now_s += 50
    assert int(chain("eth_call", {"to": teller}, "pending"), 16) == chain.now_s
    assert int(chain("eth_call", {"to": teller}, "latest"), 16) == chain.now_s - 50


def test_creation_gives_the_contracts_address_and_code(chain: EmbeddedChain, logger: str) -> None:
    assert chain("eth_getCode", logger) == "0x" + LOGGER.hex()
    assert chain("eth_getTransactionCount", chain.sender) == "0x1"


def test_a_receipt_agrees_with_its_block_and_transaction(chain: EmbeddedChain, emit: Emit) -> None:
    receipt = emit(1, 2)
    block = chain("eth_getBlockByHash", receipt["blockHash"], True)
    transaction = chain("eth_getTransactionByHash", receipt["transactionHash"])
    assert block["transactions"] == [transaction]
    assert receipt["status"] == "0x1" and receipt["contractAddress"] is None
    assert block["gasUsed"] == receipt["gasUsed"] == receipt["cumulativeGasUsed"]
    assert receipt["effectiveGasPrice"] == transaction["gasPrice"]
    assert chain("eth_getBlockReceipts", receipt["blockNumber"]) == [receipt]
    (log,) = receipt["logs"]
    assert log["topics"] == [topic(1), topic(2)] and log["data"] == topic(7)
    assert log["blockTimestamp"] == block["timestamp"] and log["logIndex"] == "0x0"


@pytest.mark.parametrize(
    ("topics", "expected"),
    [
        (None, [(1, 1), (1, 2), (2, 1)]),
        ([], [(1, 1), (1, 2), (2, 1)]),
        ([topic(1)], [(1, 1), (1, 2)]),
        ([None, topic(1)], [(1, 1), (2, 1)]),
        ([[topic(1), topic(2)], topic(1)], [(1, 1), (2, 1)]),
        ([[], [topic(2)]], [(1, 2)]),
        ([topic(9)], []),
        ([topic(1), topic(1), topic(1)], []),
    ],
)
def test_logs_are_selected_by_topic(
    chain: EmbeddedChain, emit: Emit, topics: Any, expected: list[tuple[int, int]]
) -> None:
    for pair in ((1, 1), (1, 2), (2, 1)):
        emit(*pair)
    found = chain("eth_getLogs", {"fromBlock": "0x0", "topics": topics})
    assert [tuple(int(one, 16) for one in log["topics"]) for log in found] == expected


def test_logs_are_selected_by_address_block_and_hash(chain: EmbeddedChain, emit: Emit, logger: str) -> None:
    first, second = emit(1, 1), emit(1, 2)
    everything = first["logs"] + second["logs"]
    assert chain("eth_getLogs", {"fromBlock": "earliest", "address": logger}) == everything
    assert chain("eth_getLogs", {"fromBlock": "earliest", "address": [SINK, logger]}) == everything
    assert chain("eth_getLogs", {"fromBlock": "earliest", "address": SINK}) == []
    assert chain("eth_getLogs", {"blockHash": first["blockHash"]}) == first["logs"]
    assert chain("eth_getLogs", {"fromBlock": "0x0", "toBlock": first["blockNumber"]}) == first["logs"]
    assert chain("eth_getLogs", {}) == second["logs"]
    assert chain("eth_getLogs", {"fromBlock": "0x99"}) == []


def test_a_log_filter_gives_each_log_once(chain: EmbeddedChain, emit: Emit) -> None:
    emit(1, 1)
    number = chain("eth_newFilter", {"fromBlock": "latest", "topics": [topic(1)]})
    receipt = emit(1, 2)
    emit(2, 2)
    assert chain("eth_getFilterChanges", number) == receipt["logs"]
    assert chain("eth_getFilterChanges", number) == []
    assert chain("eth_uninstallFilter", number) is True
    assert chain("eth_uninstallFilter", number) is False
    with pytest.raises(RpcError, match="filter not found"):
        chain("eth_getFilterChanges", number)


def test_block_and_transaction_filters_tell_what_was_mined(chain: EmbeddedChain) -> None:
    blocks, transactions = chain("eth_newBlockFilter"), chain("eth_newPendingTransactionFilter")
    receipts = [chain.send(to=SINK), chain.send(to=SINK)]
    assert chain("eth_getFilterChanges", blocks) == [receipt["blockHash"] for receipt in receipts]
    assert chain("eth_getFilterChanges", transactions) == [one["transactionHash"] for one in receipts]


def test_fee_history_ends_with_the_next_base_fee(chain: EmbeddedChain) -> None:
    for _ in range(4):
        chain.send(to=SINK)
    history = chain("eth_feeHistory", "0x3", "latest", [10, 90])
    assert history["oldestBlock"] == "0x2"
    assert len(history["baseFeePerGas"]) == 4 and len(history["gasUsedRatio"]) == 3
    assert [len(tips) for tips in history["reward"]] == [2, 2, 2]
    assert history["baseFeePerGas"][-1] == chain("eth_getBlockByNumber", "latest", False)[
        "baseFeePerGas"
    ].replace(history["baseFeePerGas"][-2], history["baseFeePerGas"][-1])
    assert int(history["baseFeePerGas"][-1], 16) < int(history["baseFeePerGas"][0], 16)


def test_an_empty_block_can_be_mined_to_show_the_time(chain: EmbeddedChain) -> None:
    assert chain.now_s is not None
    chain.now_s += 10
    chain("evm_mine")
    block = chain("eth_getBlockByNumber", "latest", False)
    assert block["transactions"] == [] and int(block["timestamp"], 16) == chain.now_s
