"""What a wallet is about to send, written down first, so that a crash neither loses nor doubles it.

One SQLite file per chain. A transaction is `sent` from the moment it is signed; it is `mined` or `failed`
when its outcome is known, and its reply is kept for whoever asks again with the same request_id.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import (
    JSON,
    Column,
    Integer,
    LargeBinary,
    MetaData,
    Row,
    String,
    Table,
    UniqueConstraint,
    create_engine,
    event,
    insert,
    select,
    update,
)

metadata = MetaData()

_transactions = Table(
    "transactions",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("wallet", String(64), nullable=False, index=True),
    Column("request_id", String(128)),
    Column("command", String(64), nullable=False),
    Column("content_sha256", String(64), nullable=False),
    Column("to", String(42), nullable=False),
    Column("data", LargeBinary, nullable=False),
    Column("tx_hash", String(66), nullable=False),
    Column("raw", LargeBinary, nullable=False),
    Column("state", String(8), nullable=False, index=True),
    Column("outcome", JSON),
    UniqueConstraint("wallet", "request_id"),
)


@dataclass(frozen=True)
class Entry:
    """One transaction of a wallet."""

    id: int
    command: str
    content_sha256: str
    to: str
    data: bytes
    tx_hash: str
    raw: bytes
    state: str
    """sent, mined, failed, or dropped: it can never be mined any more."""
    outcome: dict[str, Any] | None
    """The reply when mined, the error when failed."""


class Journal:
    """The journal in the file at `path`. Thread-safe."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._engine = create_engine(f"sqlite:///{path}")
        event.listen(self._engine, "connect", _configure)
        metadata.create_all(self._engine)

    def find(self, wallet: str, request_id: str) -> Entry | None:
        """The wallet's transaction for this request."""
        return self._one(
            select(_transactions).where(
                _transactions.c.wallet == wallet, _transactions.c.request_id == request_id
            )
        )

    def unfinished(self, wallet: str) -> Entry | None:
        """The wallet's oldest transaction whose outcome is not known."""
        return self._one(
            select(_transactions)
            .where(_transactions.c.wallet == wallet, _transactions.c.state == "sent")
            .order_by(_transactions.c.id)
            .limit(1)
        )

    def add(self, wallet: str, request_id: str | None, **values: Any) -> Entry:
        """Write a signed transaction down; on disk when this returns."""
        with self._engine.begin() as connection:
            row = connection.execute(
                insert(_transactions)
                .values(wallet=wallet, request_id=request_id, state="sent", **values)
                .returning(_transactions)
            ).one()
        return _entry(row)

    def finish(self, entry: Entry, state: str, outcome: dict[str, Any]) -> None:
        """Keep the outcome: `mined` with a reply or `failed` with an error."""
        self._update(entry, state=state, outcome=outcome)

    def forget(self, entry: Entry) -> None:
        """The transaction can never be mined: its request may be made anew."""
        self._update(entry, state="dropped", request_id=None)

    def close(self) -> None:
        self._engine.dispose()

    def _update(self, entry: Entry, **values: Any) -> None:
        with self._engine.begin() as connection:
            connection.execute(update(_transactions).where(_transactions.c.id == entry.id).values(**values))

    def _one(self, query: Any) -> Entry | None:
        with self._engine.connect() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else _entry(row)


def _entry(row: Row[Any]) -> Entry:
    values = row._mapping
    return Entry(**{name: values[name] for name in Entry.__dataclass_fields__})


def _configure(connection: Any, _record: Any) -> None:
    # Synced at each commit: a transaction on the chain must be in the journal after a power cut as well.
    connection.execute("pragma journal_mode = wal")
    connection.execute("pragma synchronous = full")
