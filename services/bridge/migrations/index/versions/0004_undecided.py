"""Undecided attempts and their auditors, what went back to creators, and the daily roots of devices."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

_COLUMNS: dict[str, dict[str, tuple[Any, str | None]]] = {
    "tasks": {
        "refunded": (sa.String(length=78), "0"),
        "audit_deadline": (sa.Float(), None),
        "at_silence": (sa.String(length=16), None),
    },
    "kinds": {
        "audit_window_s": (sa.BigInteger(), "0"),
        "silence": (sa.String(length=16), "none"),
    },
}
"""Type, and what the rows have of an index that is emptied next, having an older version; None is null."""


def upgrade() -> None:
    for table, columns in _COLUMNS.items():
        for name, (kind, default) in columns.items():
            column = sa.Column(name, kind, nullable=default is None, server_default=default)
            op.add_column(table, column)
    op.create_table(
        "roots",
        sa.Column("device", sa.String(length=42), nullable=False),
        sa.Column("day", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("root", sa.String(length=66), nullable=False),
        sa.Column("uri", sa.Text(), nullable=False),
        sa.Column("block", sa.BigInteger(), nullable=False),
        sa.Column("time_s", sa.BigInteger(), nullable=False),
        sa.Column("tx_hash", sa.String(length=66), nullable=False),
        sa.PrimaryKeyConstraint("device", "day"),
        comment="what devices signed on a day, as it was fixed on chain",
    )


def downgrade() -> None:
    op.drop_table("roots")
    for table, columns in _COLUMNS.items():
        for name in columns:
            op.drop_column(table, name)
