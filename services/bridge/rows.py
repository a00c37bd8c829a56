"""Rows as a batch of blocks changes them: read once, changed in memory, written together; and undone."""

from __future__ import annotations

from functools import cache
from typing import Any

from sqlalchemy import Connection, Delete, Engine, Select, Table, bindparam, delete, insert, select

from services.bridge import schema
from services.bridge.database import upsert

Row = dict[str, Any]
Key = tuple[Any, ...]


class Rows:
    """The rows of one database transaction; `block` is the block whose events change them now.

    Rows as they were before each block are kept for `roll_back` where `undoable`.
    """

    def __init__(self, engine: Engine, connection: Connection) -> None:
        self._engine = engine
        self._connection = connection
        self._rows: dict[tuple[str, Key], Row | None] = {}
        self._changed: dict[tuple[str, Key], Table] = {}
        self._before: list[Row] = []
        self._seen: set[tuple[int, str, Key]] = set()
        self.block = 0
        self.undoable = True

    def find(self, table: Table, *key: Any) -> Row | None:
        """The row, not to be changed by the caller."""
        place = (table.name, key)
        if place not in self._rows:
            found = self._connection.execute(_select(table), _parameters(table, key))
            row = found.mappings().one_or_none()
            self._rows[place] = None if row is None else dict(row)
        return self._rows[place]

    def get(self, table: Table, *key: Any) -> Row:
        """Raises LookupError when there is no such row."""
        row = self.find(table, *key)
        if row is None:
            raise LookupError(f"no row {key} in {table.name}")
        return row

    def add(self, table: Table, **values: Any) -> None:
        """Add a new row. Raises LookupError when it exists already."""
        key = tuple(values[column.name] for column in table.primary_key)
        if self.find(table, *key) is not None:
            raise LookupError(f"there is a row {key} in {table.name}")
        self.put(table, **values)

    def put(self, table: Table, **values: Any) -> None:
        """Make or replace the row; columns that are left out are null."""
        key = tuple(values[column.name] for column in table.primary_key)
        self.find(table, *key)
        self._remember(table, key)
        self._rows[table.name, key] = {column.name: values.get(column.name) for column in table.columns}
        self._changed[table.name, key] = table

    def change(self, table: Table, *key: Any, **values: Any) -> None:
        """Raises LookupError when there is no such row."""
        self.put(table, **{**self.get(table, *key), **values})

    def _remember(self, table: Table, key: Key) -> None:
        if not self.undoable or (self.block, table.name, key) in self._seen:
            return
        self._seen.add((self.block, table.name, key))
        before = self.find(table, *key)
        self._before.append({"block": self.block, "table": table.name, "key": list(key), "row": before})

    def write(self) -> None:
        """Hand everything to the database."""
        by_table: dict[Table, list[Row]] = {}
        for place, table in self._changed.items():
            by_table.setdefault(table, []).append(self._rows[place] or {})
        for table, rows in by_table.items():
            self._connection.execute(upsert(self._engine, table), rows)
        if self._before:
            self._connection.execute(insert(schema.undo), self._before)
        self._changed.clear()
        self._before.clear()


def roll_back(engine: Engine, connection: Connection, block: int) -> None:
    """Restore every row as it was after `block`."""
    newest_first = select(schema.undo).where(schema.undo.c.block > block).order_by(schema.undo.c.id.desc())
    for change in connection.execute(newest_first).mappings().all():
        table = schema.metadata.tables[change["table"]]
        if change["row"] is None:
            connection.execute(_delete(table), _parameters(table, tuple(change["key"])))
        else:
            connection.execute(upsert(engine, table), change["row"])
    connection.execute(delete(schema.undo).where(schema.undo.c.block > block))


@cache
def _select(table: Table) -> Select[Any]:
    """The row with the key in `_parameters`."""
    return select(table).where(*_matches(table))


@cache
def _delete(table: Table) -> Delete:
    return delete(table).where(*_matches(table))


def _matches(table: Table) -> list[Any]:
    return [column == bindparam(f"key_{column.name}") for column in table.primary_key]


def _parameters(table: Table, key: Key) -> dict[str, Any]:
    return {f"key_{column.name}": value for column, value in zip(table.primary_key, key, strict=True)}
