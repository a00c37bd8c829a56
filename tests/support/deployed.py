"""One organization's contracts on a node that lives in the test process."""

from __future__ import annotations

from dataclasses import dataclass

from rodeo.chain.client import ChainClient
from rodeo.chain.deployment import Deployment
from rodeo.site.config import Site
from tests.support.chain import FaultyNode


@dataclass
class DeployedChain:
    """One organization on one node."""

    site: Site
    node: FaultyNode
    deployment: Deployment

    def client(self) -> ChainClient:
        return ChainClient(self.site.chain.url, self.deployment)
