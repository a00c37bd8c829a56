"""When an index that is at the node's head still does not count as current."""

import pytest

from services.bridge.index import Position
from services.bridge.process import why_late


@pytest.mark.parametrize(
    ("max_block_age_s", "now_s", "late"), [(None, 10**10, False), (60.0, 1060.0, False), (60.0, 1061.0, True)]
)
def test_a_node_whose_newest_block_is_old_is_behind(
    max_block_age_s: float | None, now_s: float, late: bool
) -> None:
    why = why_late(Position(7, "0x", 1000), max_block_age_s, now_s)
    assert (why is not None) == late
    assert why is None or "older than 60 s" in why


@pytest.mark.parametrize(("elsewhere", "told"), [(True, True), (False, False)])
def test_a_machine_whose_clock_is_behind_a_chain_elsewhere_says_so(elsewhere: bool, told: bool) -> None:
    """A local chain has the site's own time, which may be any."""
    why = why_late(Position(7, "0x", 1007), None, 1000.0, elsewhere)
    assert why == ("clock 7 s behind the chain's newest block" if told else None)
