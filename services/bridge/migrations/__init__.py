"""Schema migrations (alembic), one folder per database: `index` and `journal`.

A new revision is a file `NNNN_what.py` in `versions`; a test compares what the revisions make with the tables
in schema.py and journal.py.
"""
