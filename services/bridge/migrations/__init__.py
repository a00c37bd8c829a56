"""Schema migrations of the journal (alembic). The index has none: it is rebuilt from the chain instead.

A new revision is a file `NNNN_what.py` in `journal/versions`. A test compares the tables that
the revisions make with those in `services/bridge/journal.py`.
"""
