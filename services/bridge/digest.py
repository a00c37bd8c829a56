"""A digest of all rows of the index, which changes with each row that changes: the sum of the rows' digests.

It is kept beside the rows as they are written and computed again from what is in the file. It finds what was
changed there by somebody else, by hand or by the disk; who also computes the digest anew is not found by it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from hashlib import blake2b
from typing import Any

from sqlalchemy import JSON, Boolean, Connection, Float, Integer, Select, String, Table, Text, cast, select
from sqlalchemy.sql.expression import type_coerce

from services.bridge import schema

_BYTES = 16
MODULUS = 1 << 8 * _BYTES

COVERED = tuple(
    table
    for table in schema.metadata.sorted_tables
    if table not in (schema.cursor, schema.blocks, schema.undo, schema.receipts)
)
"""Tables of what is answered. The cursor holds the digest, and receipts are asked of the node."""


def row_digest(table: Table, row: Mapping[str, Any]) -> int:
    """Of a row as it is handed to the database."""
    return _digest(table.name, (convert(row[name]) for name, convert in _converters(table)))


def rows_digest(connection: Connection) -> int:
    """Of everything in the database, as it is there."""
    total = 0
    for table in COVERED:
        for row in connection.execute(_stored(table)):
            total += _digest(table.name, row)
    return total % MODULUS


def position_digest(block: int, block_hash: str, block_time_s: int) -> int:
    """Of how far the index follows the chain."""
    return _digest(schema.cursor.name, (block, block_hash, block_time_s))


def _digest(name: str, values: Iterable[Any]) -> int:
    text = repr((name, *values)).encode("utf-8", "surrogatepass")
    return int.from_bytes(blake2b(text, digest_size=_BYTES).digest())


@cache
def _converters(table: Table) -> tuple[tuple[str, Callable[[Any], Any]], ...]:
    """How a value of each column looks when it is read back by `_stored`."""
    return tuple((column.name, _converter(column.type)) for column in table.columns)


def _converter(kind: Any) -> Callable[[Any], Any]:
    if isinstance(kind, JSON):
        return json.dumps
    if isinstance(kind, schema.Written):
        return schema.writable
    for database_type, python_type in ((Boolean, bool), (Integer, int), (Float, float)):
        if isinstance(kind, database_type):
            return lambda value: None if value is None else python_type(value)
    return lambda value: None if value is None else str(value)


@cache
def _stored(table: Table) -> Select[Any]:
    """All rows, with JSON and amounts as the text that they are stored as."""
    columns = [
        cast(column, Text)
        if isinstance(column.type, JSON)
        else type_coerce(column, String)
        if isinstance(column.type, schema.Wei)
        else column
        for column in table.columns
    ]
    return select(*columns)
