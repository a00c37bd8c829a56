"""Alembic's entry for the index."""

from services.bridge import schema
from services.bridge.migrations import environment

environment.run(schema.metadata)
