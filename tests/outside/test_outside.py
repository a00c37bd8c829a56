"""Vices that people have met outside end as they must. `make bench ONLY=outside` plays all of them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.outside.rows import FAMILIES, Family, Row, rows
from tests.outside.survival import Outcome, complaint, ready

LEAST = {"nodes": 35, "files": 40, "environment": 15, "drivers": 35}
EVERY = {"nodes": 4, "files": 3, "environment": 2, "drivers": 4}
"""One row of so many is played here, each time the same."""


@pytest.mark.parametrize("family", FAMILIES)
def test_most_of_a_family_has_to_work_and_each_names_its_report(family: Family) -> None:
    found = rows(family)
    assert len(found) >= LEAST[family]
    assert sum(row.must == "works" for row in found) >= 0.7 * len(found)
    assert all(row.source.startswith("https://") for row in found)


@pytest.fixture(scope="module", params=FAMILIES)
def played(request: pytest.FixtureRequest) -> Iterator[tuple[list[Row], Outcome]]:
    family: Family = request.param
    with ready(family) as outcome:
        yield rows(family)[:: EVERY[family]], outcome


def test_what_people_have_met_ends_as_it_must(played: tuple[list[Row], Outcome]) -> None:
    chosen, outcome = played
    assert {row.vice: said for row in chosen if (said := complaint(row, outcome))} == {}
