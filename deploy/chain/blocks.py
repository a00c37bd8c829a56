"""Headers and blocks of the local chain, as requests name them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from eth.abc import BlockAPI, BlockHeaderAPI, StateAPI

from deploy.chain.codec import (
    parse_data,
    parse_quantity,
)
from deploy.chain.errors import InvalidParams, RpcError
from deploy.chain.local_chain import LocalChain
from rodeo.text.strict_json import Json

NEWEST = ("latest", "safe", "finalized")


@dataclass(frozen=True)
class Blocks:
    """Finds what a tag, a number or a hash means."""

    local_chain: LocalChain

    def number(self, tag: Any) -> int:
        """Block number of a tag; "pending" is the one after the head."""
        head = self.local_chain.head.block_number
        if tag is None or tag in NEWEST:
            return head
        if tag == "earliest":
            return 0
        return head + 1 if tag == "pending" else parse_quantity(tag, "block")

    def header(self, tag: Any) -> BlockHeaderAPI:
        """The header for a tag, a number or an EIP-1898 object. Raises RpcError when there is no such
        block."""
        if tag == "pending":
            return self.local_chain.next_header()
        if isinstance(tag, dict) and "blockHash" in tag:
            header = self.local_chain.header_by_hash(parse_data(tag["blockHash"], "blockHash", size=32))
        else:
            header = self.local_chain.header(
                self.number(tag.get("blockNumber") if isinstance(tag, dict) else tag)
            )
        if header is None:
            raise RpcError("header not found")
        return header

    def state(self, tag: Any) -> StateAPI:
        """Accounts and storage after the block. Raises RpcError when there is none."""
        return self.local_chain.state(self.header(tag))

    def block(self, tag: Any) -> BlockAPI | None:
        if tag == "pending":
            return self.local_chain.pending_block()
        header = self.local_chain.header(self.number(tag))
        return header and self.local_chain.block(header)

    def by_hash(self, block_hash: Any) -> BlockAPI | None:
        header = self.local_chain.header_by_hash(parse_data(block_hash, "hash", size=32))
        return header and self.local_chain.block(header)

    def range_of(self, fields: Json) -> tuple[int, int]:
        first, last = self.number(fields.get("fromBlock")), self.number(fields.get("toBlock"))
        if first > last and isinstance(fields.get("toBlock"), str) and fields["toBlock"].startswith("0x"):
            raise InvalidParams("invalid block range params")
        return first, last
