"""Vices that people have met outside end as they must."""

from __future__ import annotations

import pytest

from tests.outside.rows import FAMILIES, Family, rows

LEAST = {"nodes": 35, "files": 40, "environment": 15}


@pytest.mark.parametrize("family", FAMILIES)
def test_most_of_a_family_has_to_work_and_each_names_its_report(family: Family) -> None:
    found = rows(family)
    assert len(found) >= LEAST[family]
    assert sum(row.must == "works" for row in found) >= 0.7 * len(found)
    assert all(row.source.startswith("https://") for row in found)
