"""Tables of the index. They hold nothing that the chain does not, so they are never migrated.

An index of another `version()` is dropped and rebuilt from the chain's events.
"""

from __future__ import annotations

from functools import partial
from hashlib import blake2b
from typing import Any

import sqlalchemy
from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Dialect,
    Float,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
)

_CONTENT = 10
"""Raise this when the same events write other rows than before. Changes of the tables need no raise."""

metadata = MetaData()


class Wei(TypeDecorator[int]):
    """A 256-bit amount. Databases have no such integer, so it is decimal text; never compared in SQL."""

    impl = String(78)
    cache_ok = True

    def process_bind_param(self, value: int | None, dialect: Dialect) -> str | None:
        return None if value is None else str(value)

    def process_result_value(self, value: str | None, dialect: Dialect) -> int | None:
        return None if value is None else int(value)


class Written(TypeDecorator[str]):
    """Text that anybody may have written. PostgreSQL takes no NUL and no lone surrogate."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Dialect) -> str | None:
        return writable(value)


def writable(text: str | None) -> str | None:
    """The text as it can be stored, whoever wrote it."""
    return None if text is None else text.replace("\0", "\ufffd").encode(errors="replace").decode()


Word = String(66)
"""ASCII in 32 bytes, or their hex."""

Column = partial(sqlalchemy.Column, nullable=False)
Nullable = partial(sqlalchemy.Column, nullable=True)


def _table(name: str, *parts: sqlalchemy.Column[Any] | Index, comment: str | None = None) -> Table:
    return Table(name, metadata, *parts, comment=comment)


cursor = _table(
    "cursor",
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("version", String(64), doc="see `version`"),
    Column("chain_id", BigInteger),
    Column("genesis_hash", String(66)),
    Column("contracts", JSON, doc="name -> address that the index was built from"),
    Column("block", BigInteger, doc="last block that is in the index"),
    Column("block_hash", String(66)),
    Column("block_time_s", BigInteger),
    Column("published_seq", BigInteger, doc="last event that was put on the bus"),
)

blocks = _table(
    "blocks",
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    Column("hash", String(66)),
    Column("time_s", BigInteger),
    comment="the newest blocks that were taken in: where a reorganization may have left off",
)

undo = _table(
    "undo",
    Column("id", Integer, primary_key=True),
    Column("block", BigInteger, index=True),
    Column("table", String(32)),
    Column("key", JSON),
    Nullable("row", JSON, doc="as it was before the block; null when there was none"),
)

events = _table(
    "events",
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("name", String(64)),
    Column("block", BigInteger, index=True),
    Column("log_index", Integer),
    Column("tx_hash", String(66), index=True),
    Column("time_s", BigInteger),
    Nullable("task_id", BigInteger, index=True),
    Column("args", JSON),
    Column("undone", Boolean, doc="not on the chain any more, or the notice of that"),
)

tasks = _table(
    "tasks",
    Column("id", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", Word),
    Column("state", String(16)),
    Column("attempt", Integer),
    Column("max_attempts", Integer),
    Column("creator", String(42)),
    Nullable("executor", String(42)),
    Nullable("service_id", BigInteger),
    Nullable("requested_service_id", BigInteger, doc="the only service that may do it; null where any may"),
    Nullable("requested_provider", String(42), doc="the only provider that may do it; null where any may"),
    Column("reward", Wei),
    Nullable("price", Wei),
    Column("paid", Wei),
    Column("refunded", Wei, doc="what the creator has back of the reward"),
    Column("params", JSON),
    Column("description", Written),
    Column("registered", Float),
    Column("opened", Float, doc="since when it waits, or waited last"),
    Nullable("accepted", Boolean, doc="the executor of the running attempt agreed to it"),
    Nullable("assigned", Float),
    Nullable("proof_submitted", Float),
    Nullable("settled", Float),
    Nullable("ended", Float, doc="settled, cancelled or failed"),
    Nullable("execution_deadline", Float),
    Nullable("verdict_deadline", Float),
    Nullable("case_end", Float, doc="until then a ruling on the submitted proof can be replaced"),
    Column("execution_window_s", BigInteger),
    Column("verdict_window_s", BigInteger),
    Column("grace_s", BigInteger, doc="of the kind when the task was posted"),
    Column("passed", JSON, doc="who had it in attempts that do not count: messages.Passed"),
    Column("audit_window_s", BigInteger, doc="of the kind when the task was posted"),
    Column("number", Integer, doc="of its kind and judge"),
    Nullable("rules_sha256", String(66), doc="by which it is judged; null where people judge without any"),
    Nullable("nonce", String(66)),
    Nullable("proof_sha256", String(66)),
    Nullable("proof_uri", Written),
    Nullable("verdict", String(16)),
    Nullable("fault", String(20), doc="whose doing a void verdict is"),
    Nullable("reason", Written),
    Nullable("report_sha256", String(66)),
    Nullable("report_uri", Written),
    Nullable("standing", JSON, doc="the last ruling on the proof that waits: rodeo.bus.messages.Standing"),
    Nullable("standing_until", BigInteger, index=True, doc="null unless a ruling stands"),
    Column("after_removal", Boolean, doc="it was made after the judge was removed"),
    Column("passed_on", Boolean, doc="the judge of the last proof could not decide"),
    Column("set_aside", Wei, doc="of the executor's bond, until the case ends"),
    Nullable("dispute", JSON, doc="how its last ruling can be or was challenged: rodeo.bus.messages.Dispute"),
    # Answers that count all tasks, or choose among them, read these alone, and then few rows.
    Index("tasks_by_state", "state", "id"),
    Index("tasks_by_kind", "kind", "state", "id"),
    Index("tasks_by_creator", "creator", "state", "id"),
    Index("tasks_by_executor", "executor", "state", "id"),
    Index("tasks_by_end", "ended", "id"),
    Index("tasks_by_creator_and_end", "creator", "ended", "id"),
    Index("tasks_by_verdict", "verdict", "creator", "fault"),
)

texts = _table(
    "texts",
    Column("task_id", BigInteger, primary_key=True, autoincrement=False),
    Column("text", Written, doc="lower case"),
    comment="what a search for tasks looks through: all of it, so that it lies apart from what is long",
)

services = _table(
    "services",
    Column("id", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", Word, index=True),
    Column("number", Integer, doc="of the kind and the judge that its provider agreed to"),
    Column("provider", String(42), index=True),
    Column("price", Wei),
    Column("state", String(16)),
    Column("description", Written),
    Column("auto_accept", Boolean, doc="its provider accepts each task that it is assigned"),
    Nullable("task_id", BigInteger, doc="the task it is doing"),
    Column("completed", Integer),
    Column("rejected", Integer),
    Column("expired", Integer),
    Column("bond", Wei, doc="what is left of it"),
    Column("set_aside", Wei, doc="what of it waits for the end of its cases"),
    Column("penalty", Wei),
    Column("max_failures", Integer),
    Column("namers", String(16), doc="whose tasks may name it: rodeo.bus.messages.Namers"),
    Column("max_void_percent", Integer, doc="of what a creator named somebody for; 0 for any"),
    Column("place", BigInteger, doc="lower was idle earlier; 0 when it does not wait"),
    Column("waits_as_proven", Boolean, doc="it waits, or waited last, in a proven provider's line"),
)

providers = _table(
    "providers",
    Column("address", String(42), primary_key=True),
    Column("failures", Integer, doc="in a row, of all its services"),
    Column("done", Wei, doc="accepted work for others, 10^9 wei, as of `day`"),
    Column("failed", Wei, doc="work that was rejected or came too late"),
    Column("day", Integer, doc="from 1970-01-01 UTC"),
    Column("creator", Integer, doc="whose attempt counted last that day, see Work.creator"),
    Nullable("asleep_until", BigInteger, doc="when it may wake up, s; null while it is awake"),
    Nullable(
        "rests_until", BigInteger, doc="it is not proven, and gets no task before; null if it never rested"
    ),
    Nullable("bond_locked_until", BigInteger, doc="before that its bonds are not returned; null if they are"),
    Column("earned", Boolean, doc="its accepted work has proven it"),
    Column("vouched", Boolean, doc="the organization vouches for it"),
    Column("services", JSON, doc="those that are not over; none of the organization's"),
    Column("suspended", Boolean, doc="by the administrator: it offers no service"),
    Nullable("payout", String(42), doc="who is paid for its work; null for itself"),
    comment="accounts that offered a service, were suspended, or named who is paid for their work",
)

devices = _table(
    "devices",
    Column("address", String(42), primary_key=True),
    Column("role", Word),
    Column("name", Word, doc="which one of its role it is on its site"),
    Column("owner", String(42)),
    Column("registrar", String(42)),
    Column("registered", Float),
    Nullable("revoked", Float),
    Nullable("revoked_because", String(16), doc="superseded or compromised"),
)

roots = _table(
    "roots",
    Column("device", String(42), primary_key=True),
    Column("day", BigInteger, primary_key=True, autoincrement=False, doc="from 1970-01-01 UTC"),
    Column("root", String(66)),
    Column("uri", Written),
    Column("block", BigInteger),
    Column("time_s", BigInteger),
    Column("tx_hash", String(66)),
    comment="what devices signed on a day, as it was fixed on chain",
)

kinds = _table(
    "kinds",
    Column("kind", Word, primary_key=True),
    Column("allowed", Boolean),
    Column("number", Integer, doc="of the kind with its present judge; 0 before the first"),
    Column("min_window_s", BigInteger, doc="of an execution; 0 before anybody has set it"),
    Column("max_window_s", BigInteger),
    Column("grace_s", BigInteger, doc="in which an executor may give a task back"),
    Column("reference_price", Wei, doc="the most that an attempt counts in a record"),
    Column("min_verdict_window_s", BigInteger),
    Column("max_verdict_window_s", BigInteger),
    Column("audit_window_s", BigInteger),
    Column("judges_window_s", BigInteger, doc="the shortest verdict window its judge takes"),
    Column("max_case_s", BigInteger, doc="the longest case that its judge takes"),
    Column("rules_sha256", JSON, doc="those that are current, the newest last"),
    Column("votes", Integer, doc="of the committee's judges that make a verdict; or 0"),
    Column("panel", Integer, doc="how many judges may vote at once"),
    Column("rotation_s", BigInteger, doc="after which one more judge may vote; 0 for never"),
    Column("seats", JSON, doc="of its judges"),
    Column("judge_stake", Wei, doc="which the vote of each of them needs"),
    Column("challenge_stakes", JSON, doc="IEC that challenges of its instances cost"),
)

numbers = _table(
    "numbers",
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("kind", Word),
    Column("judge", String(42), doc="the address of the contract that rules"),
    Column("removed", Boolean, doc="it rules no more"),
    comment="each judge that a kind had or has",
)

cases = _table(
    "cases",
    Column("task_id", BigInteger, primary_key=True, autoincrement=False),
    Column("attempt", Integer, primary_key=True, autoincrement=False),
    Column("number", Integer, doc="of its kind and judge"),
    Column("until", BigInteger, doc="end of the running window; 0 after the last ruling"),
    Column("staked", Boolean, doc="somebody has a stake in it"),
    Column("settled", Boolean, doc="its stakes are free or paid"),
    comment="attempts on which a judge with several instances has ruled",
)

judges = _table(
    "judges",
    Column("committee", String(32), primary_key=True, doc="the contract's name"),
    Column("seat", Integer, primary_key=True, autoincrement=False),
    Column("key", String(42)),
    Column("first_key", String(42), doc="by which the device registry names the judge"),
    Column("owner", String(42)),
    Column("stake", Wei, doc="what counts for its votes"),
    Column("leaving", Wei, doc="what is being withdrawn"),
    Column("leaving_until_s", BigInteger, doc="block time after which that is paid"),
    comment="of the committee of oracles, and of those that decide about challenges",
)

challenge_kinds = _table(
    "challenge_kinds",
    Column("committee", String(32), primary_key=True, doc="the contract's name; not that of the oracles"),
    Column("kind", Word, primary_key=True),
    Column("votes", Integer, doc="of its judges that decide; or 0"),
    Column("seats", JSON, doc="of the judges of this kind"),
    Column("judge_stake", Wei, doc="which the vote of each of them needs"),
    comment="whose rulings can be challenged before which committee",
)

roles = _table(
    "roles",
    Column("role", Word, primary_key=True),
    Column("address", String(42), primary_key=True),
    Column("held", Boolean),
)

settings = _table(
    "settings",
    Column("name", String(32), primary_key=True),
    Nullable("value", JSON),
    comment="the organization's rules as its events last said",
)

proposals = _table(
    "proposals",
    Column("id", Word, primary_key=True, doc="the governor's, or the timelock's where nobody votes, in hex"),
    Nullable(
        "number",
        BigInteger,
        unique=True,
        doc="from 1, as they were made; null for what founders were told at once",
    ),
    Nullable("proposer", String(42), doc="null where nobody votes: the timelock does not say"),
    Column("description", Written, doc="without the proposer's address at its end"),
    Nullable("description_hash", Word, doc="of what was written, by which the governor knows it"),
    Nullable("predecessor", Word, doc="the timelock's operation that comes before; null where members vote"),
    Nullable("salt", Word, doc="by which the timelock tells equal operations apart; null where members vote"),
    Column("targets", JSON),
    Column("values", JSON, doc="wei, decimal text"),
    Column("calldatas", JSON),
    Column("created", Float),
    Nullable("vote_end", BigInteger, doc="null where nobody votes"),
    Nullable("ready", BigInteger, doc="from when it may be executed, once it is queued"),
    Nullable("ended", String(16), doc="executed or canceled"),
    Column("for", Wei),
    Column("against", Wei),
    Column("abstain", Wei),
)

ballots = _table(
    "ballots",
    Column("proposal", Word, primary_key=True),
    Column("voter", String(42), primary_key=True),
    Column("support", String(16)),
    Column("weight", Wei),
)

budget_votes = _table(
    "budget_votes",
    Column("number", BigInteger, primary_key=True, autoincrement=False, doc="from 0, the contract's"),
    Column("amount", Wei),
    Column("opened", Float),
    Column("end", BigInteger, doc="members vote before it, and shares are paid from it on"),
    Column("recipients", JSON),
    Column("votes", JSON, doc="of all members together, for each recipient"),
    Column("paid", JSON, doc="wei, decimal text, for each recipient; null until it was paid"),
)

budget_ballots = _table(
    "budget_ballots",
    Column("budget_vote", BigInteger, primary_key=True, autoincrement=False),
    Column("voter", String(42), primary_key=True),
    Column("votes", JSON, doc="for each recipient, as it last voted"),
)

balances = _table(
    "balances",
    Column("address", String(42), primary_key=True),
    Column("balance", Wei),
    Column("owed", Wei, doc="what the token refused and `collect` pays"),
)

transfers = _table(
    "transfers",
    Column("seq", BigInteger, primary_key=True, autoincrement=False, doc="of the event"),
    Column("block", BigInteger),
    Column("time_s", BigInteger),
    Column("tx_hash", String(66)),
    Column("sender", String(42)),
    Column("to", String(42)),
    Column("amount", Wei),
    Nullable("sender_balance", Wei, doc="after it; null for the mint"),
    Nullable("to_balance", Wei),
    Nullable("task_id", BigInteger, index=True),
    Column("reason", String(16)),
    Index("transfers_by_sender", "sender", "seq"),
    Index("transfers_by_receiver", "to", "seq"),
    Index("transfers_by_both", "sender", "to"),
)

transactions = _table(
    "transactions",
    Column("tx_hash", String(66), primary_key=True),
    Column("seq", BigInteger, index=True, doc="of its last event"),
    Column("block", BigInteger, index=True),
    Column("time_s", BigInteger),
    Nullable("sender", String(42), doc="null, as are the others, until somebody has asked for its receipt"),
    Nullable("gas_used", BigInteger),
    Nullable("gas_price", Wei, doc="wei per gas, paid"),
    comment="with events of the contracts",
)


def version() -> str:
    """Changes with the tables, their columns and indexes, and with `_CONTENT`."""
    columns = [
        (table.name, column.name, repr(column.type), column.nullable, column.primary_key, column.index)
        for table in metadata.sorted_tables
        for column in table.columns
    ]
    indexes = sorted(
        (index.name, *index.columns.keys()) for table in metadata.sorted_tables for index in table.indexes
    )
    return f"{_CONTENT}-{blake2b(repr((columns, indexes)).encode(), digest_size=8).hexdigest()}"
