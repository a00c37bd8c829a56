"""What the wallets are about to send, written down first, so that a crash neither loses nor doubles it.

One SQLite file per chain, whatever database the index is in. A transaction is `sent` from the moment it is
signed; it is `mined` or `failed` when its outcome is known, and its reply is kept for callers that repeat the
same request_id. `dropped`: it can never be mined any more.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import rlp
from eth_account.typed_transactions import TypedTransaction
from hexbytes import HexBytes
from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    Connection,
    Engine,
    Float,
    Integer,
    LargeBinary,
    MetaData,
    Row,
    String,
    Table,
    UniqueConstraint,
    bindparam,
    func,
    insert,
    select,
    update,
)
from sqlalchemy.exc import DBAPIError

from services.bridge.database import damage, open_database, upgrade, upsert
from services.bridge.errors import JournalDamaged, JournalUnwritable
from services.bridge.schema import Wei

_VERSION = 1
"""Version of the tables below: a change of them counts it up. New columns are null in the rows that are
there."""

metadata = MetaData()

_transactions = Table(
    "transactions",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("wallet", String(64), nullable=False, index=True),
    Column("request_id", String(128)),
    Column("command", String(64), nullable=False),
    Column("content_sha256", String(64), nullable=False),
    Column("task_id", BigInteger),
    Column("to", String(42), nullable=False),
    Column("data", LargeBinary, nullable=False),
    Column("nonce", BigInteger),
    Column("max_fee", Wei, doc="per gas, wei"),
    Column("priority_fee", Wei, doc="per gas, wei"),
    Column("fee", Wei, doc="what it costs at most, and did cost once it is mined; wei"),
    Column("spends", Wei, doc="wei of IECoin that leave the wallet"),
    Column("tx_hash", String(66), nullable=False),
    Column("raw", LargeBinary, nullable=False),
    Column("replaced", JSON, doc="hashes of the same transaction with lower fees"),
    Column("state", String(8), nullable=False, index=True),
    Column("attempt", Integer, doc="that a proof is for"),
    Column("assignment", String(66), doc="nonce of the assignment without which it must not be mined"),
    Column("outcome", JSON),
    Column("block", BigInteger, index=True),
    Column("made_s", Float, doc="block time when it was signed"),
    UniqueConstraint("wallet", "request_id"),
)


_accounted = Table(
    "accounted",
    metadata,
    Column("wallet", String(64), primary_key=True),
    Column("nonce", BigInteger, nullable=False, doc="the first that nothing is known of"),
    Column("sent_without", BigInteger, nullable=False, doc="transactions by the deployment step until then"),
    comment="what the wallets have sent, as far as the journal answers for it",
)


class Accounted(NamedTuple):
    """How far the journal accounts for what a wallet has sent."""

    nonce: int
    """The first nonce that the journal knows nothing of."""
    sent_without: int
    """Transactions that the deployment step had sent by then."""


@dataclass(frozen=True)
class Entry:
    """One transaction of a wallet."""

    id: int
    wallet: str
    request_id: str | None
    command: str
    content_sha256: str
    task_id: int | None
    to: str
    data: bytes
    nonce: int
    max_fee: int | None
    priority_fee: int | None
    spends: int | None
    attempt: int | None
    assignment: str | None
    tx_hash: str
    raw: bytes
    replaced: list[str]
    state: str
    """sent, mined, failed, or dropped."""
    outcome: dict[str, Any] | None
    """The reply when mined, the error when failed."""

    @property
    def hashes(self) -> list[str]:
        """Hashes of its versions: any of them may be mined."""
        return [self.tx_hash, *self.replaced]


class Journal:
    """The journal in the file at `path`. Thread-safe. What writes raises JournalUnwritable, and has then
    written nothing. Raises JournalDamaged."""

    def __init__(self, path: Path) -> None:
        self._path = path
        if (problem := damage(path)) is not None:
            raise JournalDamaged(
                "the journal is damaged: restore it from a backup. Or wait until no transaction of the "
                "wallets is pending, and start a new journal with `rodeo up --new-journal`; the bridge then "
                "treats old request_ids as new",
                path=str(path),
                problem=problem,
            )
        # Synced at each commit: a transaction on the chain must be in the journal after a power cut as well.
        self._engine = open_database(f"sqlite:///{path}", durable=True)
        # An outcome that a power cut takes is asked of the node again: it need not wait for the disk.
        self._outcomes = open_database(f"sqlite:///{path}")
        upgrade(self._engine, metadata, _VERSION)

    def find(self, wallet: str, request_id: str) -> Entry | None:
        """The wallet's transaction for this request."""
        found = self._entries((_transactions.c.wallet == wallet) & (_transactions.c.request_id == request_id))
        return found[0] if found else None

    def unfinished(self) -> list[Entry]:
        """The transactions of all wallets whose outcome is not known, the oldest first."""
        return self._entries(_transactions.c.state == "sent")

    def undone(self, block: int) -> list[Entry]:
        """Entries that were mined or failed after `block`: their outcomes do not count any more."""
        return self._entries(_transactions.c.block > block)

    def spent(self, wallet: str, since_s: float, without: Collection[int] = ()) -> tuple[int, int]:
        """Wei of IECoin and wei of fees that `wallet` has spent, or is about to, since then, except for the
        entries `without`, which are remade."""
        c = _transactions.c
        query = select(c.state, c.spends, c.fee).where(
            c.wallet == wallet, c.made_s > since_s, c.state != "dropped", c.id.not_in(without)
        )
        with self._engine.connect() as connection:
            rows = connection.execute(query).all()
        return sum(row.spends or 0 for row in rows if row.state != "failed"), sum(
            row.fee or 0 for row in rows
        )

    def add(self, transactions: Sequence[dict[str, Any]]) -> list[Entry]:
        """Write signed transactions down, all or none; on disk when this returns.

        One with `replaces`, the id of an entry that can never be mined, takes its place and its request_id.
        """
        if not transactions:
            return []
        old = [{"entry_id": one["replaces"]} for one in transactions if "replaces" in one]
        rows = [
            {"state": "sent", "replaced": []} | {name: one[name] for name in one if name != "replaces"}
            for one in transactions
        ]
        with self._writing(self._engine) as connection:
            if old:
                connection.execute(_dropped, old)
            return [_entry(row) for row in connection.execute(_added, rows)]

    def replace(self, entry: Entry, **values: Any) -> Entry:
        """Note the same transaction with a higher fee, before it is sent."""
        with self._writing(self._engine) as connection:
            row = connection.execute(
                update(_transactions)
                .where(_transactions.c.id == entry.id)
                .values(replaced=entry.hashes, **values)
                .returning(_transactions)
            ).one()
        return _entry(row)

    def finish(self, outcomes: Iterable[dict[str, Any]]) -> None:
        """Keep outcomes: `entry_id`, `state` (mined, failed), `outcome` (reply or error), `block`, `fee`."""
        rows = list(outcomes)
        if rows:
            with self._writing(self._outcomes) as connection:
                connection.execute(_finished, rows)

    def forget(self, entry: Entry) -> None:
        """The transaction can never be mined: its request may be made anew."""
        with self._writing(self._engine) as connection:
            connection.execute(_dropped, {"entry_id": entry.id})

    def reopen(self, entries: Sequence[Entry]) -> None:
        """Mark entries that are to be mined again."""
        if entries:
            with self._writing(self._engine) as connection:
                connection.execute(_reopened, [{"entry_id": entry.id} for entry in entries])

    def take_over(self, other: Journal, wallet: str) -> int:
        """Copy what `other` holds of a wallet that another bridge served before; returns how many
        transactions."""
        c = _transactions.c
        mine = {entry.tx_hash for entry in self._entries(c.wallet == wallet)}
        with other._engine.connect() as connection:
            found = connection.execute(
                select(_transactions).where(c.wallet == wallet, c.state != "dropped").order_by(c.id)
            )
            rows = [
                {name: value for name, value in row.items() if name != "id"}
                for row in found.mappings()
                if row["tx_hash"] not in mine
            ]
        if rows:
            with self._writing(self._engine) as connection:
                connection.execute(insert(_transactions), rows)
        return len(rows)

    def free_requests(self, contracts: Collection[str]) -> int:
        """Free the request_ids of transactions to others than `contracts`; returns how many there were.

        Contracts that were redeployed on the same chain know nothing of what was sent to the old ones.
        """
        foreign = _transactions.c.to.not_in(list(contracts)) & _transactions.c.request_id.is_not(None)
        with self._writing(self._engine) as connection:
            return connection.execute(update(_transactions).where(foreign).values(request_id=None)).rowcount

    def newest_nonces(self) -> dict[str, int]:
        """Wallet -> the highest nonce among its transactions that were, or may still be, mined."""
        c = _transactions.c
        kept = c.state != "dropped"
        with self._engine.connect() as connection:
            rows = connection.execute(
                select(c.wallet, func.max(c.nonce)).where(kept, c.nonce.is_not(None)).group_by(c.wallet)
            ).all()
        newest = {wallet: int(nonce) for wallet, nonce in rows}
        for entry in self._entries(kept & c.nonce.is_(None)):
            newest[entry.wallet] = max(newest.get(entry.wallet, 0), entry.nonce)
        return newest

    def accounted(self) -> dict[str, Accounted]:
        """Wallet -> how far the journal answers for it."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(_accounted)).all()
        return {row.wallet: Accounted(row.nonce, row.sent_without) for row in rows}

    def newest_mined(self) -> bytes | None:
        """The last transaction that was mined, as it was sent; None before there is one."""
        c = _transactions.c
        query = select(c.raw).where(c.state == "mined").order_by(c.id.desc()).limit(1)
        with self._engine.connect() as connection:
            return connection.scalar(query)

    def account_for(self, wallets: Mapping[str, Accounted]) -> None:
        """Record how far the journal accounts for each wallet; never less than before."""
        before = self.accounted()
        rows = [
            {"wallet": name, **one._replace(nonce=max(one.nonce, before.get(name, one).nonce))._asdict()}
            for name, one in wallets.items()
        ]
        if rows:
            with self._writing(self._engine) as connection:
                connection.execute(upsert(self._engine, _accounted), rows)

    def count(self, state: str) -> int:
        query = select(func.count()).select_from(_transactions).where(_transactions.c.state == state)
        with self._engine.connect() as connection:
            return connection.scalar(query) or 0

    def close(self) -> None:
        self._outcomes.dispose()
        self._engine.dispose()

    @contextmanager
    def _writing(self, engine: Engine) -> Iterator[Connection]:
        try:
            with engine.begin() as connection:
                yield connection
        except DBAPIError as error:
            raise JournalUnwritable(
                "the journal cannot be written", path=str(self._path), cause=str(error.orig)
            ) from error

    def _entries(self, condition: Any) -> list[Entry]:
        query = select(_transactions).where(condition).order_by(_transactions.c.id)
        with self._engine.connect() as connection:
            return [_entry(row) for row in connection.execute(query)]


_added = insert(_transactions).returning(_transactions, sort_by_parameter_order=True)
_by_id = update(_transactions).where(_transactions.c.id == bindparam("entry_id"))
_dropped = _by_id.values(state="dropped", request_id=None)
_reopened = _by_id.values(state="sent", outcome=None, block=None)
_finished = _by_id.values({name: bindparam(name) for name in ("state", "outcome", "block", "fee")})


def nonce_of(raw: bytes) -> int:
    return int(decoded(raw)["nonce"])


def decoded(raw: bytes) -> dict[str, Any]:
    """The fields of a signed transaction, of EIP-2718 or with one price for gas. Raises ValueError, TypeError
    or rlp's RLPException for anything else."""
    if raw[:1] < b"\x80":
        return dict(TypedTransaction.from_bytes(HexBytes(raw)).as_dict())
    nonce, price, gas, to, value, data, *_ = rlp.decode(raw)
    numbers = {"nonce": nonce, "gasPrice": price, "gas": gas, "value": value}
    return {name: int.from_bytes(number) for name, number in numbers.items()} | {"to": to, "data": data}


def _entry(row: Row[Any]) -> Entry:
    values = {field.name: row._mapping[field.name] for field in fields(Entry)}
    values["replaced"] = values["replaced"] or []
    if values["nonce"] is None:  # written before nonces were noted
        values["nonce"] = nonce_of(values["raw"])
    return Entry(**values)
