"""The organization as its contracts' events tell it, in a database that answers queries.

Events of whole blocks are applied in one database transaction: a reader sees a block's effects all or not
at all, and after a crash the index stands at the end of a block. What a reorganization takes off the chain is
rolled back, and each undone event becomes an event of its own: sequence numbers only ever count up.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import (
    Connection,
    MetaData,
    bindparam,
    delete,
    func,
    insert,
    inspect,
    make_url,
    select,
    update,
)
from sqlalchemy.exc import DBAPIError

from rodeo.bus.messages import DaoEvent
from rodeo.chain.contracts import events
from rodeo.chain.contracts.logs import Log
from rodeo.money.currency import IEC, Currency
from services.bridge import schema
from services.bridge.amounts import event_args
from services.bridge.database import Checkpointer, damage, open_database, upsert
from services.bridge.errors import IndexUnusable
from services.bridge.projection.projection import Projection
from services.bridge.reading import Money, Reader, Row, Rules, Services, Tasks, Votes
from services.bridge.rows import Rows, roll_back

log = logging.getLogger(__name__)

UNDONE = "EventUndone"
"""Name of the event that says that an earlier one is not on the chain any more."""

KEPT_BLOCKS = 256
"""How deep a reorganization can be without the index being read anew; several times what chains allow."""


@dataclass(frozen=True)
class Position:
    """How far the index follows the chain."""

    block: int
    block_hash: str
    block_time_s: int


NOWHERE = Position(-1, "", 0)


@dataclass(frozen=True)
class Said:
    """What the index says that the chain can be asked about, too."""

    position: Position
    tasks: int
    services: int
    balances: dict[str, int]
    """Address -> wei of the payment token."""


@dataclass(frozen=True)
class TimedLog:
    """A contract event, where it was logged, and the time of its block."""

    log: Log
    time_s: int


class Index:
    """The database at `url`, for the chain and contracts given; one that holds another chain is emptied,
    and one of another schema version is rebuilt.

    On PostgreSQL it lives in `schema_name`. One thread applies, any thread reads. A damaged SQLite file
    is set aside. Raises IndexUnusable when the database cannot be opened.
    """

    def __init__(
        self,
        url: str,
        chain_id: int,
        genesis_hash: str,
        contracts: Mapping[str, str],
        schema_name: str = "",
        currency: Currency = IEC,
    ) -> None:
        """`currency` is what the contracts pay with."""
        self._currency, self.contracts = currency, dict(contracts)
        self._identity = {
            "version": schema.version(),
            "chain_id": chain_id,
            "genesis_hash": genesis_hash,
            "contracts": self.contracts,
        }
        self.genesis_hash = genesis_hash
        self._url = url
        _set_aside_if_damaged(url)
        try:
            self._engine = open_database(url, schema_name)
            self._reader = Reader(self._engine)
            self.tasks, self.services = Tasks(self._engine), Services(self._engine)
            self.rules, self.votes, self.money = Rules(self._engine), Votes(self._engine), Money(self._engine)
            self._make_tables()
            rows = self._reader.rows(select(schema.cursor))
        except DBAPIError as error:
            raise IndexUnusable(
                "the index cannot be opened", url=_shown(url), problem=str(error.orig)
            ) from error
        if rows and all(rows[0][name] == value for name, value in self._identity.items()):
            self._position = Position(rows[0]["block"], rows[0]["block_hash"], rows[0]["block_time_s"])
        else:
            self.clear()
        self._checkpointer = Checkpointer(self._engine) if self._is_sqlite else None

    def _make_tables(self) -> None:
        """Drop the tables of another schema version, and create those of this one."""
        expected = self._identity["version"]
        with self._engine.begin() as connection:
            there = inspect(connection)
            names = set(there.get_table_names())
            found = None
            if "cursor" in names and "version" in {one["name"] for one in there.get_columns("cursor")}:
                found = connection.scalar(select(schema.cursor.c.version))
            if found == expected:
                return
            if old := names & {*schema.metadata.tables}:
                log.warning(
                    "the index has schema version %s, not %s: it is rebuilt from the chain's events",
                    found or "none",
                    expected,
                )
                before = MetaData()
                before.reflect(connection, only=sorted(old))
                before.drop_all(connection)
            schema.metadata.create_all(connection)

    def clear(self) -> None:
        """Start again from the chain's beginning, as if nothing had been published."""
        with self._engine.begin() as connection:
            for table in schema.metadata.sorted_tables:
                connection.execute(delete(table))
            connection.execute(
                insert(schema.cursor).values(id=1, **self._identity, **_at(NOWHERE), published_seq=0)
            )
        self._position = NOWHERE

    def close(self) -> None:
        if self._checkpointer is not None:
            self._checkpointer.close()
        self._engine.dispose()

    # What can be compared with the chain ------------------------------------------------------------------

    @property
    def _is_sqlite(self) -> bool:
        return self._engine.dialect.name == "sqlite"

    def said(self) -> Said:
        """What the chain can be asked about, as of one block."""
        with self._snapshot() as connection:
            cursor = connection.execute(select(schema.cursor)).mappings().one()
            return Said(
                Position(cursor["block"], cursor["block_hash"], cursor["block_time_s"]),
                connection.scalar(select(func.count()).select_from(schema.tasks)) or 0,
                connection.scalar(select(func.count()).select_from(schema.services)) or 0,
                {row.address: row.balance for row in connection.execute(select(schema.balances))},
            )

    def is_malformed(self) -> bool:
        """Whether the database's file is not one any more."""
        path = make_url(self._url).database
        return self._is_sqlite and bool(path) and damage(Path(path or "")) is not None

    @contextmanager
    def _snapshot(self) -> Iterator[Connection]:
        """All that is read through it is of one moment."""
        with self._engine.connect() as connection:
            if self._is_sqlite:
                connection.exec_driver_sql("begin")
            try:
                yield connection
            finally:
                connection.rollback()

    # Following the chain ----------------------------------------------------------------------------------

    @property
    def position(self) -> Position:
        return self._position

    @property
    def published_seq(self) -> int:
        """The last event that was put on the bus."""
        return int(self._reader.scalar(_PUBLISHED_SEQ))

    def apply(
        self, logs: Sequence[TimedLog], position: Position, *, head: int | None = None
    ) -> list[DaoEvent]:
        """Take in all events up to `position`; returns them with their sequence numbers.

        `head` is the newest block of the chain: what is far below it cannot be undone and costs less.
        """
        final = (position.block if head is None else head) - KEPT_BLOCKS
        applied: list[DaoEvent] = []
        with self._engine.begin() as connection:
            last = connection.scalar(_NEWEST_SEQ) or 0
            rows = Rows(self._engine, connection)
            projection = Projection(rows, self.contracts, self._currency)
            projection.prepare(timed.log for timed in logs)
            for seq, timed in enumerate(logs, start=last + 1):
                rows.block, rows.undoable = timed.log.block, timed.log.block > final
                projection.apply(seq, timed.log, timed.time_s)
                applied.append(_dao_event(seq, timed, self.genesis_hash, self._currency))
            rows.write()
            if applied:
                connection.execute(_ADD_EVENTS, [_event_row(event) for event in applied])
                connection.execute(upsert(self._engine, schema.transactions), _transactions(applied))
            recent = {
                one.log.block: (one.log.block_hash, one.time_s) for one in logs if one.log.block > final
            }
            recent[position.block] = (position.block_hash, position.block_time_s)
            connection.execute(
                upsert(self._engine, schema.blocks),
                [{"number": n, "hash": block_hash, "time_s": t} for n, (block_hash, t) in recent.items()],
            )
            if position.block % KEPT_BLOCKS == 0 or len(recent) > 1:
                connection.execute(_FORGET_BLOCKS, {"final": final})
                connection.execute(_FORGET_UNDO, {"final": final})
            connection.execute(_MOVE_CURSOR, _at(position))
        self._position = position
        return applied

    def recent_blocks(self) -> list[Position]:
        """Blocks that the index can be rolled back to, the newest first."""
        blocks = self._reader.rows(select(schema.blocks).order_by(schema.blocks.c.number.desc()))
        return [Position(block["number"], block["hash"], block["time_s"]) for block in blocks]

    def roll_back(self, position: Position) -> list[DaoEvent]:
        """Undo all blocks after `position`, one of `recent_blocks` or NOWHERE; returns the notices of it."""
        events = schema.events.c
        gone = (events.block > position.block) & ~events.undone
        with self._engine.begin() as connection:
            last = connection.scalar(_NEWEST_SEQ) or 0
            undone = connection.execute(
                select(schema.events).where(gone).order_by(events.seq.desc())
            ).mappings()
            notices = [
                DaoEvent(
                    **{name: row[name] for name in ("block", "log_index", "tx_hash", "time_s", "task_id")},
                    seq=seq,
                    name=UNDONE,
                    args={**row["args"], "undone_seq": row["seq"], "undone_name": row["name"]},
                    chain=self.genesis_hash,
                )
                for seq, row in enumerate(undone, start=last + 1)
            ]
            connection.execute(update(schema.events).where(gone).values(undone=True))
            if notices:
                connection.execute(_ADD_EVENTS, [_event_row(notice, undone=True) for notice in notices])
            if position == NOWHERE:
                for table in _FROM_EVENTS:
                    connection.execute(delete(table))
            else:
                roll_back(self._engine, connection, position.block)
            connection.execute(delete(schema.blocks).where(schema.blocks.c.number > position.block))
            connection.execute(
                delete(schema.transactions).where(schema.transactions.c.block > position.block)
            )
            connection.execute(_MOVE_CURSOR, _at(position))
        self._position = position
        return notices

    def mark_published(self, seq: int) -> None:
        """Remember that all events up to `seq` were put on the bus."""
        with self._engine.begin() as connection:
            connection.execute(_MOVE_CURSOR, {"published_seq": seq})

    # Events -----------------------------------------------------------------------------------------------

    def events_after(
        self, seq: int, limit: int, names: Sequence[str] = (), task_id: int | None = None
    ) -> list[DaoEvent]:
        query = select(schema.events).where(schema.events.c.seq > seq).order_by(schema.events.c.seq)
        if names:
            query = query.where(schema.events.c.name.in_(names))
        if task_id is not None:
            query = query.where(schema.events.c.task_id == task_id)
        return [
            DaoEvent(**{name: row[name] for name in _OF_EVENT}, chain=self.genesis_hash)
            for row in self._reader.rows(query.limit(limit))
        ]

    def newest_transaction(self) -> str | None:
        """The last one with events of the contracts that is still on the chain."""
        return self._reader.scalar(_NEWEST_TRANSACTION)

    def last_seq(self) -> int:
        return self._reader.scalar(_NEWEST_SEQ) or 0


# Made once: what is asked at every block costs more to put together than to answer.
_NEWEST_SEQ = select(func.max(schema.events.c.seq))
_NEWEST_TRANSACTION = (
    select(schema.events.c.tx_hash)
    .where(~schema.events.c.undone)
    .order_by(schema.events.c.seq.desc())
    .limit(1)
)
_ADD_EVENTS = insert(schema.events)
_MOVE_CURSOR = update(schema.cursor)
_FORGET_BLOCKS = delete(schema.blocks).where(schema.blocks.c.number <= bindparam("final"))
_FORGET_UNDO = delete(schema.undo).where(schema.undo.c.block <= bindparam("final"))
_PUBLISHED_SEQ = select(schema.cursor.c.published_seq)

_OF_EVENT = ("seq", "name", "block", "log_index", "tx_hash", "time_s", "task_id", "args")

_FROM_EVENTS = [
    table
    for table in schema.metadata.sorted_tables
    if table not in (schema.cursor, schema.events, schema.blocks)
]


def sqlite_url(path: Path) -> str:
    return f"sqlite:///{path}"


def _dao_event(seq: int, timed: TimedLog, chain: str, currency: Currency) -> DaoEvent:
    log = timed.log
    # Built from values of known types: to validate them again would take as long as all the rest.
    return DaoEvent.model_construct(
        seq=seq,
        name=log.event.name,
        block=log.block,
        log_index=log.log_index,
        tx_hash=log.tx_hash,
        time_s=float(timed.time_s),
        task_id=getattr(log.event, "task_id", None),
        args=_args(log, currency),
        chain=chain,
    )


_OF_COMMITTEES = (events.JudgeSeated, events.JudgeKeyChanged, events.QuorumChanged)


def _args(log: Log, currency: Currency) -> dict[str, Any]:
    """Arguments of an event. Events of committees do not name their committee, so its address is added."""
    args = event_args(log.event, currency)
    return {**args, "committee": log.contract} if isinstance(log.event, _OF_COMMITTEES) else args


def _event_row(event: DaoEvent, undone: bool = False) -> Row:
    return {**{name: getattr(event, name) for name in _OF_EVENT}, "undone": undone}


def _transactions(applied: Sequence[DaoEvent]) -> list[Row]:
    """A row for each of the events' transactions, whose receipts are not known yet."""
    last = {one.tx_hash: one for one in applied}
    unknown: Row = dict.fromkeys(("sender", "gas_used", "gas_price"))
    return [
        {name: getattr(one, name) for name in ("tx_hash", "seq", "block", "time_s")} | unknown
        for one in last.values()
    ]


def _at(position: Position) -> Row:
    return asdict(position)


def _set_aside_if_damaged(url: str) -> None:
    """Move a damaged SQLite file out of the way: all that it held is read from the chain again."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite" or not parsed.database:
        return
    path = Path(parsed.database)
    if (problem := damage(path)) is None:
        return
    log.warning("the index is damaged; rebuilding it from the chain: %s", problem, extra={"path": str(path)})
    path.replace(path.with_name(path.name + ".damaged"))
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def _shown(url: str) -> str:
    return make_url(url).render_as_string(hide_password=True)
