"""The organization as its contracts' events tell it, in a database that answers queries.

Events of whole blocks are applied in one database transaction: a reader sees a block's effects all or not
at all, and after a crash the index stands at the end of a block. What a reorganization takes off the chain is
rolled back, and each undone event becomes an event of its own: sequence numbers only ever count up.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args

from sqlalchemy import (
    Connection,
    MetaData,
    Select,
    bindparam,
    case,
    delete,
    func,
    insert,
    inspect,
    make_url,
    null,
    or_,
    select,
    update,
)
from sqlalchemy.exc import DBAPIError

from rodeo.bus.messages import LIVE_STATES, DaoEvent, Ruling
from rodeo.chain.artifacts import ORACLES
from rodeo.chain.contracts import events
from rodeo.chain.contracts.logs import Log
from rodeo.money.currency import IEC, Currency
from services.bridge import schema
from services.bridge.amounts import event_args
from services.bridge.database import Checkpointer, damage, open_database, upsert
from services.bridge.errors import IndexUnusable
from services.bridge.projection.projection import Projection
from services.bridge.rows import Rows, roll_back

log = logging.getLogger(__name__)

UNDONE = "EventUndone"
"""Name of the event that says that an earlier one is not on the chain any more."""

KEPT_BLOCKS = 256
"""How deep a reorganization can be without the index being read anew; several times what chains allow."""

_EXECUTION_END = case(
    (
        schema.tasks.c.accepted.is_(False),
        schema.tasks.c.execution_deadline - schema.tasks.c.execution_window_s + schema.tasks.c.grace_s,
    ),
    else_=schema.tasks.c.execution_deadline,
)
"""Time (s) after which anybody may expire an assigned task. An attempt that nobody accepted ends earlier."""

Row = dict[str, Any]


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


@dataclass(frozen=True)
class Page:
    limit: int
    offset: int = 0


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
        self._currency, self._contracts = currency, dict(contracts)
        self._identity = {
            "version": schema.version(),
            "chain_id": chain_id,
            "genesis_hash": genesis_hash,
            "contracts": self._contracts,
        }
        self.genesis_hash = genesis_hash
        self._url = url
        _set_aside_if_damaged(url)
        try:
            self._engine = open_database(url, schema_name)
            self._make_tables()
            rows = self._rows(select(schema.cursor))
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
        return int(self._scalar(_PUBLISHED_SEQ))

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
            projection = Projection(rows, self._contracts, self._currency)
            projection.prepare(timed.log for timed in logs)
            for seq, timed in enumerate(logs, start=last + 1):
                rows.block, rows.undoable = timed.log.block, timed.log.block > final
                projection.apply(seq, timed.log, timed.time_s)
                applied.append(_dao_event(seq, timed, self.genesis_hash, self._currency))
            rows.write()
            if applied:
                connection.execute(_ADD_EVENTS, [_event_row(event) for event in applied])
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
        blocks = self._rows(select(schema.blocks).order_by(schema.blocks.c.number.desc()))
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
            connection.execute(delete(schema.receipts))
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
            for row in self._rows(query.limit(limit))
        ]

    def newest_transaction(self) -> str | None:
        """The last one with events of the contracts that is still on the chain."""
        return self._scalar(_NEWEST_TRANSACTION)

    def last_seq(self) -> int:
        return self._scalar(_NEWEST_SEQ) or 0

    # Questions --------------------------------------------------------------------------------------------

    def tasks(
        self,
        filters: Mapping[str, Any],
        page: Page,
        *,
        states: Sequence[str] = (),
        text: str | None = None,
        newest_first: bool = True,
    ) -> tuple[list[Row], int]:
        """Tasks whose columns equal `filters`, and how many there are in all."""
        tasks = schema.tasks.c
        conditions = [tasks[name] == value for name, value in filters.items()]
        if states:
            conditions.append(tasks.state.in_(states))
        if text:
            conditions.append(tasks.text.contains(text.lower(), autoescape=True))
        order = tasks.id.desc() if newest_first else tasks.id
        return self._page(select(schema.tasks).where(*conditions).order_by(order), page)

    def task(self, task_id: int) -> Row | None:
        return self._first(select(schema.tasks).where(schema.tasks.c.id == task_id))

    def in_escrow(self, creator: str) -> int:
        """Wei of IECoin that the tasks of `creator` hold."""
        tasks = schema.tasks.c
        held = select(tasks.reward).where(tasks.creator == creator, tasks.state.in_(LIVE_STATES))
        return sum(row["reward"] for row in self._rows(held))

    def in_state(self, state: str) -> list[Row]:
        """All such tasks."""
        return self._rows(select(schema.tasks).where(schema.tasks.c.state == state))

    def overdue(self, now_s: float) -> list[int]:
        """Ids of the tasks that were assigned and whose execution window ended before `now_s`."""
        tasks = schema.tasks.c
        late = select(tasks.id).where(tasks.state == "assigned", now_s > _EXECUTION_END)
        return [row["id"] for row in self._rows(late)]

    def concludable(self, now_s: float) -> list[int]:
        """Ids of the tasks on which nobody ruled, or another ruling could be made, before `now_s`, and of
        those on which a judge ruled that was removed since."""
        tasks, numbers = schema.tasks.c, schema.numbers.c
        removed = select(numbers.number).where(numbers.removed)
        due = select(tasks.id).where(
            ((tasks.state == "submitted") & (tasks.verdict_deadline < now_s))
            | (tasks.standing_until < now_s)
            | ((tasks.state == "ruled") & ~tasks.after_removal & tasks.number.in_(removed))
        )
        return [row["id"] for row in self._rows(due)]

    def settleable(self, now_s: float) -> list[tuple[int, int]]:
        """(Task, attempt) of the cases whose stakes can be freed or paid since before `now_s`."""
        cases, numbers = schema.cases.c, schema.numbers.c
        removed = select(numbers.number).where(numbers.removed)
        due = select(cases.task_id, cases.attempt).where(
            cases.staked, ~cases.settled, (cases.until < now_s) | cases.number.in_(removed)
        )
        return [(row["task_id"], row["attempt"]) for row in self._rows(due)]

    def unconcluded(self) -> list[Row]:
        """The tasks whose proof waits for a ruling, or has one that stands."""
        return self._rows(select(schema.tasks).where(schema.tasks.c.state.in_(("submitted", "ruled"))))

    def late_verdicts(self, now_s: float) -> list[int]:
        """Ids of the submitted tasks of whose verdict window more than half had passed at `now_s`."""
        tasks = schema.tasks.c
        half_s = tasks.verdict_deadline - tasks.verdict_window_s / 2
        late = select(tasks.id).where(tasks.state == "submitted", half_s < now_s).order_by(tasks.id)
        return [row["id"] for row in self._rows(late)]

    def next_end_s(self, now_s: float) -> float | None:
        """When the first window that runs at `now_s` ends; None where none does."""
        tasks, cases = schema.tasks.c, schema.cases.c
        ends = [
            select(func.min(end).label("end")).where(running, end >= now_s)
            for running, end in (
                (tasks.state == "assigned", _EXECUTION_END),
                (tasks.state == "submitted", tasks.verdict_deadline),
                (tasks.state == "ruled", tasks.standing_until),
                (cases.staked & ~cases.settled, cases.until),
            )
        ]
        found = [row["end"] for one in ends for row in self._rows(one)]
        return min((float(end) for end in found if end is not None), default=None)

    def task_counts(self, column: str) -> dict[str, dict[str, int]]:
        """Address in `column` (creator, executor) -> state -> number of tasks."""
        who, state = schema.tasks.c[column], schema.tasks.c.state
        counts: dict[str, dict[str, int]] = {}
        for row in self._rows(
            select(who.label("who"), state, func.count().label("number"))
            .where(who.is_not(None))
            .group_by(who, state)
        ):
            counts.setdefault(row["who"], {})[row["state"]] = row["number"]
        return counts

    def task_times(self, first_s: float, last_s: float) -> list[Row]:
        """When tasks were registered and ended, and what they cost: those that did so in between."""
        tasks = schema.tasks.c
        columns = (tasks.kind, tasks.state, tasks.registered, tasks.assigned, tasks.proof_submitted)
        return self._rows(
            select(*columns, tasks.settled, tasks.ended, tasks.paid).where(
                or_(tasks.registered.between(first_s, last_s), tasks.ended.between(first_s, last_s))
            )
        )

    def services(self, filters: Mapping[str, Any], page: Page) -> tuple[list[Row], int]:
        conditions = [schema.services.c[name] == value for name, value in filters.items()]
        return self._page(select(schema.services).where(*conditions).order_by(schema.services.c.id), page)

    def service(self, service_id: int) -> Row | None:
        return self._first(select(schema.services).where(schema.services.c.id == service_id))

    def providers(self) -> dict[str, Row]:
        """Address -> what counts for all services of an account."""
        return {row["address"]: row for row in self._rows(select(schema.providers))}

    def payouts(self) -> dict[str, str]:
        """Address -> who is paid for its work, of accounts that have named another one."""
        return {address: row["payout"] for address, row in self.providers().items() if row["payout"]}

    def idle(self) -> list[Row]:
        """Active services that do nothing: they wait in line, or have stood back (`place` is 0)."""
        services = schema.services.c
        idle = (services.state == "active") & services.task_id.is_(None)
        return self._rows(select(schema.services).where(idle).order_by(services.id))

    def locked_bonds(self) -> list[Row]:
        """Services that are over and whose bond was not returned yet."""
        services = schema.services.c
        over = (services.state == "retired") & services.task_id.is_(None) & (services.bond != 0)
        return self._rows(select(schema.services).where(over).order_by(services.id))

    def engaged(self) -> set[str]:
        """Addresses of providers with a service that works or waits."""
        services = schema.services.c
        busy = services.task_id.is_not(None) | (services.place > 0)
        return {row["provider"] for row in self._rows(select(services.provider).where(busy).distinct())}

    def is_asleep(self, provider: str) -> bool:
        """Whether this account has to wake up before it offers anything."""
        found = self._first(select(schema.providers).where(schema.providers.c.address == provider))
        return found is not None and found["asleep_until"] is not None

    def offers(self, provider: str, kind: str) -> list[Row]:
        """The services of `kind` that the account at `provider` has not retired."""
        services = schema.services.c
        mine = (services.provider == provider) & (services.kind == kind) & (services.state != "retired")
        return self._rows(select(schema.services).where(mine).order_by(services.id))

    def active_prices(self, kind: str) -> list[int]:
        """What the services of `kind` cost that take tasks which its present judge decides about, wei."""
        services, number = schema.services.c, self.number_of(kind)
        active = (services.kind == kind) & (services.number == number) & (services.state == "active")
        return [row["price"] for row in self._rows(select(services.price).where(active))]

    def kinds(self) -> list[str]:
        """The kinds of work that the organization accepts."""
        query = select(schema.kinds.c.kind).where(schema.kinds.c.allowed).order_by(schema.kinds.c.kind)
        return [row["kind"] for row in self._rows(query)]

    def rules(self, kind: str, judge: str | None = None) -> list[str]:
        """Hashes of the rules under which tasks of a kind may be posted, the newest last; none where somebody
        else judges it than the contract at `judge`."""
        number = self.numbers().get(self.number_of(kind))
        if judge is not None and (number is None or number["removed"] or number["judge"] != judge):
            return []
        return list(
            self._scalar(select(schema.kinds.c.rules_sha256).where(schema.kinds.c.kind == kind)) or []
        )

    def number_of(self, kind: str) -> int:
        """Number of the kind with its present judge; 0 where it never had one."""
        return int(self._scalar(select(schema.kinds.c.number).where(schema.kinds.c.kind == kind)) or 0)

    def numbers(self) -> dict[int, Row]:
        """Number of a kind with a judge -> that judge, and whether it was removed."""
        return {row["number"]: row for row in self._rows(select(schema.numbers))}

    def voids(self) -> dict[str, dict[str, int]]:
        """Creator -> whose doing -> number of its tasks that ended void."""
        tasks = schema.tasks.c
        counts: dict[str, dict[str, int]] = {}
        for row in self._rows(
            select(tasks.creator, tasks.fault, func.count().label("number"))
            .where(tasks.verdict == "void")
            .group_by(tasks.creator, tasks.fault)
        ):
            counts.setdefault(row["creator"], {})[row["fault"]] = row["number"]
        return counts

    def recent_voids(self, last: int) -> dict[str | None, tuple[int, dict[str, int]]]:
        """Creator, None for all -> how many of its last tasks ended by a ruling, at most `last`, and whose
        doing -> how many of them ended void."""
        tasks = schema.tasks.c
        ended = tasks.verdict.in_(get_args(Ruling)) & tasks.ended.is_not(None)
        order = (tasks.ended.desc(), tasks.id.desc())
        counts: dict[str | None, tuple[int, dict[str, int]]] = {}
        for parted, creator in ((tasks.creator, tasks.creator), (None, null())):
            number = func.row_number().over(partition_by=parted, order_by=order).label("number")
            newest = (
                select(creator.label("creator"), tasks.verdict, tasks.fault, number).where(ended).subquery()
            )
            of = newest.c
            for row in self._rows(
                select(of.creator, of.verdict, of.fault, func.count().label("tasks"))
                .where(of.number <= last)
                .group_by(of.creator, of.verdict, of.fault)
            ):
                rulings, voids = counts.get(row["creator"], (0, {}))
                if row["verdict"] == "void":
                    voids[row["fault"]] = voids.get(row["fault"], 0) + row["tasks"]
                counts[row["creator"]] = rulings + row["tasks"], voids
        return counts

    def kind(self, kind: str) -> Row | None:
        return self._first(select(schema.kinds).where(schema.kinds.c.kind == kind))

    def all_kinds(self) -> list[Row]:
        return self._rows(select(schema.kinds).order_by(schema.kinds.c.kind))

    def setting(self, name: str) -> Any:
        """What the organization's events last said about `name`; None when they never did."""
        row = self._first(select(schema.settings).where(schema.settings.c.name == name))
        return row and row["value"]

    def roles(self) -> dict[str, list[str]]:
        """Role -> addresses that hold it."""
        held: dict[str, list[str]] = {}
        for row in self._rows(select(schema.roles).where(schema.roles.c.held)):
            held.setdefault(row["role"], []).append(row["address"])
        return held

    def judges(self) -> list[Row]:
        """The judges of the committee of oracles, by their seats, each with its name in the device
        registry, if it has one."""
        judges, devices = schema.judges.c, schema.devices.c
        named = schema.judges.outerjoin(schema.devices, judges.first_key == devices.address)
        query = select(schema.judges, devices.name).select_from(named)
        return self._rows(query.where(judges.committee == ORACLES).order_by(judges.seat))

    def challenge_judges(self, committee: str) -> list[Row]:
        """The judges of a committee that decides about challenges, by their seats."""
        judges = schema.judges.c
        query = select(schema.judges).where(judges.committee == committee).order_by(judges.seat)
        return self._rows(query)

    def challenge_kinds(self, committee: str) -> list[Row]:
        """The kinds that it decides about."""
        kinds = schema.challenge_kinds.c
        query = select(schema.challenge_kinds).where(kinds.committee == committee, kinds.votes > 0)
        return self._rows(query.order_by(kinds.kind))

    def devices(self) -> list[Row]:
        return self._rows(select(schema.devices).order_by(schema.devices.c.registered))

    def roots(self, device: str | None, page: Page) -> tuple[list[Row], int]:
        """What was fixed of days, the newest first."""
        roots = schema.roots.c
        conditions = [] if device is None else [roots.device == device]
        query = select(schema.roots).where(*conditions).order_by(roots.day.desc(), roots.device)
        return self._page(query, page)

    def proposals(self, page: Page) -> tuple[list[Row], int]:
        """The newest first, each with its `ballots`."""
        proposals = schema.proposals.c
        made = select(schema.proposals).where(proposals.number.is_not(None))
        rows, total = self._page(made.order_by(proposals.number.desc()), page)
        cast = self._rows(
            select(schema.ballots).where(schema.ballots.c.proposal.in_([row["id"] for row in rows]))
        )
        return [
            {**row, "ballots": [one for one in cast if one["proposal"] == row["id"]]} for row in rows
        ], total

    def proposal(self, number: int) -> Row | None:
        return self._first(select(schema.proposals).where(schema.proposals.c.number == number))

    def proposal_number(self, key: str) -> int | None:
        """Number of the proposal with this id in hex."""
        return self._scalar(select(schema.proposals.c.number).where(schema.proposals.c.id == key))

    def budget_votes(self, page: Page, number: int | None = None) -> tuple[list[Row], int]:
        """The newest first, or the one with this number, each with its `ballots`."""
        table, ballots = schema.budget_votes, schema.budget_ballots
        conditions = [] if number is None else [table.c.number == number]
        rows, total = self._page(select(table).where(*conditions).order_by(table.c.number.desc()), page)
        numbers = [row["number"] for row in rows]
        cast = self._rows(select(ballots).where(ballots.c.budget_vote.in_(numbers)).order_by(ballots.c.voter))
        return [
            {**row, "ballots": [one for one in cast if one["budget_vote"] == row["number"]]} for row in rows
        ], total

    def budget_vote(self, number: int) -> Row | None:
        return self._first(select(schema.budget_votes).where(schema.budget_votes.c.number == number))

    def balances(self) -> dict[str, int]:
        """Address -> wei of IECoin, of everyone who ever had any."""
        return {row["address"]: row["balance"] for row in self._rows(select(schema.balances))}

    def owed(self) -> dict[str, int]:
        """Address -> wei that the token refused to it and `collect` pays."""
        return {row["address"]: row["owed"] for row in self._rows(select(schema.balances)) if row["owed"]}

    def balance(self, address: str) -> int:
        return int(self._scalar(_BALANCE, {"address": address}) or 0)

    def transfers(
        self, account: str | None, task_id: int | None, first_s: float, last_s: float, page: Page
    ) -> tuple[list[Row], int]:
        """What went to or from `account`, the newest first."""
        transfers = schema.transfers.c
        conditions: list[Any] = [transfers.time_s.between(first_s, last_s)]
        if account is not None:
            conditions.append(or_(transfers.sender == account, transfers.to == account))
        if task_id is not None:
            conditions.append(transfers.task_id == task_id)
        query = select(schema.transfers).where(*conditions).order_by(transfers.seq.desc())
        return self._page(query, page)

    def transactions(self, task_id: int | None, page: Page) -> tuple[list[Row], int]:
        """Transactions with events of the contracts, the newest first, with their receipts where known."""
        events = schema.events.c
        conditions = [~events.undone]
        if task_id is not None:
            conditions.append(events.task_id == task_id)
        newest = func.max(events.seq).label("seq")
        query = (
            select(
                events.tx_hash,
                func.max(events.block).label("block"),
                func.max(events.time_s).label("time_s"),
                newest,
            )
            .where(*conditions)
            .group_by(events.tx_hash)
            .order_by(newest.desc())
        )
        rows, total = self._page(query, page)
        hashes = [row["tx_hash"] for row in rows]
        details: dict[str, Row] = {tx_hash: {"events": [], "task_ids": []} for tx_hash in hashes}
        for row in self._rows(
            select(events.tx_hash, events.name, events.task_id)
            .where(events.tx_hash.in_(hashes), ~events.undone)
            .order_by(events.seq)
        ):
            details[row["tx_hash"]]["events"].append(row["name"])
            if row["task_id"] is not None and row["task_id"] not in details[row["tx_hash"]]["task_ids"]:
                details[row["tx_hash"]]["task_ids"].append(row["task_id"])
        receipts = {
            row["tx_hash"]: row
            for row in self._rows(select(schema.receipts).where(schema.receipts.c.tx_hash.in_(hashes)))
        }
        return [
            {**row, **details[row["tx_hash"]], "receipt": receipts.get(row["tx_hash"])} for row in rows
        ], total

    def keep_receipts(self, receipts: Iterable[Row]) -> None:
        """Remember what transactions cost."""
        rows = list(receipts)
        if rows:
            with self._engine.begin() as connection:
                connection.execute(upsert(self._engine, schema.receipts), rows)

    def _page(self, query: Select[Any], page: Page) -> tuple[list[Row], int]:
        total = self._scalar(select(func.count()).select_from(query.order_by(None).subquery()))
        return self._rows(query.limit(page.limit).offset(page.offset)), int(total or 0)

    def _first(self, query: Select[Any]) -> Row | None:
        rows = self._rows(query)
        return rows[0] if rows else None

    def _scalar(self, query: Select[Any], parameters: Row | None = None) -> Any:
        with self._engine.connect() as connection:
            return connection.scalar(query, parameters)

    def _rows(self, query: Select[Any]) -> list[Row]:
        with self._engine.connect() as connection:
            return [dict(row) for row in connection.execute(query).mappings()]


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
_BALANCE = select(schema.balances.c.balance).where(schema.balances.c.address == bindparam("address"))

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
    """Events of the committees do not say of which of them they are: its address is added."""
    args = event_args(log.event, currency)
    return {**args, "committee": log.contract} if isinstance(log.event, _OF_COMMITTEES) else args


def _event_row(event: DaoEvent, undone: bool = False) -> Row:
    return {**{name: getattr(event, name) for name in _OF_EVENT}, "undone": undone}


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
