"""Databases of the bridge: SQLite files by default, PostgreSQL by URL, and the upgrade of the journal's file.

The index can be rebuilt from the chain and so may lose its last moments in a power cut; the journal may not.
"""

from __future__ import annotations

import logging
import sqlite3
import threading
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import sqlalchemy
from sqlalchemy import Engine, MetaData, Table, create_engine, make_url
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import OperationalError

log = logging.getLogger(__name__)

_CHECKPOINT_S = 2.0
_CHECKPOINT_PAGES = 10_000
"""Pages of 4 KiB after which the log is restarted: SQLite restarts it only while nothing is written."""


def open_database(url: str, schema: str = "", *, durable: bool = False) -> Engine:
    """An engine for `url`, on PostgreSQL inside `schema`, which is made; `durable` syncs each commit."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite":
        engine = create_engine(
            parsed, connect_args={"options": f"-csearch_path={schema}"} if schema else {}, pool_pre_ping=True
        )
        if schema:
            with engine.begin() as connection:
                connection.execute(sqlalchemy.schema.CreateSchema(schema, if_not_exists=True))
        return engine
    if parsed.database:
        Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(parsed, connect_args={"timeout": 30.0})

    def configure(connection: Any, _record: Any) -> None:
        # Readers do not wait for the writer.
        connection.execute("pragma journal_mode = wal")
        connection.execute(f"pragma synchronous = {'full' if durable else 'normal'}")
        if not durable:
            connection.execute("pragma wal_autocheckpoint = 0")

    sqlalchemy.event.listen(engine, "connect", configure)
    return engine


_CONTENT = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def damage(path: Path) -> str | None:
    """What SQLite finds wrong with the content of the file at `path`; None if it is sound, or not there."""
    if not path.exists():
        return None
    try:
        with closing(sqlite3.connect(path)) as connection:
            problem = str(connection.execute("pragma quick_check(1)").fetchone()[0])
    except sqlite3.DatabaseError as error:
        # Missing rights, a full disk and the like say nothing about its content.
        return str(error) if error.sqlite_errorcode & 0xFF in _CONTENT else None
    return None if problem == "ok" else problem


class Checkpointer:
    """Moves the pages of a SQLite write-ahead log to their place, in a thread of its own.

    SQLite would do so in one commit of a hundred and wait for the disk: 30 ms that nobody expects.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="checkpoints", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(_CHECKPOINT_S):
            try:
                self._checkpoint()
            except OperationalError as error:
                # For example on a full disk. The pages stay in the log, and a later turn moves them.
                log.warning("pages stay in the index's write-ahead log: %s", error.orig)

    def _checkpoint(self) -> None:
        with self._engine.connect() as connection:
            # Blocks neither readers nor the writer.
            _, pages, _ = connection.exec_driver_sql("pragma wal_checkpoint(passive)").one()
            if pages > _CHECKPOINT_PAGES:
                # Blocks the writer, but only for pages written in the meantime.
                connection.exec_driver_sql("pragma wal_checkpoint(restart)")

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


def upgrade(engine: Engine, tables: MetaData, version: int) -> None:
    """Bring a SQLite file to schema `version` of `tables`: add each table, column and index that it lacks.

    Its own version is its `user_version`; 0 in a new file, and in one from before versions were numbered.
    """
    with engine.begin() as connection:
        if connection.exec_driver_sql("pragma user_version").scalar_one() == version:
            return
        there = sqlalchemy.inspect(connection)
        for table in tables.sorted_tables:
            if not there.has_table(table.name):
                table.create(connection)
                continue
            known = {column["name"] for column in there.get_columns(table.name)}
            for column in (one for one in table.columns if one.name not in known):
                added = sqlalchemy.schema.CreateColumn(column).compile(engine)
                connection.exec_driver_sql(f"alter table {table.name} add column {added}")
            for index in table.indexes:
                index.create(connection, checkfirst=True)
        connection.exec_driver_sql(f"pragma user_version = {version}")


def upsert(engine: Engine, table: Table) -> Any:
    """`insert` that overwrites the row with the same primary key."""
    return _upsert(engine.dialect.name, table)


@cache
def _upsert(dialect_name: str, table: Table) -> Any:
    # Made once: SQLAlchemy knows a statement it has seen by the object, any other by all that is in it.
    dialect: Any = postgresql if dialect_name == "postgresql" else sqlite
    statement = dialect.insert(table)
    others = {
        column.name: statement.excluded[column.name] for column in table.columns if not column.primary_key
    }
    return statement.on_conflict_do_update(index_elements=list(table.primary_key.columns), set_=others)
