"""What the index says is compared with what the contracts say."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.bridge.contradiction import contradiction
from services.bridge.follower import Follower
from services.bridge.index import NOWHERE, Index, Position, sqlite_url
from services.bridge.node import Node
from tests.support.chain import Answer
from tests.support.deployed import DeployedChain


@pytest.fixture
def index(chain: DeployedChain, tmp_path: Path) -> Iterator[Index]:
    """The index of a real chain, up to its head."""
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
    assert contradiction(index, Node(chain.site.chain.url), chain.deployment) is None


def change(folder: Path, statement: str) -> None:
    """Change the file by hand, as no bridge does."""
    connection = sqlite3.connect(folder / "index.sqlite")
    with connection:
        assert connection.execute(statement).rowcount
    connection.close()


def test_a_balance_that_was_changed_in_the_file_is_found(
    chain: DeployedChain, index: Index, tmp_path: Path
) -> None:
    address = max(index.said().balances)
    change(tmp_path, f"update balances set balance = '9999' where address = '{address}'")
    found = contradiction(index, Node(chain.site.chain.url), chain.deployment)
    assert found is not None and address in found and "9999 in the index" in found
    index.clear()
    assert contradiction(index, Node(chain.site.chain.url), chain.deployment) is None


def test_a_balance_that_is_no_number_is_found(chain: DeployedChain, index: Index, tmp_path: Path) -> None:
    change(tmp_path, "update balances set balance = 'much'")
    found = contradiction(index, Node(chain.site.chain.url), chain.deployment)
    assert found is not None and "cannot be read" in found


def test_one_wrong_answer_of_the_node_does_not_condemn_the_index(chain: DeployedChain, index: Index) -> None:
    wrong = 1

    def err(method: str, params: Sequence[Any], answer: Answer) -> Any:
        nonlocal wrong
        if method == "eth_call" and wrong:
            wrong -= 1
            return "0x" + "ff" * 32
        return answer(method, params)

    chain.node.fault = err
    assert contradiction(index, Node(chain.site.chain.url), chain.deployment) is None and not wrong


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
    assert contradiction(index, node, chain.deployment) is None
