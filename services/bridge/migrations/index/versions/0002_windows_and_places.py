"""What else the contracts keep: a task's windows, where a service waits, and payments that were refused."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

_COLUMNS: dict[str, dict[str, Any]] = {
    "tasks": {"execution_window_s": sa.BigInteger(), "verdict_window_s": sa.BigInteger()},
    "services": {"place": sa.BigInteger()},
    "kinds": {"places": sa.BigInteger()},
    "balances": {"owed": sa.String(length=78)},
}


def upgrade() -> None:
    for table, columns in _COLUMNS.items():
        for name, kind in columns.items():
            # The default is for the rows of an index that is emptied next, having an older version.
            op.add_column(table, sa.Column(name, kind, nullable=False, server_default="0"))


def downgrade() -> None:
    for table, columns in _COLUMNS.items():
        for name in columns:
            op.drop_column(table, name)
