"""What nodes, files and machines outside do, as people have reported it (`tests/outside`): one case per row.

`outside_<family>_cases`, `outside_<family>_survived`: rows of the family, and those that end as they must,
which is that it works, or that it is refused with an error that says why. `outside_cases` and
`outside_survived` are the sums.
"""

from __future__ import annotations

from rich.console import Console

from tests.outside.rows import FAMILIES
from tests.outside.survival import complaints


def run() -> dict[str, float]:
    console, figures = Console(), dict[str, float]()
    for family in FAMILIES:
        found = complaints(family)
        for vice, complaint in found.items():
            if complaint:
                console.print(f"{family}: {vice}: {complaint[:300]}", markup=False)
        figures[f"outside_{family}_cases"] = len(found)
        figures[f"outside_{family}_survived"] = sum(not one for one in found.values())
    for what in ("cases", "survived"):
        figures[f"outside_{what}"] = sum(figures[f"outside_{family}_{what}"] for family in FAMILIES)
    return figures
