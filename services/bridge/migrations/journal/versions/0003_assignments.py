"""Nonces of assignments: what a reorganization takes back is sent again only for the same one."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    op.add_column("transactions", sa.Column("attempt", sa.Integer(), nullable=True))
    op.add_column("transactions", sa.Column("assignment", sa.String(length=66), nullable=True))


def downgrade() -> None:
    op.drop_column("transactions", "assignment")
    op.drop_column("transactions", "attempt")
