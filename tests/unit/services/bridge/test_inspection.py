"""What the index says is compared with what the contracts say."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rodeo_testing.waiting import wait_until
from services.bridge import inspection
from services.bridge.follower import Follower
from services.bridge.index import NOWHERE, Index, Position, sqlite_url
from services.bridge.inspection import Inspector
from services.bridge.node import Node
from tests.support.chain import Answer
from tests.support.deployed import DeployedChain


@pytest.fixture
def index(chain: DeployedChain, tmp_path: Path) -> Iterator[Index]:
    """Of a real chain, up to its head."""
    deployment = chain.deployment
    index = Index(
        sqlite_url(tmp_path / "index.sqlite"),
        deployment.chain_id,
        deployment.genesis_hash,
        deployment.contracts,
    )
    follower = Follower(Node(chain.site.chain.url), deployment, index, 0, lambda _event: True)
    while follower.step([]):
        pass
    yield index
    index.close()


def test_an_index_that_says_what_the_contracts_say_is_left_alone(chain: DeployedChain, index: Index) -> None:
    assert index.said().balances
    inspector = Inspector(index, Node(chain.site.chain.url), chain.deployment)
    assert inspector.compare() is None
    assert [inspector.compare(most=1) for _ in range(5)] == [None] * 5


def test_a_balance_that_the_token_does_not_know_is_found_even_with_a_digest_that_fits(
    chain: DeployedChain, index: Index, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = index.said()
    address = max(said.balances)
    said.balances[address] += 9999
    monkeypatch.setattr(index, "said", lambda: said)
    inspector = Inspector(index, Node(chain.site.chain.url), chain.deployment)
    found = inspector.compare()
    assert found is not None and address in found and str(said.balances[address]) in found
    # Asked for one after the other, its turn comes.
    assert any(inspector.compare(most=1) for _ in said.balances)


def test_one_wrong_answer_of_the_node_does_not_condemn_the_index(chain: DeployedChain, index: Index) -> None:
    wrong = 1

    def err(method: str, params: Sequence[Any], answer: Answer) -> Any:
        nonlocal wrong
        if method == "eth_call" and wrong:
            wrong -= 1
            return "0x" + "ff" * 32
        return answer(method, params)

    chain.node.fault = err
    assert Inspector(index, Node(chain.site.chain.url), chain.deployment).compare() is None and not wrong


@pytest.mark.parametrize("blocks", [-1, 0], ids=["nowhere", "while it is founded"])
def test_before_there_are_contracts_nothing_is_compared(
    chain: DeployedChain, index: Index, monkeypatch: pytest.MonkeyPatch, blocks: int
) -> None:
    block = chain.deployment.block + blocks
    node = Node(chain.site.chain.url)
    (header,) = node.batch([("eth_getBlockByNumber", [hex(block), False])])
    at = Position(block, header["hash"], 0) if blocks >= 0 else NOWHERE
    # Others may have been paid since.
    said = replace(index.said(), position=at, balances={})
    monkeypatch.setattr(index, "said", lambda: said)
    assert Inspector(index, node, chain.deployment).compare() is None


def test_what_is_changed_while_the_bridge_runs_is_found_by_itself(
    chain: DeployedChain, index: Index, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inspection, "PERIOD_S", 0.02)
    inspector = Inspector(index, Node(chain.site.chain.url), chain.deployment)
    compare, compared = inspector.compare, list[object]()
    monkeypatch.setattr(inspector, "compare", lambda *most: compared.append(compare(*most)) or compared[-1])
    inspector.start()
    wait_until(lambda: len(compared) >= 3)
    assert inspector.found is None
    connection = sqlite3.connect(tmp_path / "index.sqlite")
    with connection:
        connection.execute("update balances set balance = '9999'")
    connection.close()
    wait_until(lambda: inspector.found is not None)
    inspector.close()
    index.clear()
    inspector.reset()
    assert (inspector.found, inspector.compare()) == (None, None)
