"""Whoever leaves the bus sends nothing more, also while it is still leaving."""

from __future__ import annotations

from typing import Any

import pytest
import zenoh

from rodeo.bus.sending import has_left, is_asked


class Closing:
    """A session while another thread closes it, as zenoh 1.10 answers then."""

    def is_closed(self) -> bool:
        raise RuntimeError("Already mutably borrowed")


def test_who_asks_a_session_that_is_being_closed_hears_that_it_is() -> None:
    closing: Any = Closing()
    with pytest.raises(zenoh.ZError, match="Already mutably borrowed"), is_asked():
        closing.is_closed()


def test_a_session_has_left_from_when_it_is_being_closed() -> None:
    closing: Any = Closing()
    assert has_left(closing)
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    assert not has_left(session)
    session.close()
    assert has_left(session)
