"""Which rows end as they must."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.outside import drivers, environment, files, nodes
from tests.outside.rows import Family, Row, rows

Outcome = Callable[[Row], str]
"""Empty where it works, else what is said."""
_PLAYED = {"files": files.outcome, "environment": environment.outcome, "drivers": drivers.outcome}


@contextmanager
def ready(family: Family) -> Iterator[Outcome]:
    """What plays the rows of a family."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        if family != "nodes":
            outcome = _PLAYED[family]
            yield lambda row: outcome(row, folder / str(len(list(folder.iterdir()))))
            return
        with nodes.a_chain(folder) as chain:
            yield lambda row: nodes.outcome(row, chain, folder / str(len(list(folder.iterdir()))))


def complaint(row: Row, outcome: Outcome) -> str:
    """Empty where the row ends as it must, else how it ended."""
    try:
        said = outcome(row)
    except Exception as error:  # noqa: BLE001 -- nothing outside may end in an error that has no name
        return f"{type(error).__name__}: {error}"
    if row.must == "works":
        return said
    return "" if said and row.says in said else said or "it was not refused"


def complaints(family: Family) -> dict[str, str]:
    """Vice -> complaint, empty where there is none."""
    with ready(family) as outcome:
        return {row.vice: complaint(row, outcome) for row in rows(family)}
