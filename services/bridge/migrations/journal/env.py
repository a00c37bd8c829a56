"""Alembic's entry for the journal: migrate through the connection that `database.migrate` hands over."""

from alembic import context

from services.bridge import journal

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=journal.metadata,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
