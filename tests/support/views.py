"""What tests ask the contracts and no process of a site does."""

from __future__ import annotations

from typing import Any

from web3.types import TxReceipt

from rodeo.chain.client import ChainClient
from rodeo.chain.contracts.logs import Log, decode_logs, event_topics
from rodeo.chain.views import Views


def view(client: ChainClient, contract: str, name: str, *arguments: Any) -> Any:
    """What the contract answers to `name`."""
    return Views(client.w3, client.deployment)(contract, name, *arguments)


def logs_of(client: ChainClient, receipt: TxReceipt) -> list[Log]:
    """The contracts' events in a receipt, in order."""
    addresses, topics = set(client.deployment.event_sources), set(event_topics())
    ours = (
        log
        for log in receipt["logs"]
        if log["address"] in addresses and log["topics"] and log["topics"][0].to_0x_hex() in topics
    )
    return list(decode_logs(ours))
