"""What the bridge's index answers, by subject: tasks, services, rules, votes and money."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from sqlalchemy import Engine, Select, Table, and_, bindparam, case, func, or_, select, union, update

from rodeo.bus.messages import LIVE_STATES, Ruling
from rodeo.chain.artifacts import ORACLES
from services.bridge import schema

Row = dict[str, Any]

_EXECUTION_END = case(
    (
        schema.tasks.c.accepted.is_(False),
        schema.tasks.c.execution_deadline - schema.tasks.c.execution_window_s + schema.tasks.c.grace_s,
    ),
    else_=schema.tasks.c.execution_deadline,
)
"""Time (s) after which anybody may expire an assigned task. An attempt that nobody accepted ends earlier."""
EVER_S = 0, 2**48
"""Times (s) that leave nothing out."""
_BALANCE = select(schema.balances.c.balance).where(schema.balances.c.address == bindparam("address"))
_KEEP_RECEIPT = (
    update(schema.transactions)
    .where(schema.transactions.c.tx_hash == bindparam("of"))
    .values({name: bindparam(name) for name in ("sender", "gas_used", "gas_price")})
)


@dataclass(frozen=True)
class Page:
    limit: int
    offset: int = 0


class Reader:
    """Reads the tables of the index; any thread may."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    def page(self, table: Table, conditions: Sequence[Any], page: Page, *order: Any) -> tuple[list[Row], int]:
        """The rows of one page, and how many there are in all."""
        # Keys are chosen in an index, and then few rows are read: those of tasks are long.
        keys = [*table.primary_key]
        chosen = select(*keys).where(*conditions).order_by(*order).limit(page.limit).offset(page.offset)
        wanted = chosen.subquery()
        of = and_(*(one == wanted.c[one.name] for one in keys))
        return self.rows(select(table).join(wanted, of).order_by(*order)), self.count(table, conditions)

    def count(self, table: Table, conditions: Sequence[Any]) -> int:
        return int(self.scalar(select(func.count()).select_from(table).where(*conditions)) or 0)

    def first(self, query: Select[Any]) -> Row | None:
        rows = self.rows(query)
        return rows[0] if rows else None

    def scalar(self, query: Select[Any], parameters: Row | None = None) -> Any:
        with self.engine.connect() as connection:
            return connection.scalar(query, parameters)

    def rows(self, query: Select[Any]) -> list[Row]:
        with self.engine.connect() as connection:
            return [dict(row) for row in connection.execute(query).mappings()]


class Tasks(Reader):
    """Tasks, their windows and how they ended."""

    def find(
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
        order = tasks.id.desc() if newest_first else tasks.id
        if not text:
            return self.page(schema.tasks, conditions, page, order)
        texts = schema.texts.c
        said = texts.text.contains(text.lower(), autoescape=True)
        if conditions:
            found = select(texts.task_id).where(said)
            return self.page(schema.tasks, [*conditions, tasks.id.in_(found)], page, order)
        # Both the count and the page are known without the tasks.
        own = texts.task_id.desc() if newest_first else texts.task_id
        named, total = self.page(schema.texts, [said], page, own)
        wanted = tasks.id.in_([one["task_id"] for one in named])
        return self.rows(select(schema.tasks).where(wanted).order_by(order)), total

    def get(self, task_id: int) -> Row | None:
        return self.first(select(schema.tasks).where(schema.tasks.c.id == task_id))

    def in_escrow(self, creator: str) -> int:
        """Wei of IECoin that the tasks of `creator` hold."""
        tasks = schema.tasks.c
        held = select(tasks.reward).where(tasks.creator == creator, tasks.state.in_(LIVE_STATES))
        return sum(row["reward"] for row in self.rows(held))

    def in_state(self, state: str) -> list[Row]:
        """All such tasks."""
        return self.rows(select(schema.tasks).where(schema.tasks.c.state == state))

    def overdue(self, now_s: float) -> list[int]:
        """Ids of the tasks that were assigned and whose execution window ended before `now_s`."""
        tasks = schema.tasks.c
        late = select(tasks.id).where(tasks.state == "assigned", now_s > _EXECUTION_END)
        return [row["id"] for row in self.rows(late)]

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
        return [row["id"] for row in self.rows(due)]

    def settleable(self, now_s: float) -> list[tuple[int, int]]:
        """(Task, attempt) of the cases whose stakes can be freed or paid since before `now_s`."""
        cases, numbers = schema.cases.c, schema.numbers.c
        removed = select(numbers.number).where(numbers.removed)
        due = select(cases.task_id, cases.attempt).where(
            cases.staked, ~cases.settled, (cases.until < now_s) | cases.number.in_(removed)
        )
        return [(row["task_id"], row["attempt"]) for row in self.rows(due)]

    def unconcluded(self) -> list[Row]:
        """The tasks whose proof waits for a ruling, or has one that stands."""
        return self.rows(select(schema.tasks).where(schema.tasks.c.state.in_(("submitted", "ruled"))))

    def late_verdicts(self, now_s: float) -> list[int]:
        """Ids of the submitted tasks of whose verdict window more than half had passed at `now_s`."""
        tasks = schema.tasks.c
        half_s = tasks.verdict_deadline - tasks.verdict_window_s / 2
        late = select(tasks.id).where(tasks.state == "submitted", half_s < now_s).order_by(tasks.id)
        return [row["id"] for row in self.rows(late)]

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
        found = [row["end"] for one in ends for row in self.rows(one)]
        return min((float(end) for end in found if end is not None), default=None)

    def counts(self, column: str) -> dict[str, dict[str, int]]:
        """Address in `column` (creator, executor) -> state -> number of tasks."""
        who, state = schema.tasks.c[column], schema.tasks.c.state
        counts: dict[str, dict[str, int]] = {}
        for row in self.rows(
            select(who.label("who"), state, func.count().label("number"))
            .where(who.is_not(None))
            .group_by(who, state)
        ):
            counts.setdefault(row["who"], {})[row["state"]] = row["number"]
        return counts

    def times(self, first_s: float, last_s: float) -> list[Row]:
        """When tasks were registered and ended, and what they cost: those that did so in between."""
        tasks = schema.tasks.c
        columns = (tasks.kind, tasks.state, tasks.registered, tasks.assigned, tasks.proof_submitted)
        return self.rows(
            select(*columns, tasks.settled, tasks.ended, tasks.paid).where(
                or_(tasks.registered.between(first_s, last_s), tasks.ended.between(first_s, last_s))
            )
        )

    def voids(self) -> dict[str, dict[str, int]]:
        """Creator -> whose doing -> number of its tasks that ended void."""
        tasks = schema.tasks.c
        counts: dict[str, dict[str, int]] = {}
        for row in self.rows(
            select(tasks.creator, tasks.fault, func.count().label("number"))
            .where(tasks.verdict == "void")
            .group_by(tasks.creator, tasks.fault)
        ):
            counts.setdefault(row["creator"], {})[row["fault"]] = row["number"]
        return counts

    def recent_voids(self, last: int) -> dict[str | None, tuple[int, dict[str, int]]]:
        """Creator of a task that ended void, None for all -> how many of its last tasks ended by a ruling, at
        most `last`, and whose doing -> how many of them ended void."""
        tasks = schema.tasks.c
        # An expression, as the index of verdicts would find all tasks that ended, in no order.
        ruled = (func.coalesce(tasks.verdict, "").in_(get_args(Ruling)), tasks.ended.is_not(None))
        counts: dict[str | None, tuple[int, dict[str, int]]] = {}
        for creator in (None, *self.voids()):
            of = [] if creator is None else [tasks.creator == creator]
            newest = select(tasks.verdict, tasks.fault).where(*of, *ruled)
            rows = self.rows(newest.order_by(tasks.ended.desc(), tasks.id.desc()).limit(last))
            if rows:
                faults = Counter(row["fault"] for row in rows if row["verdict"] == "void")
                counts[creator] = len(rows), dict(faults)
        return counts


class Services(Reader):
    """Services and the accounts that offer them."""

    def find(self, filters: Mapping[str, Any], page: Page) -> tuple[list[Row], int]:
        conditions = [schema.services.c[name] == value for name, value in filters.items()]
        return self.page(schema.services, conditions, page, schema.services.c.id)

    def get(self, service_id: int) -> Row | None:
        return self.first(select(schema.services).where(schema.services.c.id == service_id))

    def providers(self) -> dict[str, Row]:
        """Address -> what counts for all services of an account."""
        return {row["address"]: row for row in self.rows(select(schema.providers))}

    def payouts(self) -> dict[str, str]:
        """Address -> who is paid for its work, of accounts that have named another one."""
        return {address: row["payout"] for address, row in self.providers().items() if row["payout"]}

    def idle(self) -> list[Row]:
        """Active services that do nothing: they wait in line, or have stood back (`place` is 0)."""
        services = schema.services.c
        idle = (services.state == "active") & services.task_id.is_(None)
        return self.rows(select(schema.services).where(idle).order_by(services.id))

    def locked_bonds(self) -> list[Row]:
        """Services that are over and whose bond was not returned yet."""
        services = schema.services.c
        over = (services.state == "retired") & services.task_id.is_(None) & (services.bond != 0)
        return self.rows(select(schema.services).where(over).order_by(services.id))

    def engaged(self) -> set[str]:
        """Addresses of providers with a service that works or waits."""
        services = schema.services.c
        busy = services.task_id.is_not(None) | (services.place > 0)
        return {row["provider"] for row in self.rows(select(services.provider).where(busy).distinct())}

    def is_asleep(self, provider: str) -> bool:
        """Whether this account has to wake up before it offers anything."""
        found = self.first(select(schema.providers).where(schema.providers.c.address == provider))
        return found is not None and found["asleep_until"] is not None

    def offers(self, provider: str, kind: str) -> list[Row]:
        """The services of `kind` that the account at `provider` has not retired."""
        services = schema.services.c
        mine = (services.provider == provider) & (services.kind == kind) & (services.state != "retired")
        return self.rows(select(schema.services).where(mine).order_by(services.id))

    def active_prices(self, kind: str) -> list[int]:
        """Prices (wei) of the active services of `kind` that agreed to its present judge."""
        services, number = schema.services.c, Rules(self.engine).number_of(kind)
        active = (services.kind == kind) & (services.number == number) & (services.state == "active")
        return [row["price"] for row in self.rows(select(services.price).where(active))]


class Rules(Reader):
    """Kinds, judges, roles, settings and devices of the organization."""

    def kinds(self) -> list[str]:
        """The kinds of work that the organization accepts."""
        query = select(schema.kinds.c.kind).where(schema.kinds.c.allowed).order_by(schema.kinds.c.kind)
        return [row["kind"] for row in self.rows(query)]

    def of(self, kind: str, judge: str | None = None) -> list[str]:
        """Hashes of the rules under which tasks of a kind may be posted, the newest last; none where somebody
        else judges it than the contract at `judge`."""
        number = self.numbers().get(self.number_of(kind))
        if judge is not None and (number is None or number["removed"] or number["judge"] != judge):
            return []
        return list(self.scalar(select(schema.kinds.c.rules_sha256).where(schema.kinds.c.kind == kind)) or [])

    def number_of(self, kind: str) -> int:
        """Number of the kind with its present judge; 0 where it never had one."""
        return int(self.scalar(select(schema.kinds.c.number).where(schema.kinds.c.kind == kind)) or 0)

    def numbers(self) -> dict[int, Row]:
        """Number of a kind with a judge -> that judge, and whether it was removed."""
        return {row["number"]: row for row in self.rows(select(schema.numbers))}

    def kind(self, kind: str) -> Row | None:
        return self.first(select(schema.kinds).where(schema.kinds.c.kind == kind))

    def all_kinds(self) -> list[Row]:
        return self.rows(select(schema.kinds).order_by(schema.kinds.c.kind))

    def setting(self, name: str) -> Any:
        """What the organization's events last said about `name`; None when they never did."""
        row = self.first(select(schema.settings).where(schema.settings.c.name == name))
        return row and row["value"]

    def roles(self) -> dict[str, list[str]]:
        """Role -> addresses that hold it."""
        held: dict[str, list[str]] = {}
        for row in self.rows(select(schema.roles).where(schema.roles.c.held)):
            held.setdefault(row["role"], []).append(row["address"])
        return held

    def judges(self) -> list[Row]:
        """The judges of the committee of oracles, by their seats, each with its name in the device
        registry, if it has one."""
        judges, devices = schema.judges.c, schema.devices.c
        named = schema.judges.outerjoin(schema.devices, judges.first_key == devices.address)
        query = select(schema.judges, devices.name).select_from(named)
        return self.rows(query.where(judges.committee == ORACLES).order_by(judges.seat))

    def challenge_judges(self, committee: str) -> list[Row]:
        """The judges of a committee that decides about challenges, by their seats."""
        judges = schema.judges.c
        query = select(schema.judges).where(judges.committee == committee).order_by(judges.seat)
        return self.rows(query)

    def challenge_kinds(self, committee: str) -> list[Row]:
        """The kinds that it decides about."""
        kinds = schema.challenge_kinds.c
        query = select(schema.challenge_kinds).where(kinds.committee == committee, kinds.votes > 0)
        return self.rows(query.order_by(kinds.kind))

    def devices(self) -> list[Row]:
        return self.rows(select(schema.devices).order_by(schema.devices.c.registered))

    def roots(self, device: str | None, page: Page) -> tuple[list[Row], int]:
        """What was fixed of days, the newest first."""
        roots = schema.roots.c
        conditions = [] if device is None else [roots.device == device]
        return self.page(schema.roots, conditions, page, roots.day.desc(), roots.device)


class Votes(Reader):
    """Proposals and budget votes."""

    def proposals(self, page: Page) -> tuple[list[Row], int]:
        """The newest first, each with its `ballots`."""
        proposals = schema.proposals.c
        rows, total = self.page(
            schema.proposals, [proposals.number.is_not(None)], page, proposals.number.desc()
        )
        cast = self.rows(
            select(schema.ballots).where(schema.ballots.c.proposal.in_([row["id"] for row in rows]))
        )
        return [
            {**row, "ballots": [one for one in cast if one["proposal"] == row["id"]]} for row in rows
        ], total

    def proposal(self, number: int) -> Row | None:
        return self.first(select(schema.proposals).where(schema.proposals.c.number == number))

    def proposal_number(self, key: str) -> int | None:
        """Number of the proposal with this id in hex."""
        return self.scalar(select(schema.proposals.c.number).where(schema.proposals.c.id == key))

    def budget_votes(self, page: Page, number: int | None = None) -> tuple[list[Row], int]:
        """The newest first, or the one with this number, each with its `ballots`."""
        table, ballots = schema.budget_votes, schema.budget_ballots
        conditions = [] if number is None else [table.c.number == number]
        rows, total = self.page(table, conditions, page, table.c.number.desc())
        numbers = [row["number"] for row in rows]
        cast = self.rows(select(ballots).where(ballots.c.budget_vote.in_(numbers)).order_by(ballots.c.voter))
        return [
            {**row, "ballots": [one for one in cast if one["budget_vote"] == row["number"]]} for row in rows
        ], total

    def budget_vote(self, number: int) -> Row | None:
        return self.first(select(schema.budget_votes).where(schema.budget_votes.c.number == number))


class Money(Reader):
    """Balances, transfers and transactions."""

    def balances(self) -> dict[str, int]:
        """Address -> wei of IECoin, of everyone who ever had any."""
        return {row["address"]: row["balance"] for row in self.rows(select(schema.balances))}

    def owed(self) -> dict[str, int]:
        """Address -> wei that the token refused to it and `collect` pays."""
        return {row["address"]: row["owed"] for row in self.rows(select(schema.balances)) if row["owed"]}

    def balance(self, address: str) -> int:
        return int(self.scalar(_BALANCE, {"address": address}) or 0)

    def transfers(
        self, account: str | None, task_id: int | None, first_s: float, last_s: float, page: Page
    ) -> tuple[list[Row], int]:
        """What went to or from `account`, the newest first."""
        transfers = schema.transfers.c
        conditions: list[Any] = [] if task_id is None else [transfers.task_id == task_id]
        if (first_s, last_s) != EVER_S:
            conditions.append(transfers.time_s.between(first_s, last_s))
        newest = transfers.seq.desc()
        if account is None:
            return self.page(schema.transfers, conditions, page, newest)
        sent, received = [*conditions, transfers.sender == account], [*conditions, transfers.to == account]
        # Each of both has an index in which they lie in order.
        most = page.limit + page.offset
        either = [select(transfers.seq).where(*one).order_by(newest).limit(most) for one in (sent, received)]
        found = [select(one.subquery().c.seq) for one in either]
        rows, _ = self.page(schema.transfers, [transfers.seq.in_(union(*found))], page, newest)
        both = self.count(schema.transfers, [*sent, transfers.to == account])
        return rows, self.count(schema.transfers, sent) + self.count(schema.transfers, received) - both

    def transactions(self, task_id: int | None, page: Page) -> tuple[list[Row], int]:
        """Transactions with events of the contracts, the newest first, with their receipts where known."""
        events, transactions = schema.events.c, schema.transactions.c
        about = select(events.tx_hash).where(events.task_id == task_id)
        conditions = [] if task_id is None else [transactions.tx_hash.in_(about)]
        rows, total = self.page(schema.transactions, conditions, page, transactions.seq.desc())
        told: dict[str, Row] = {row["tx_hash"]: {"events": [], "task_ids": []} for row in rows}
        named = select(events.tx_hash, events.name, events.task_id)
        for row in self.rows(named.where(events.tx_hash.in_(told), ~events.undone).order_by(events.seq)):
            told[row["tx_hash"]]["events"].append(row["name"])
            if row["task_id"] is not None and row["task_id"] not in told[row["tx_hash"]]["task_ids"]:
                told[row["tx_hash"]]["task_ids"].append(row["task_id"])
        return [row | told[row["tx_hash"]] for row in rows], total

    def keep_receipts(self, receipts: Iterable[Row]) -> None:
        """Remember what transactions cost."""
        if rows := [{**one, "of": one.pop("tx_hash")} for one in map(dict, receipts)]:
            with self.engine.begin() as connection:
                connection.execute(_KEEP_RECEIPT, rows)
