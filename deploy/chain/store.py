"""The local chain's storage: py-evm's key-value state and an index of logs, in one SQLite file.

Everything a block changes is one SQLite transaction, synced to disk before the sender hears of the block:
after a SIGKILL or a power cut the file holds whole blocks only.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from eth.db.backends.base import BaseDB

from deploy.chain.errors import ChainStoreCorrupted, ChainStoreUnwritable

_SCHEMA = """
create table if not exists state (key blob primary key, value blob not null) without rowid;
create table if not exists tried (id integer primary key, room blob not null);
create table if not exists logs (
    block_number integer not null,
    log_index integer not null,
    block_hash blob not null,
    block_timestamp integer not null,
    transaction_hash blob not null,
    transaction_index integer not null,
    address blob not null,
    topics blob not null,
    data blob not null,
    primary key (block_number, log_index)
) without rowid;
"""
_TRIED_BYTES = 64 * 1024
"""More than a block of a few transactions takes."""
_LOG_COLUMNS = (
    "block_number, log_index, block_hash, block_timestamp, transaction_hash, transaction_index, "
    "address, topics, data"
)


@dataclass(frozen=True)
class StoredLog:
    """One log with every field of eth_getLogs."""

    block_number: int
    log_index: int
    block_hash: bytes
    block_timestamp: int
    transaction_hash: bytes
    transaction_index: int
    address: bytes
    topics: tuple[bytes, ...]
    data: bytes


class Store(BaseDB):
    """py-evm's database. Writes belong to the current SQLite transaction until `commit` or `rollback`.

    Raises ChainStoreCorrupted when the file at `path` is not such a database or is damaged. What writes may
    raise ChainStoreUnwritable; from then on nothing is written until `rollback`, because SQLite has ended the
    transaction by itself and would keep each further write alone.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        # Only the server's one worker thread uses it, but that thread is not the one that opens it.
        self._connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        try:
            self._connection.execute("pragma journal_mode = wal")
            self._connection.execute("pragma synchronous = full")
            problem = self._connection.execute("pragma quick_check(1)").fetchone()[0]
            if problem == "ok":
                self._connection.executescript(_SCHEMA)
        except sqlite3.DatabaseError as error:
            problem = str(error)
        if problem != "ok":
            self._connection.close()
            raise ChainStoreCorrupted("the chain file is damaged", path=str(path), problem=problem)
        self._connection.execute("begin")
        self._broken: ChainStoreUnwritable | None = None
        self.failure: ChainStoreUnwritable | None = None
        """Reason of the last commit's failure; None since one succeeded. May be read from any thread."""

    # Key-value state, as py-evm asks for it

    def __getitem__(self, key: bytes) -> bytes:
        row = self._connection.execute("select value from state where key = ?", (key,)).fetchone()
        if row is None:
            raise KeyError(key)
        return row[0]

    def __setitem__(self, key: bytes, value: bytes) -> None:
        with self._writing() as connection:
            connection.execute("insert or replace into state values (?, ?)", (key, value))

    def __delitem__(self, key: bytes) -> None:
        with self._writing() as connection:
            connection.execute("delete from state where key = ?", (key,))

    def _exists(self, key: bytes) -> bool:
        return self._connection.execute("select 1 from state where key = ?", (key,)).fetchone() is not None

    # Log index

    def add_logs(self, logs: Sequence[StoredLog]) -> None:
        with self._writing() as connection:
            connection.executemany(
                f"insert into logs ({_LOG_COLUMNS}) values (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    (
                        log.block_number,
                        log.log_index,
                        log.block_hash,
                        log.block_timestamp,
                        log.transaction_hash,
                        log.transaction_index,
                        log.address,
                        b"".join(log.topics),
                        log.data,
                    )
                    for log in logs
                ),
            )

    def logs(self, first_block: int, last_block: int, addresses: Sequence[bytes] = ()) -> list[StoredLog]:
        """Logs of the inclusive block range in chain order; of any address when `addresses` is empty."""
        only = f"and address in ({','.join('?' * len(addresses))})" if addresses else ""
        rows = self._connection.execute(
            f"select {_LOG_COLUMNS} from logs where block_number between ? and ? {only} "
            "order by block_number, log_index",
            (first_block, last_block, *addresses),
        )
        return [
            StoredLog(
                block_number=row[0],
                log_index=row[1],
                block_hash=row[2],
                block_timestamp=row[3],
                transaction_hash=row[4],
                transaction_index=row[5],
                address=row[6],
                topics=tuple(row[7][i : i + 32] for i in range(0, len(row[7]), 32)),
                data=row[8],
            )
            for row in rows
        ]

    # Blocks

    def commit(self) -> None:
        """Make everything since the last commit durable."""
        with self._writing() as connection:
            connection.execute("commit")
            connection.execute("begin")
        self.failure = None

    def try_to_write(self) -> None:
        """Raises ChainStoreUnwritable unless a commit of `_TRIED_BYTES` succeeds now."""
        try:
            with self._writing() as connection:
                connection.execute("insert or replace into tried values (0, zeroblob(?))", (_TRIED_BYTES,))
            self.commit()
        except ChainStoreUnwritable:
            self.rollback()
            raise

    def rollback(self) -> None:
        """Forget everything since the last commit."""
        if self._connection.in_transaction:
            self._connection.execute("rollback")
        self._connection.execute("begin")
        self._broken = None

    def close(self) -> None:
        if self._connection.in_transaction:
            self._connection.execute("rollback")
        self._connection.close()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        if self._broken is not None:
            raise self._broken
        try:
            yield self._connection
        except sqlite3.DatabaseError as error:
            self._broken = self.failure = ChainStoreUnwritable(f"cannot write the chain file: {error}")
            raise self._broken from error
