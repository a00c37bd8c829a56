"""Nonces, fees and blocks: many transactions in flight, replacements, limits and reorganizations."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

_COLUMNS: dict[str, Any] = {
    "task_id": sa.BigInteger(),
    "nonce": sa.BigInteger(),
    "max_fee": sa.String(length=78),
    "priority_fee": sa.String(length=78),
    "fee": sa.String(length=78),
    "spends": sa.String(length=78),
    "replaced": sa.JSON(),
    "block": sa.BigInteger(),
    "made_s": sa.Float(),
}


def upgrade() -> None:
    for name, kind in _COLUMNS.items():
        op.add_column("transactions", sa.Column(name, kind, nullable=True))
    op.create_index("ix_transactions_block", "transactions", ["block"], unique=False)


def downgrade() -> None:
    op.drop_index("ix_transactions_block", table_name="transactions")
    for name in _COLUMNS:
        op.drop_column("transactions", name)
