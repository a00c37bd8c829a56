"""When an index that is at the node's head still does not count as current."""

import pytest

from services.bridge.index import Position
from services.bridge.service import why_late


@pytest.mark.parametrize(
    ("max_block_age_s", "now_s", "late"), [(None, 10**10, False), (60.0, 1060.0, False), (60.0, 1061.0, True)]
)
def test_a_node_whose_newest_block_is_old_is_behind(
    max_block_age_s: float | None, now_s: float, late: bool
) -> None:
    why = why_late(Position(7, "0x", 1000), max_block_age_s, now_s)
    assert (why is not None) == late
    assert why is None or "older than 60 s" in why
