"""The organization as its contracts' events tell it, in a database that answers queries.

Events of whole blocks are applied in one database transaction: a reader sees a block's effects all or not
at all, and after a crash the index stands at the end of a block.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import sqlalchemy
from sqlalchemy import Connection, create_engine, func, insert, select, update
from sqlalchemy.dialects.sqlite import insert as upsert
from sqlalchemy.exc import DatabaseError

from rodeo.bus import decode_json
from rodeo.chain import Cause, Event, Log, events
from rodeo.errors import MalformedJson
from rodeo.messages import DaoEvent
from services.bridge import schema
from services.bridge.amounts import event_args
from services.bridge.errors import IndexUnusable

ZERO_ADDRESS = "0x" + "00" * 20


@dataclass(frozen=True)
class Position:
    """How far the index follows the chain."""

    block: int
    block_hash: str
    block_time_s: int


@dataclass(frozen=True)
class TimedLog:
    """A contract event, where it was logged, and the time of its block."""

    log: Log
    time_s: int


class Index:
    """The database at `path`, for the chain and contracts given; one that holds another chain is emptied.

    One thread applies, any thread reads. Raises IndexUnusable when the file is not a database.
    """

    def __init__(self, path: Path, chain_id: int, genesis_hash: str, contracts: Mapping[str, str]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._engine = create_engine(f"sqlite:///{path}")
        sqlalchemy.event.listen(self._engine, "connect", _configure_sqlite)
        identity = {
            "version": schema.VERSION,
            "chain_id": chain_id,
            "genesis_hash": genesis_hash,
            "contracts": dict(contracts),
        }
        try:
            with self._engine.begin() as connection:
                schema.metadata.create_all(connection)
            rows = self._rows(select(schema.cursor))
        except DatabaseError as error:
            raise IndexUnusable("the index cannot be opened", path=str(path), problem=str(error)) from error
        self._identity = identity
        if rows and all(rows[0][name] == value for name, value in identity.items()):
            self._position = Position(rows[0]["block"], rows[0]["block_hash"], rows[0]["block_time_s"])
        else:
            self.clear()

    def clear(self) -> None:
        """Start again from the chain's beginning."""
        with self._engine.begin() as connection:
            schema.metadata.drop_all(connection)
            schema.metadata.create_all(connection)
            connection.execute(
                insert(schema.cursor).values(
                    id=1, **self._identity, block=-1, block_hash="", block_time_s=0, published_seq=0
                )
            )
        self._position = Position(-1, "", 0)

    def close(self) -> None:
        self._engine.dispose()

    # Following the chain ----------------------------------------------------------------------------------

    @property
    def position(self) -> Position:
        return self._position

    @property
    def published_seq(self) -> int:
        """The last event that was put on the bus."""
        return int(self._cursor()["published_seq"])

    def apply(self, logs: Iterable[TimedLog], position: Position) -> list[DaoEvent]:
        """Take in all events up to `position`; returns them with their sequence numbers."""
        with self._engine.begin() as connection:
            last = connection.scalar(select(func.max(schema.events.c.seq))) or 0
            applied = [_apply(connection, seq, one) for seq, one in enumerate(logs, start=last + 1)]
            connection.execute(update(schema.cursor).values(**asdict(position)))
        self._position = position
        return applied

    def mark_published(self, seq: int) -> None:
        """Remember that all events up to `seq` were put on the bus."""
        with self._engine.begin() as connection:
            connection.execute(update(schema.cursor).values(published_seq=seq))

    # Questions --------------------------------------------------------------------------------------------

    def events_after(self, seq: int, limit: int) -> list[DaoEvent]:
        query = select(schema.events).where(schema.events.c.seq > seq).order_by(schema.events.c.seq)
        return [DaoEvent.model_validate(row) for row in self._rows(query.limit(limit))]

    def last_seq(self) -> int:
        with self._engine.connect() as connection:
            return connection.scalar(select(func.max(schema.events.c.seq))) or 0

    def tasks(self, filters: Mapping[str, str], limit: int, offset: int) -> tuple[list[dict[str, Any]], int]:
        """Rows of the tasks whose columns equal `filters`, newest first, and how many there are in all."""
        conditions = [schema.tasks.c[name] == value for name, value in filters.items()]
        query = select(schema.tasks).where(*conditions).order_by(schema.tasks.c.id.desc())
        with self._engine.connect() as connection:
            total = connection.scalar(select(func.count()).select_from(schema.tasks).where(*conditions)) or 0
        return self._rows(query.limit(limit).offset(offset)), total

    def task(self, task_id: int) -> dict[str, Any] | None:
        rows = self._rows(select(schema.tasks).where(schema.tasks.c.id == task_id))
        return rows[0] if rows else None

    def overdue(self, now_s: float) -> list[int]:
        """Ids of the tasks whose running window ended before `now_s`."""
        tasks = schema.tasks.c
        late = select(tasks.id).where(
            ((tasks.state == "assigned") & (tasks.execution_deadline < now_s))
            | ((tasks.state == "submitted") & (tasks.verdict_deadline < now_s))
        )
        return [row["id"] for row in self._rows(late)]

    def services(self) -> list[dict[str, Any]]:
        return self._rows(select(schema.services).order_by(schema.services.c.id))

    def service(self, service_id: int) -> dict[str, Any] | None:
        rows = self._rows(select(schema.services).where(schema.services.c.id == service_id))
        return rows[0] if rows else None

    def active_prices(self, kind: str) -> list[int]:
        """What the services of `kind` that take tasks cost, wei."""
        services = schema.services.c
        query = select(services.price).where(services.kind == kind, services.state == "active")
        return [row["price"] for row in self._rows(query)]

    def kinds(self) -> list[str]:
        """The kinds of work that the organization accepts."""
        query = select(schema.kinds.c.kind).where(schema.kinds.c.allowed).order_by(schema.kinds.c.kind)
        return [row["kind"] for row in self._rows(query)]

    def devices(self) -> list[dict[str, Any]]:
        return self._rows(select(schema.devices).order_by(schema.devices.c.registered))

    def balances(self) -> dict[str, int]:
        """Address -> wei of IECoin, of everyone who ever had any."""
        return {row["address"]: row["balance"] for row in self._rows(select(schema.balances))}

    def _cursor(self) -> dict[str, Any]:
        return self._rows(select(schema.cursor))[0]

    def _rows(self, query: Any) -> list[dict[str, Any]]:
        with self._engine.connect() as connection:
            return [dict(row) for row in connection.execute(query).mappings()]


def _configure_sqlite(connection: Any, _record: Any) -> None:
    # Readers do not wait for the writer. What a power cut takes is read from the chain again.
    connection.execute("pragma journal_mode = wal")
    connection.execute("pragma synchronous = normal")


# What each event changes ------------------------------------------------------------------------------------


def _apply(connection: Connection, seq: int, timed: TimedLog) -> DaoEvent:
    log = timed.log
    _project(connection, log.event, timed.time_s)
    dao_event = DaoEvent(
        seq=seq,
        name=log.event.name,
        block=log.block,
        log_index=log.log_index,
        tx_hash=log.tx_hash,
        time_s=timed.time_s,
        task_id=getattr(log.event, "task_id", None),
        args=event_args(log.event),
    )
    connection.execute(insert(schema.events).values(**dao_event.model_dump()))
    return dao_event


def _project(connection: Connection, event: Event, time_s: int) -> None:
    """Events without a case change nothing that can be queried; they are kept and published."""
    match event:
        case events.TaskRegistered():
            params, description = parse_task_text(event.params)
            connection.execute(
                insert(schema.tasks).values(
                    id=event.task_id,
                    kind=event.kind,
                    state="open",
                    attempt=0,
                    max_attempts=event.max_attempts,
                    creator=event.creator,
                    reward=event.reward,
                    paid=0,
                    params=params,
                    description=description,
                    registered=time_s,
                )
            )
        case events.TaskAssigned():
            _update_task(
                connection,
                event.task_id,
                **dict.fromkeys(_OF_ATTEMPT),
                state="assigned",
                attempt=event.attempt,
                executor=event.executor,
                service_id=event.service_id,
                price=event.price,
                assigned=time_s,
                execution_deadline=event.deadline,
                nonce="0x" + event.nonce.hex(),
            )
            _update_service(connection, event.service_id, task_id=event.task_id)
        case events.ProofSubmitted():
            _update_task(
                connection,
                event.task_id,
                state="submitted",
                proof_submitted=time_s,
                proof_sha256="0x" + event.proof_hash.hex(),
                proof_uri=event.uri,
                verdict_deadline=event.deadline,
            )
        case events.VerdictPosted():
            _update_task(
                connection,
                event.task_id,
                verdict="accepted" if event.accepted else "rejected",
                reason=event.reason,
                report_sha256="0x" + event.report_hash.hex(),
                report_uri=event.report_uri,
            )
        case events.TaskSettled():
            _release_service(connection, event.task_id, "completed")
            _update_task(connection, event.task_id, state="settled", settled=time_s, paid=event.paid)
        case events.TaskRequeued():
            _release_service(connection, event.task_id, _COUNTER[event.cause])
            _update_task(
                connection,
                event.task_id,
                **dict.fromkeys(_OF_ASSIGNMENT),
                **_VERDICT_OF_EXPIRY.get(event.cause, {}),
                state="open",
            )
        case events.TaskFailed():
            _release_service(connection, event.task_id, _COUNTER[event.cause])
            _update_task(connection, event.task_id, **_VERDICT_OF_EXPIRY.get(event.cause, {}), state="failed")
        case events.TaskCancelled():
            _update_task(connection, event.task_id, state="cancelled")
        case events.ServiceRegistered():
            connection.execute(
                insert(schema.services).values(
                    id=event.service_id,
                    kind=event.kind,
                    provider=event.provider,
                    price=event.price,
                    state="active",
                    description=event.description,
                    completed=0,
                    rejected=0,
                    expired=0,
                )
            )
        case events.ServiceUpdated():
            _update_service(connection, event.service_id, price=event.price, state=event.state.name.lower())
        case events.ServiceSuspended():
            _update_service(connection, event.service_id, state="suspended")
        case events.ServiceReinstated():
            _update_service(connection, event.service_id, state="paused")
        case events.DeviceRegistered():
            connection.execute(
                insert(schema.devices).values(
                    address=event.device,
                    role=event.role,
                    owner=event.owner,
                    registrar=event.registrar,
                    registered=time_s,
                )
            )
        case events.DeviceRevoked():
            connection.execute(
                update(schema.devices).where(schema.devices.c.address == event.device).values(revoked=time_s)
            )
        case events.KindAllowed():
            row = {"kind": event.kind, "allowed": event.allowed}
            connection.execute(upsert(schema.kinds).values(**row).on_conflict_do_update(["kind"], set_=row))
        case events.Transfer():
            _add_balance(connection, event.sender, -event.value)
            _add_balance(connection, event.to, event.value)


_OF_ATTEMPT = (
    "proof_submitted",
    "verdict_deadline",
    "proof_sha256",
    "proof_uri",
    "verdict",
    "reason",
    "report_sha256",
    "report_uri",
)
"""Columns that a new attempt starts without. Until then they tell how the last attempt ended."""

_OF_ASSIGNMENT = (
    "executor",
    "service_id",
    "price",
    "assigned",
    "execution_deadline",
    "verdict_deadline",
    "nonce",
)
"""Columns that only an assigned task has."""

_COUNTER: dict[Cause, str | None] = {
    Cause.REJECTED: "rejected",
    Cause.EXECUTION_EXPIRED: "expired",
    Cause.VERDICT_EXPIRED: None,
}
"""What a failed attempt adds to its service's record; a verdict that never came is not its fault."""

_VERDICT_OF_EXPIRY = {
    Cause.EXECUTION_EXPIRED: {"verdict": "expired", "reason": "no proof within the execution window"},
    Cause.VERDICT_EXPIRED: {"verdict": "expired", "reason": "no verdict within the verdict window"},
}


def _update_task(connection: Connection, task_id: int, **values: Any) -> None:
    connection.execute(update(schema.tasks).where(schema.tasks.c.id == task_id).values(**values))


def _update_service(connection: Connection, service_id: int | None, **values: Any) -> None:
    connection.execute(update(schema.services).where(schema.services.c.id == service_id).values(**values))


def _release_service(connection: Connection, task_id: int, counter: str | None) -> None:
    """The attempt at the task is over for the service that made it."""
    service_id = connection.scalar(select(schema.tasks.c.service_id).where(schema.tasks.c.id == task_id))
    values: dict[str, Any] = {"task_id": None}
    if counter is not None:
        values[counter] = schema.services.c[counter] + 1
    _update_service(connection, service_id, **values)


def _add_balance(connection: Connection, address: str, change: int) -> None:
    # Tokens are minted from and burnt to the zero address.
    if address == ZERO_ADDRESS:
        return
    of = schema.balances.c.address == address
    balance = connection.scalar(select(schema.balances.c.balance).where(of))
    if balance is None:
        connection.execute(insert(schema.balances).values(address=address, balance=change))
    else:
        connection.execute(update(schema.balances).where(of).values(balance=balance + change))


def parse_task_text(text: str) -> tuple[dict[str, Any], str]:
    """Parameters and description from a task's `params`, which anybody may have filled with anything."""
    try:
        value = decode_json(text.encode(errors="replace"))
    except MalformedJson:
        return {}, text
    params, description = value.get("params"), value.get("description", "")
    if not isinstance(params, dict) or not isinstance(description, str):
        return {}, text
    return params, description
