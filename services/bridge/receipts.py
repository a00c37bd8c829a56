"""The receipt of a mined transaction: what its sender hears of it, and why it failed."""

from __future__ import annotations

import logging
import time
from typing import Any

from rodeo.chain.contracts import events
from rodeo.chain.contracts.logs import UnlikeOurs, decode_event, event_topics
from rodeo.chain.contracts.types import Event
from rodeo.chain.node.errors import (
    ChainError,
    ChainUnavailable,
    ContractReverted,
    InvalidAnswer,
    TransactionFailed,
)
from rodeo.chain.proposals import proposal_key
from rodeo.errors import RodeoError
from services.bridge.chain import Chain
from services.bridge.journal import Entry
from services.bridge.orders import PATIENCE_S, Job, Reply
from services.bridge.projection import hex_of

log = logging.getLogger(__name__)

Receipt = dict[str, Any]
"""As `eth_getTransactionReceipt` answers."""


class Receipts:
    """Reads receipts of the organization's chain."""

    def __init__(self, chain: Chain) -> None:
        self._node, self._index = chain.node, chain.index
        self._contracts = {address.lower() for address in chain.deployment.event_sources}

    def reply(self, receipt: Receipt) -> Reply:
        """What the sender of a successful transaction hears. Raises InvalidAnswer."""
        reply: Reply = {"tx_hash": receipt["transactionHash"], "block": int(receipt["blockNumber"], 16)}
        topics = set(event_topics())
        for one in receipt["logs"]:
            # Of anybody's contract, and anonymous ones have no topics.
            if one["topics"] and one["topics"][0] in topics and one["address"].lower() in self._contracts:
                event = _event(one)
                if isinstance(event, events.TaskRegistered):
                    reply["task_id"] = event.task_id
                elif isinstance(event, events.ServiceRegistered):
                    reply["service_id"] = event.service_id
                elif isinstance(event, events.ProposalCreated):
                    reply["proposal"] = self._index.votes.proposal_number(proposal_key(event.proposal_id))
                elif isinstance(event, events.CallScheduled):
                    reply["proposal"] = self._index.votes.proposal_number(hex_of(event.id))
        return reply

    def failure(self, job: Job, sender: str, receipt: Receipt) -> RodeoError:
        """Why the mined transaction failed: ContractReverted if it still does, else TransactionFailed. Raises
        ChainUnavailable for a while where the node does not tell."""
        entry = job.signed
        message = {"from": sender, "to": entry.to, "data": "0x" + entry.data.hex()}
        try:
            self._node.call("eth_call", message, receipt["blockNumber"])
        except ContractReverted as reverted:
            return reverted
        except ChainUnavailable:
            if time.monotonic() - (job.mined_s or 0.0) < PATIENCE_S:
                raise
        except ChainError as error:
            log.info("%s: the node does not tell why it failed: %s", entry.wallet, error)
        return TransactionFailed(
            "mined without success", tx_hash=entry.tx_hash, gas_used=int(receipt["gasUsed"], 16)
        )


def _event(one: dict[str, Any]) -> Event | None:
    """None for an event of a token that lays it out otherwise. Raises InvalidAnswer."""
    try:
        return decode_event(one)
    except UnlikeOurs:
        return None
    except ValueError as error:
        raise InvalidAnswer("an event cannot be read", problem=str(error), contract=one["address"]) from error


def fee(entry: Entry, receipt: Receipt) -> int:
    """What it cost; at most, where the node does not tell the price of its gas."""
    price = receipt.get("effectiveGasPrice")
    return int(receipt["gasUsed"], 16) * (entry.max_fee or 0 if price is None else int(price, 16))
