"""Alembic's entry for the journal."""

from services.bridge import journal
from services.bridge.migrations import environment

environment.run(journal.metadata)
