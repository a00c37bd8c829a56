"""Tables of the index. They hold nothing that the chain's logs do not, so they are dropped at will."""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Dialect,
    Float,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
)

VERSION = 1
"""Raised when a table or what is written to it changes; an index of another version is rebuilt."""

metadata = MetaData()


class Wei(TypeDecorator[int]):
    """A 256-bit amount. Databases have no such integer, so it is decimal text; never compared in SQL."""

    impl = String(78)
    cache_ok = True

    def process_bind_param(self, value: int | None, dialect: Dialect) -> str | None:
        return None if value is None else str(value)

    def process_result_value(self, value: str | None, dialect: Dialect) -> int | None:
        return None if value is None else int(value)


cursor = Table(
    "cursor",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("version", Integer, nullable=False),
    Column("chain_id", Integer, nullable=False),
    Column("genesis_hash", String(66), nullable=False),
    Column("contracts", JSON, nullable=False, doc="name -> address that the index was built from"),
    Column("block", Integer, nullable=False, doc="last block that is in the index"),
    Column("block_hash", String(66), nullable=False),
    Column("block_time_s", Integer, nullable=False),
    Column("published_seq", Integer, nullable=False, doc="last event that was put on the bus"),
)

events = Table(
    "events",
    metadata,
    Column("seq", Integer, primary_key=True, autoincrement=False),
    Column("name", String(64), nullable=False),
    Column("block", Integer, nullable=False),
    Column("log_index", Integer, nullable=False),
    Column("tx_hash", String(66), nullable=False),
    Column("time_s", Integer, nullable=False),
    Column("task_id", Integer, index=True),
    Column("args", JSON, nullable=False),
    UniqueConstraint("block", "log_index"),
)

tasks = Table(
    "tasks",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("kind", String(32), nullable=False),
    Column("state", String(16), nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("max_attempts", Integer, nullable=False),
    Column("creator", String(42), nullable=False, index=True),
    Column("executor", String(42), index=True),
    Column("service_id", Integer),
    Column("reward", Wei, nullable=False),
    Column("price", Wei),
    Column("paid", Wei, nullable=False),
    Column("params", JSON, nullable=False),
    Column("description", Text, nullable=False),
    Column("registered", Float, nullable=False),
    Column("assigned", Float),
    Column("proof_submitted", Float),
    Column("settled", Float),
    Column("execution_deadline", Float),
    Column("verdict_deadline", Float),
    Column("nonce", String(66)),
    Column("proof_sha256", String(66)),
    Column("proof_uri", Text),
    Column("verdict", String(16)),
    Column("reason", Text),
    Column("report_sha256", String(66)),
    Column("report_uri", Text),
    Index("tasks_by_state_and_kind", "state", "kind"),
)

services = Table(
    "services",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("kind", String(32), nullable=False, index=True),
    Column("provider", String(42), nullable=False, index=True),
    Column("price", Wei, nullable=False),
    Column("state", String(16), nullable=False),
    Column("description", Text, nullable=False),
    Column("task_id", Integer, doc="the task it is doing"),
    Column("completed", Integer, nullable=False),
    Column("rejected", Integer, nullable=False),
    Column("expired", Integer, nullable=False),
)

devices = Table(
    "devices",
    metadata,
    Column("address", String(42), primary_key=True),
    Column("role", String(32), nullable=False),
    Column("owner", String(42), nullable=False),
    Column("registrar", String(42), nullable=False),
    Column("registered", Float, nullable=False),
    Column("revoked", Float),
)

kinds = Table(
    "kinds",
    metadata,
    Column("kind", String(32), primary_key=True),
    Column("allowed", Boolean, nullable=False),
)

balances = Table(
    "balances",
    metadata,
    Column("address", String(42), primary_key=True),
    Column("balance", Wei, nullable=False),
)
