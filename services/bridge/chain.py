"""One deployment on one chain, and what the bridge keeps of it."""

from __future__ import annotations

from dataclasses import dataclass

from rodeo.chain import Deployment
from services.bridge.index import Index
from services.bridge.journal import Journal
from services.bridge.node import Node


@dataclass(frozen=True)
class Chain:
    """Where transactions go, and where what became of them is looked up and written down."""

    deployment: Deployment
    node: Node
    index: Index
    journal: Journal

    def close(self) -> None:
        self.journal.close()
        self.index.close()
        self.node.close()
