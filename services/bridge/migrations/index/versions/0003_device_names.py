"""Which device a key is on its site, and why it was revoked."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    # The default is for the rows of an index that is emptied next, having an older version.
    op.add_column("devices", sa.Column("name", sa.String(length=66), nullable=False, server_default=""))
    op.add_column("devices", sa.Column("revoked_because", sa.String(length=16)))


def downgrade() -> None:
    op.drop_column("devices", "revoked_because")
    op.drop_column("devices", "name")
