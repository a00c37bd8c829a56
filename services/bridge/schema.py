"""Tables of the index. They hold nothing that the chain does not, so they are never migrated.

An index of another `version()` is dropped and rebuilt from the chain's events.
"""

from __future__ import annotations

from hashlib import blake2b

from sqlalchemy import (
    JSON,
    BigInteger,
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

cursor = Table(
    "cursor",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("version", String(64), nullable=False, doc="see `version`"),
    Column("chain_id", BigInteger, nullable=False),
    Column("genesis_hash", String(66), nullable=False),
    Column("contracts", JSON, nullable=False, doc="name -> address that the index was built from"),
    Column("block", BigInteger, nullable=False, doc="last block that is in the index"),
    Column("block_hash", String(66), nullable=False),
    Column("block_time_s", BigInteger, nullable=False),
    Column("published_seq", BigInteger, nullable=False, doc="last event that was put on the bus"),
)

blocks = Table(
    "blocks",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    Column("hash", String(66), nullable=False),
    Column("time_s", BigInteger, nullable=False),
    comment="the newest blocks that were taken in: where a reorganization may have left off",
)

undo = Table(
    "undo",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("block", BigInteger, nullable=False, index=True),
    Column("table", String(32), nullable=False),
    Column("key", JSON, nullable=False),
    Column("row", JSON, doc="as it was before the block; null when there was none"),
)

events = Table(
    "events",
    metadata,
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("name", String(64), nullable=False),
    Column("block", BigInteger, nullable=False, index=True),
    Column("log_index", Integer, nullable=False),
    Column("tx_hash", String(66), nullable=False, index=True),
    Column("time_s", BigInteger, nullable=False),
    Column("task_id", BigInteger, index=True),
    Column("args", JSON, nullable=False),
    Column("undone", Boolean, nullable=False, doc="not on the chain any more, or the notice of that"),
)

tasks = Table(
    "tasks",
    metadata,
    Column("id", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", Word, nullable=False),
    Column("state", String(16), nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("max_attempts", Integer, nullable=False),
    Column("creator", String(42), nullable=False),
    Column("executor", String(42)),
    Column("service_id", BigInteger),
    Column("requested_service_id", BigInteger, doc="the only service that may do it; null where any may"),
    Column("requested_provider", String(42), doc="the only provider that may do it; null where any may"),
    Column("reward", Wei, nullable=False),
    Column("price", Wei),
    Column("paid", Wei, nullable=False),
    Column("refunded", Wei, nullable=False, doc="what the creator has back of the reward"),
    Column("params", JSON, nullable=False),
    Column("description", Written, nullable=False),
    Column("registered", Float, nullable=False),
    Column("opened", Float, nullable=False, doc="since when it waits, or waited last"),
    Column("accepted", Boolean, doc="the executor of the running attempt agreed to it"),
    Column("assigned", Float),
    Column("proof_submitted", Float),
    Column("settled", Float),
    Column("ended", Float, doc="settled, cancelled or failed"),
    Column("execution_deadline", Float),
    Column("verdict_deadline", Float),
    Column("case_end", Float, doc="until then a ruling on the submitted proof can be replaced"),
    Column("execution_window_s", BigInteger, nullable=False),
    Column("verdict_window_s", BigInteger, nullable=False),
    Column("grace_s", BigInteger, nullable=False, doc="of the kind when the task was posted"),
    Column(
        "passed",
        JSON,
        nullable=False,
        doc="who had it in attempts that do not count: messages.Passed",
    ),
    Column("audit_window_s", BigInteger, nullable=False, doc="of the kind when the task was posted"),
    Column("number", Integer, nullable=False, doc="of its kind and judge"),
    Column("rules_sha256", String(66), doc="by which it is judged; null where people judge without any"),
    Column("nonce", String(66)),
    Column("proof_sha256", String(66)),
    Column("proof_uri", Written),
    Column("verdict", String(16)),
    Column("fault", String(20), doc="whose doing a void verdict is"),
    Column("reason", Written),
    Column("report_sha256", String(66)),
    Column("report_uri", Written),
    Column("standing", JSON, doc="the last ruling on the proof that waits: rodeo.bus.messages.Standing"),
    Column("standing_until", BigInteger, index=True, doc="null unless a ruling stands"),
    Column("after_removal", Boolean, nullable=False, doc="it was made after the judge was removed"),
    Column("passed_on", Boolean, nullable=False, doc="the judge of the last proof could not decide"),
    Column("set_aside", Wei, nullable=False, doc="of the executor's bond, until the case ends"),
    Column("dispute", JSON, doc="how its last ruling can be or was challenged: rodeo.bus.messages.Dispute"),
    # Answers that count all tasks, or choose among them, read these alone, and then few rows.
    Index("tasks_by_state", "state", "id"),
    Index("tasks_by_kind", "kind", "state", "id"),
    Index("tasks_by_creator", "creator", "state", "id"),
    Index("tasks_by_executor", "executor", "state", "id"),
    Index("tasks_by_end", "ended", "id"),
    Index("tasks_by_creator_and_end", "creator", "ended", "id"),
    Index("tasks_by_verdict", "verdict", "creator", "fault"),
)

texts = Table(
    "texts",
    metadata,
    Column("task_id", BigInteger, primary_key=True, autoincrement=False),
    Column("text", Written, nullable=False, doc="lower case"),
    comment="what a search for tasks looks through: all of it, so that it lies apart from what is long",
)

services = Table(
    "services",
    metadata,
    Column("id", BigInteger, primary_key=True, autoincrement=False),
    Column("kind", Word, nullable=False, index=True),
    Column("number", Integer, nullable=False, doc="of the kind and the judge that its provider agreed to"),
    Column("provider", String(42), nullable=False, index=True),
    Column("price", Wei, nullable=False),
    Column("state", String(16), nullable=False),
    Column("description", Written, nullable=False),
    Column("auto_accept", Boolean, nullable=False, doc="its provider accepts each task that it is assigned"),
    Column("task_id", BigInteger, doc="the task it is doing"),
    Column("completed", Integer, nullable=False),
    Column("rejected", Integer, nullable=False),
    Column("expired", Integer, nullable=False),
    Column("bond", Wei, nullable=False, doc="what is left of it"),
    Column("set_aside", Wei, nullable=False, doc="what of it waits for the end of its cases"),
    Column("penalty", Wei, nullable=False),
    Column("max_failures", Integer, nullable=False),
    Column("namers", String(16), nullable=False, doc="whose tasks may name it: rodeo.bus.messages.Namers"),
    Column(
        "max_void_percent", Integer, nullable=False, doc="of what a creator named somebody for; 0 for any"
    ),
    Column("place", BigInteger, nullable=False, doc="lower was idle earlier; 0 when it does not wait"),
    Column(
        "waits_as_proven",
        Boolean,
        nullable=False,
        doc="it waits, or waited last, in a proven provider's line",
    ),
)

providers = Table(
    "providers",
    metadata,
    Column("address", String(42), primary_key=True),
    Column("failures", Integer, nullable=False, doc="in a row, of all its services"),
    Column("done", Wei, nullable=False, doc="accepted work for others, 10^9 wei, as of `day`"),
    Column("failed", Wei, nullable=False, doc="work that was rejected or came too late"),
    Column("day", Integer, nullable=False, doc="from 1970-01-01 UTC"),
    Column("creator", Integer, nullable=False, doc="whose attempt counted last that day, see Work.creator"),
    Column("asleep_until", BigInteger, doc="when it may wake up, s; null while it is awake"),
    Column(
        "rests_until", BigInteger, doc="it is not proven, and gets no task before; null if it never rested"
    ),
    Column("bond_locked_until", BigInteger, doc="before that its bonds are not returned; null if they are"),
    Column("earned", Boolean, nullable=False, doc="its accepted work has proven it"),
    Column("vouched", Boolean, nullable=False, doc="the organization vouches for it"),
    Column("services", JSON, nullable=False, doc="those that are not over; none of the organization's"),
    Column("suspended", Boolean, nullable=False, doc="by the administrator: it offers no service"),
    Column("payout", String(42), doc="who is paid for its work; null for itself"),
    comment="accounts that offered a service, were suspended, or named who is paid for their work",
)

devices = Table(
    "devices",
    metadata,
    Column("address", String(42), primary_key=True),
    Column("role", Word, nullable=False),
    Column("name", Word, nullable=False, doc="which one of its role it is on its site"),
    Column("owner", String(42), nullable=False),
    Column("registrar", String(42), nullable=False),
    Column("registered", Float, nullable=False),
    Column("revoked", Float),
    Column("revoked_because", String(16), doc="superseded or compromised"),
)

roots = Table(
    "roots",
    metadata,
    Column("device", String(42), primary_key=True),
    Column("day", BigInteger, primary_key=True, autoincrement=False, doc="from 1970-01-01 UTC"),
    Column("root", String(66), nullable=False),
    Column("uri", Written, nullable=False),
    Column("block", BigInteger, nullable=False),
    Column("time_s", BigInteger, nullable=False),
    Column("tx_hash", String(66), nullable=False),
    comment="what devices signed on a day, as it was fixed on chain",
)

kinds = Table(
    "kinds",
    metadata,
    Column("kind", Word, primary_key=True),
    Column("allowed", Boolean, nullable=False),
    Column("number", Integer, nullable=False, doc="of the kind with its present judge; 0 before the first"),
    Column("min_window_s", BigInteger, nullable=False, doc="of an execution; 0 before anybody has set it"),
    Column("max_window_s", BigInteger, nullable=False),
    Column("grace_s", BigInteger, nullable=False, doc="in which an executor may give a task back"),
    Column("reference_price", Wei, nullable=False, doc="the most that an attempt counts in a record"),
    Column("min_verdict_window_s", BigInteger, nullable=False),
    Column("max_verdict_window_s", BigInteger, nullable=False),
    Column("audit_window_s", BigInteger, nullable=False),
    Column("judges_window_s", BigInteger, nullable=False, doc="the shortest verdict window its judge takes"),
    Column("max_case_s", BigInteger, nullable=False, doc="the longest case that its judge takes"),
    Column("rules_sha256", JSON, nullable=False, doc="those that are current, the newest last"),
    Column("votes", Integer, nullable=False, doc="of the committee's judges that make a verdict; or 0"),
    Column("panel", Integer, nullable=False, doc="how many judges may vote at once"),
    Column("rotation_s", BigInteger, nullable=False, doc="after which one more judge may vote; 0 for never"),
    Column("seats", JSON, nullable=False, doc="of its judges"),
    Column("judge_stake", Wei, nullable=False, doc="which the vote of each of them needs"),
    Column("challenge_stakes", JSON, nullable=False, doc="IEC that challenges of its instances cost"),
)

numbers = Table(
    "numbers",
    metadata,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("kind", Word, nullable=False),
    Column("judge", String(42), nullable=False, doc="the address of the contract that rules"),
    Column("removed", Boolean, nullable=False, doc="it rules no more"),
    comment="each judge that a kind had or has",
)

cases = Table(
    "cases",
    metadata,
    Column("task_id", BigInteger, primary_key=True, autoincrement=False),
    Column("attempt", Integer, primary_key=True, autoincrement=False),
    Column("number", Integer, nullable=False, doc="of its kind and judge"),
    Column("until", BigInteger, nullable=False, doc="end of the running window; 0 after the last ruling"),
    Column("staked", Boolean, nullable=False, doc="somebody has a stake in it"),
    Column("settled", Boolean, nullable=False, doc="its stakes are free or paid"),
    comment="attempts on which a judge with several instances has ruled",
)

judges = Table(
    "judges",
    metadata,
    Column("committee", String(32), primary_key=True, doc="the contract's name"),
    Column("seat", Integer, primary_key=True, autoincrement=False),
    Column("key", String(42), nullable=False),
    Column("first_key", String(42), nullable=False, doc="by which the device registry names the judge"),
    Column("owner", String(42), nullable=False),
    Column("stake", Wei, nullable=False, doc="what counts for its votes"),
    Column("leaving", Wei, nullable=False, doc="what is being withdrawn"),
    Column("leaving_until_s", BigInteger, nullable=False, doc="block time after which that is paid"),
    comment="of the committee of oracles, and of those that decide about challenges",
)

challenge_kinds = Table(
    "challenge_kinds",
    metadata,
    Column("committee", String(32), primary_key=True, doc="the contract's name; not that of the oracles"),
    Column("kind", Word, primary_key=True),
    Column("votes", Integer, nullable=False, doc="of its judges that decide; or 0"),
    Column("seats", JSON, nullable=False, doc="of the judges of this kind"),
    Column("judge_stake", Wei, nullable=False, doc="which the vote of each of them needs"),
    comment="whose rulings can be challenged before which committee",
)

roles = Table(
    "roles",
    metadata,
    Column("role", Word, primary_key=True),
    Column("address", String(42), primary_key=True),
    Column("held", Boolean, nullable=False),
)

settings = Table(
    "settings",
    metadata,
    Column("name", String(32), primary_key=True),
    Column("value", JSON),
    comment="the organization's rules as its events last said",
)

proposals = Table(
    "proposals",
    metadata,
    Column("id", Word, primary_key=True, doc="the governor's, or the timelock's where nobody votes, in hex"),
    Column(
        "number",
        BigInteger,
        unique=True,
        doc="from 1, as they were made; null for what founders were told at once",
    ),
    Column("proposer", String(42), doc="null where nobody votes: the timelock does not say"),
    Column("description", Written, nullable=False, doc="without the proposer's address at its end"),
    Column("description_hash", Word, doc="of what was written, by which the governor knows it"),
    Column("predecessor", Word, doc="the timelock's operation that comes before; null where members vote"),
    Column("salt", Word, doc="by which the timelock tells equal operations apart; null where members vote"),
    Column("targets", JSON, nullable=False),
    Column("values", JSON, nullable=False, doc="wei, decimal text"),
    Column("calldatas", JSON, nullable=False),
    Column("created", Float, nullable=False),
    Column("vote_end", BigInteger, doc="null where nobody votes"),
    Column("ready", BigInteger, doc="from when it may be executed, once it is queued"),
    Column("ended", String(16), doc="executed or canceled"),
    Column("for", Wei, nullable=False),
    Column("against", Wei, nullable=False),
    Column("abstain", Wei, nullable=False),
)

ballots = Table(
    "ballots",
    metadata,
    Column("proposal", Word, primary_key=True),
    Column("voter", String(42), primary_key=True),
    Column("support", String(16), nullable=False),
    Column("weight", Wei, nullable=False),
)

budget_votes = Table(
    "budget_votes",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=False, doc="from 0, the contract's"),
    Column("amount", Wei, nullable=False),
    Column("opened", Float, nullable=False),
    Column("end", BigInteger, nullable=False, doc="members vote before it, and shares are paid from it on"),
    Column("recipients", JSON, nullable=False),
    Column("votes", JSON, nullable=False, doc="of all members together, for each recipient"),
    Column("paid", JSON, nullable=False, doc="wei, decimal text, for each recipient; null until it was paid"),
)

budget_ballots = Table(
    "budget_ballots",
    metadata,
    Column("budget_vote", BigInteger, primary_key=True, autoincrement=False),
    Column("voter", String(42), primary_key=True),
    Column("votes", JSON, nullable=False, doc="for each recipient, as it last voted"),
)

balances = Table(
    "balances",
    metadata,
    Column("address", String(42), primary_key=True),
    Column("balance", Wei, nullable=False),
    Column("owed", Wei, nullable=False, doc="what the token refused and `collect` pays"),
)

transfers = Table(
    "transfers",
    metadata,
    Column("seq", BigInteger, primary_key=True, autoincrement=False, doc="of the event"),
    Column("block", BigInteger, nullable=False),
    Column("time_s", BigInteger, nullable=False),
    Column("tx_hash", String(66), nullable=False),
    Column("sender", String(42), nullable=False),
    Column("to", String(42), nullable=False),
    Column("amount", Wei, nullable=False),
    Column("sender_balance", Wei, doc="after it; null for the mint"),
    Column("to_balance", Wei),
    Column("task_id", BigInteger, index=True),
    Column("reason", String(16), nullable=False),
    Index("transfers_by_sender", "sender", "seq"),
    Index("transfers_by_receiver", "to", "seq"),
    Index("transfers_by_both", "sender", "to"),
)

transactions = Table(
    "transactions",
    metadata,
    Column("tx_hash", String(66), primary_key=True),
    Column("seq", BigInteger, nullable=False, index=True, doc="of its last event"),
    Column("block", BigInteger, nullable=False, index=True),
    Column("time_s", BigInteger, nullable=False),
    Column("sender", String(42), doc="null, as are the others, until somebody has asked for its receipt"),
    Column("gas_used", BigInteger),
    Column("gas_price", Wei, doc="wei per gas, paid"),
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
