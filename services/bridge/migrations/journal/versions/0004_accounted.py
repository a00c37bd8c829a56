"""How far the journal answers for what the wallets have sent."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    op.create_table(
        "accounted",
        sa.Column("wallet", sa.String(length=64), primary_key=True),
        sa.Column("nonce", sa.BigInteger(), nullable=False),
        sa.Column("sent_without", sa.BigInteger(), nullable=False),
        comment="what the wallets have sent, as far as the journal answers for it",
    )


def downgrade() -> None:
    op.drop_table("accounted")
