"""The chain process as a client that is not ours sees it: `cast`, and raw JSON-RPC over HTTP."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import httpx
import pytest

from rodeo.chain import artifacts
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.clock import publish_clock
from tests.support.evm import error_string
from tests.support.foundry import Cast
from tests.support.site import RunningSite

pytestmark = pytest.mark.long

DEV_KEY = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"
DEV = "0xf39Fd6e51aad88F6F4ce6aB8827279cffFb92266"
OTHER = "0x70997970C51812dc3A010C7d01b50e0d17dc79C8"


def wait_until_up(url: str) -> None:
    def answers() -> bool:
        with suppress(httpx.TransportError):
            return bool(rpc(url, "eth_chainId"))
        return False

    wait_until(answers, "the chain does not answer")


def rpc(url: str, method: str, *params: Any) -> Any:
    asked = {"jsonrpc": "2.0", "id": 1, "method": method, "params": list(params)}
    reply = httpx.post(url, json=asked, timeout=HANG_S)
    return reply.json()["result"]


@pytest.fixture
def url(running: RunningSite) -> str:
    """A chain that runs alone: no router, no clock, no body."""
    running.start("chain", ready=False)
    wait_until_up(running.site.chain.url)
    return running.site.chain.url


@pytest.fixture
def cast(url: str) -> Cast:
    return Cast(url)


@pytest.fixture
def coin(cast: Cast) -> str:
    """An IECoin of which the first dev account has 1000."""
    constructor = cast("abi-encode", "f(address[],uint256[])", f"[{DEV}]", "[1000]").removeprefix("0x")
    code = "0x" + artifacts.load("IECoin").bytecode.hex() + constructor
    receipt = cast.json("send", "--private-key", DEV_KEY, "--create", code)
    assert receipt["status"] == "0x1"
    return str(receipt["contractAddress"])


def test_cast_asks_for_the_chain_its_blocks_and_its_fees(cast: Cast) -> None:
    assert cast("chain-id") == "31337"
    assert cast("block-number") == "0"
    genesis = cast.json("block", "0")
    assert cast("block", genesis["hash"], "-f", "number") == "0"
    assert int(cast("base-fee")) > 0 and int(cast("gas-price")) > 0
    assert cast("balance", DEV) != "0"


@pytest.mark.parametrize("kind", [[], ["--legacy"], ["--access-list", "[]"]])
def test_cast_sends_every_type_of_transaction(cast: Cast, kind: list[str]) -> None:
    receipt = cast.json("send", "--private-key", DEV_KEY, *kind, OTHER, "--value", "1ether")
    assert (receipt["status"], int(receipt["gasUsed"], 16)) == ("0x1", 21_000)
    again = cast.json("receipt", receipt["transactionHash"])
    assert {name: again[name] for name in receipt} == receipt
    transaction = cast.json("tx", receipt["transactionHash"])
    assert transaction["blockHash"] == receipt["blockHash"]
    assert cast("nonce", DEV) == "1"


def test_cast_calls_estimates_and_reads_logs_of_a_contract(cast: Cast, coin: str) -> None:
    assert cast("call", coin, "symbol()(string)") == '"IEC"'
    estimate = int(cast("estimate", "--from", DEV, coin, "transfer(address,uint256)", OTHER, "7"))
    receipt = cast.json("send", "--private-key", DEV_KEY, coin, "transfer(address,uint256)", OTHER, "7")
    assert int(receipt["gasUsed"], 16) <= estimate <= 2 * int(receipt["gasUsed"], 16)
    assert cast("call", coin, "balanceOf(address)(uint256)", OTHER) == "7"
    (log,) = cast.json(
        "logs",
        "--from-block",
        "0",
        "--address",
        coin,
        "Transfer(address indexed,address indexed,uint256)",
        DEV,
    )
    assert log["transactionHash"] == receipt["transactionHash"]
    assert int(log["data"], 16) == 7
    assert cast("code", coin) == rpc(cast.url, "eth_getCode", coin, "latest")


def test_cast_decodes_a_revert(cast: Cast, coin: str) -> None:
    refused = cast.run("call", "--from", OTHER, coin, "transfer(address,uint256)", DEV, "7")
    assert refused.returncode != 0
    data = cast("calldata", "ERC20InsufficientBalance(address,uint256,uint256)", OTHER, "0", "7")
    assert data in refused.stderr
    refused = cast.run("estimate", "--from", OTHER, coin, "transfer(address,uint256)", DEV, "7")
    assert refused.returncode != 0 and data[:10] in refused.stderr


def test_a_revert_with_a_sentence_arrives_as_that_sentence(cast: Cast) -> None:
    # Init code that copies what follows it to memory and reverts with it.
    data = error_string("no money today")
    code = bytes([0x60, len(data), 0x80, 0x60, 11, 0x60, 0, 0x39, 0x60, 0, 0xFD]) + data
    refused = cast.run("send", "--private-key", DEV_KEY, "--create", "0x" + code.hex())
    assert refused.returncode != 0 and "no money today" in refused.stderr


def test_a_batch_over_http_is_answered_in_order(url: str, coin: str) -> None:
    balance_of = {"to": coin, "data": "0x70a08231" + DEV[2:].lower().rjust(64, "0")}
    batch = [
        {"jsonrpc": "2.0", "id": 1, "method": "eth_chainId", "params": []},
        {
            "jsonrpc": "2.0",
            "id": 2,
            "method": "eth_call",
            "params": [balance_of, "latest"],
        },
        {"jsonrpc": "2.0", "id": 3, "method": "eth_noSuchThing", "params": []},
    ]
    chain_id, balance, unknown = httpx.post(url, json=batch, timeout=HANG_S).json()
    assert chain_id == {"jsonrpc": "2.0", "id": 1, "result": "0x7a69"}
    assert int(balance["result"], 16) == 1_000
    assert (unknown["id"], unknown["error"]["code"]) == (3, -32601)


def test_after_sigkill_the_chain_is_the_same(running: RunningSite, cast: Cast, coin: str) -> None:
    for _ in range(3):
        cast("send", "--private-key", DEV_KEY, coin, "transfer(address,uint256)", OTHER, "1")
    before = [cast.json("block", str(number)) for number in range(5)]
    logs = cast.json("logs", "--from-block", "0", "--address", coin)
    running.kill("chain")
    running.start("chain", ready=False)
    wait_until_up(running.site.chain.url)
    assert [cast.json("block", str(number)) for number in range(5)] == before
    assert cast.json("logs", "--from-block", "0", "--address", coin) == logs
    cast("send", "--private-key", DEV_KEY, coin, "transfer(address,uint256)", OTHER, "1")
    assert cast("call", coin, "balanceOf(address)(uint256)", OTHER) == "4"


def test_block_time_follows_the_sites_clock_from_when_it_is_heard(running: RunningSite, cast: Cast) -> None:
    genesis_s = int(cast("block", "0", "-f", "timestamp").split()[0])
    running.start("router")
    running.wait_ready("chain")
    later_s = genesis_s + 5_000

    def block_s() -> int:
        # A clock is a stream: its hearer may come between two ticks.
        publish_clock(running.bus, running.site.bus.domain_id, later_s)
        receipt = cast.json("send", "--private-key", DEV_KEY, OTHER, "--value", "1")
        return int(cast.json("block", str(int(receipt["blockNumber"], 16)))["timestamp"], 16)

    wait_until(lambda: block_s() >= later_s, "no block has the clock's time")
