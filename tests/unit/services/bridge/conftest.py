"""The contracts on a real chain inside the test process, whose node can be made to fail."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from deploy.chain.server import RpcServer
from rodeo.chain.deployment import Deployment
from rodeo.site.config import Site
from services.bridge import orders, outcomes, receipts, signer
from tests.support.bridge_wallet import Robot
from tests.support.chain import CHAIN_ID, EmbeddedChain, FaultyNode
from tests.support.deployed import DeployedChain
from tests.support.site import write_site
from tests.support.snapshot import found, give_wallets


@pytest.fixture(scope="session")
def deployed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DeployedChain]:
    folder = tmp_path_factory.mktemp("bridge")
    site = Site.load(write_site(folder))
    give_wallets(site)
    found(site, folder / "chain.sqlite")
    node = FaultyNode(EmbeddedChain(folder / "chain.sqlite"))
    with RpcServer(site.chain.url, node):
        yield DeployedChain(site, node, Deployment.load(site.data_dir, CHAIN_ID))


@pytest.fixture
def chain(deployed: DeployedChain) -> Iterator[DeployedChain]:
    """Without the faults of the test before."""
    deployed.node.fault = None
    deployed.node.calls.clear()
    yield deployed
    deployed.node.fault = None


@pytest.fixture
def robot(chain: DeployedChain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    monkeypatch.setattr(outcomes, "REBROADCAST_S", 0.05)
    monkeypatch.setattr(outcomes, "FIRST_LOOK_S", 0.01)
    made = Robot(chain, tmp_path)
    for module in (orders, outcomes, receipts, signer):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: made.wall_s))
    yield made
    made.transactions.close()
