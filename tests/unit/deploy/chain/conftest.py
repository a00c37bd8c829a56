"""An embedded chain per test, and contracts on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.chain import EmbeddedChain
from tests.support.evm import LOGGER, REVERTER


@pytest.fixture
def chain(tmp_path: Path) -> Iterator[EmbeddedChain]:
    embedded = EmbeddedChain(tmp_path / "chain.sqlite")
    yield embedded
    embedded.store.close()


@pytest.fixture
def logger(chain: EmbeddedChain) -> str:
    return chain.create(LOGGER)


@pytest.fixture
def reverter(chain: EmbeddedChain) -> str:
    return chain.create(REVERTER)


@pytest.fixture
def emit(chain: EmbeddedChain, logger: str) -> Callable[[int, int], dict[str, Any]]:
    """Emit a log with two topics; returns the receipt."""

    def emit(topic0: int, topic1: int) -> dict[str, Any]:
        return chain.send(to=logger, data=f"0x{topic0:064x}{topic1:064x}{7:064x}")

    return emit
