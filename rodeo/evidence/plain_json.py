"""JSON that every parser reads alike (RFC 8259, sections 4, 6 and 8.1; I-JSON, RFC 7493)."""

from __future__ import annotations

import json
from typing import Any


def read_json(data: bytes) -> dict[str, Any]:
    """The object in `data`: UTF-8, no name twice, finite numbers. Raises ValueError or RecursionError."""
    value = _DECODER.decode(data.decode())
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError(f"a key occurs twice among {[name[:50] for name, _ in pairs[:20]]}")
    return value


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")


_DECODER = json.JSONDecoder(object_pairs_hook=_unique, parse_constant=_refuse)
"""One for all: making one costs a third of reading a statement."""
