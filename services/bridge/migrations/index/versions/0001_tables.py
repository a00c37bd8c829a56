"""The index's first tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    op.create_table(
        "balances",
        sa.Column("address", sa.String(length=42), nullable=False),
        sa.Column("balance", sa.String(length=78), nullable=False),
        sa.PrimaryKeyConstraint("address"),
    )
    op.create_table(
        "blocks",
        sa.Column("number", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("hash", sa.String(length=66), nullable=False),
        sa.Column("time_s", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("number"),
        comment="the newest blocks that were taken in: where a reorganization may have left off",
    )
    op.create_table(
        "cursor",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("chain_id", sa.BigInteger(), nullable=False),
        sa.Column("genesis_hash", sa.String(length=66), nullable=False),
        sa.Column("contracts", sa.JSON(), nullable=False),
        sa.Column("block", sa.BigInteger(), nullable=False),
        sa.Column("block_hash", sa.String(length=66), nullable=False),
        sa.Column("block_time_s", sa.BigInteger(), nullable=False),
        sa.Column("published_seq", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_table(
        "devices",
        sa.Column("address", sa.String(length=42), nullable=False),
        sa.Column("role", sa.String(length=66), nullable=False),
        sa.Column("owner", sa.String(length=42), nullable=False),
        sa.Column("registrar", sa.String(length=42), nullable=False),
        sa.Column("registered", sa.Float(), nullable=False),
        sa.Column("revoked", sa.Float(), nullable=True),
        sa.PrimaryKeyConstraint("address"),
    )
    op.create_table(
        "events",
        sa.Column("seq", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("block", sa.BigInteger(), nullable=False),
        sa.Column("log_index", sa.Integer(), nullable=False),
        sa.Column("tx_hash", sa.String(length=66), nullable=False),
        sa.Column("time_s", sa.BigInteger(), nullable=False),
        sa.Column("task_id", sa.BigInteger(), nullable=True),
        sa.Column("args", sa.JSON(), nullable=False),
        sa.Column("undone", sa.Boolean(), nullable=False),
        sa.PrimaryKeyConstraint("seq"),
    )
    op.create_index("ix_events_block", "events", ["block"], unique=False)
    op.create_index("ix_events_task_id", "events", ["task_id"], unique=False)
    op.create_index("ix_events_tx_hash", "events", ["tx_hash"], unique=False)
    op.create_table(
        "kinds",
        sa.Column("kind", sa.String(length=66), nullable=False),
        sa.Column("allowed", sa.Boolean(), nullable=False),
        sa.Column("review", sa.String(length=16), nullable=False),
        sa.Column("min_window_s", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("kind"),
    )
    op.create_table(
        "receipts",
        sa.Column("tx_hash", sa.String(length=66), nullable=False),
        sa.Column("block_hash", sa.String(length=66), nullable=False),
        sa.Column("sender", sa.String(length=42), nullable=False),
        sa.Column("gas_used", sa.BigInteger(), nullable=False),
        sa.Column("gas_price", sa.String(length=78), nullable=False),
        sa.PrimaryKeyConstraint("tx_hash"),
        comment="of transactions that somebody asked for",
    )
    op.create_table(
        "roles",
        sa.Column("role", sa.String(length=66), nullable=False),
        sa.Column("address", sa.String(length=42), nullable=False),
        sa.Column("held", sa.Boolean(), nullable=False),
        sa.PrimaryKeyConstraint("role", "address"),
    )
    op.create_table(
        "services",
        sa.Column("id", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("kind", sa.String(length=66), nullable=False),
        sa.Column("provider", sa.String(length=42), nullable=False),
        sa.Column("price", sa.String(length=78), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("task_id", sa.BigInteger(), nullable=True),
        sa.Column("completed", sa.Integer(), nullable=False),
        sa.Column("rejected", sa.Integer(), nullable=False),
        sa.Column("expired", sa.Integer(), nullable=False),
        sa.Column("bond", sa.String(length=78), nullable=False),
        sa.Column("penalty", sa.String(length=78), nullable=False),
        sa.Column("max_failures", sa.Integer(), nullable=False),
        sa.Column("failures", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_services_kind", "services", ["kind"], unique=False)
    op.create_index("ix_services_provider", "services", ["provider"], unique=False)
    op.create_table(
        "settings",
        sa.Column("name", sa.String(length=32), nullable=False),
        sa.Column("value", sa.JSON(), nullable=True),
        sa.PrimaryKeyConstraint("name"),
        comment="the organization's rules as its events last said",
    )
    op.create_table(
        "tasks",
        sa.Column("id", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("kind", sa.String(length=66), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("max_attempts", sa.Integer(), nullable=False),
        sa.Column("creator", sa.String(length=42), nullable=False),
        sa.Column("executor", sa.String(length=42), nullable=True),
        sa.Column("service_id", sa.BigInteger(), nullable=True),
        sa.Column("reward", sa.String(length=78), nullable=False),
        sa.Column("price", sa.String(length=78), nullable=True),
        sa.Column("paid", sa.String(length=78), nullable=False),
        sa.Column("params", sa.JSON(), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("registered", sa.Float(), nullable=False),
        sa.Column("assigned", sa.Float(), nullable=True),
        sa.Column("proof_submitted", sa.Float(), nullable=True),
        sa.Column("settled", sa.Float(), nullable=True),
        sa.Column("ended", sa.Float(), nullable=True),
        sa.Column("execution_deadline", sa.Float(), nullable=True),
        sa.Column("verdict_deadline", sa.Float(), nullable=True),
        sa.Column("nonce", sa.String(length=66), nullable=True),
        sa.Column("proof_sha256", sa.String(length=66), nullable=True),
        sa.Column("proof_uri", sa.Text(), nullable=True),
        sa.Column("verdict", sa.String(length=16), nullable=True),
        sa.Column("reason", sa.Text(), nullable=True),
        sa.Column("report_sha256", sa.String(length=66), nullable=True),
        sa.Column("report_uri", sa.Text(), nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_tasks_creator", "tasks", ["creator"], unique=False)
    op.create_index("ix_tasks_executor", "tasks", ["executor"], unique=False)
    op.create_index("tasks_by_state_and_kind", "tasks", ["state", "kind"], unique=False)
    op.create_table(
        "transfers",
        sa.Column("seq", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("block", sa.BigInteger(), nullable=False),
        sa.Column("time_s", sa.BigInteger(), nullable=False),
        sa.Column("tx_hash", sa.String(length=66), nullable=False),
        sa.Column("sender", sa.String(length=42), nullable=False),
        sa.Column("to", sa.String(length=42), nullable=False),
        sa.Column("amount", sa.String(length=78), nullable=False),
        sa.Column("sender_balance", sa.String(length=78), nullable=True),
        sa.Column("to_balance", sa.String(length=78), nullable=True),
        sa.Column("task_id", sa.BigInteger(), nullable=True),
        sa.Column("reason", sa.String(length=16), nullable=False),
        sa.PrimaryKeyConstraint("seq"),
    )
    op.create_index("ix_transfers_sender", "transfers", ["sender"], unique=False)
    op.create_index("ix_transfers_task_id", "transfers", ["task_id"], unique=False)
    op.create_index("ix_transfers_to", "transfers", ["to"], unique=False)
    op.create_table(
        "undo",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("block", sa.BigInteger(), nullable=False),
        sa.Column("table", sa.String(length=32), nullable=False),
        sa.Column("key", sa.JSON(), nullable=False),
        sa.Column("row", sa.JSON(), nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_undo_block", "undo", ["block"], unique=False)


def downgrade() -> None:
    op.drop_index("ix_undo_block", table_name="undo")
    op.drop_table("undo")
    op.drop_index("ix_transfers_to", table_name="transfers")
    op.drop_index("ix_transfers_task_id", table_name="transfers")
    op.drop_index("ix_transfers_sender", table_name="transfers")
    op.drop_table("transfers")
    op.drop_index("tasks_by_state_and_kind", table_name="tasks")
    op.drop_index("ix_tasks_executor", table_name="tasks")
    op.drop_index("ix_tasks_creator", table_name="tasks")
    op.drop_table("tasks")
    op.drop_table("settings")
    op.drop_index("ix_services_provider", table_name="services")
    op.drop_index("ix_services_kind", table_name="services")
    op.drop_table("services")
    op.drop_table("roles")
    op.drop_table("receipts")
    op.drop_table("kinds")
    op.drop_index("ix_events_tx_hash", table_name="events")
    op.drop_index("ix_events_task_id", table_name="events")
    op.drop_index("ix_events_block", table_name="events")
    op.drop_table("events")
    op.drop_table("devices")
    op.drop_table("cursor")
    op.drop_table("blocks")
    op.drop_table("balances")
