"""Requests to a node."""

from __future__ import annotations

from typing import Any

Call = tuple[str, list[Any]]
"""Method and parameters."""

LOGS = "eth_getLogs"


def blocks_of(call: Call) -> range | None:
    """The blocks whose logs a call asks for, where it names both ends."""
    method, params = call
    if method != LOGS:
        return None
    first, last = (params[0].get(name) for name in ("fromBlock", "toBlock"))
    if not (isinstance(first, str) and isinstance(last, str) and first[:2] == last[:2] == "0x"):
        return None
    return range(int(first, 16), int(last, 16) + 1)


def of_blocks(call: Call, first: int, last: int) -> Call:
    """The same for other blocks."""
    return call[0], [{**call[1][0], "fromBlock": hex(first), "toBlock": hex(last)}]
