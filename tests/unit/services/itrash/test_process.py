"""How the bin lets a simulated clock go on."""

from __future__ import annotations

import math
import queue
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from services.itrash.process import Itrash


@pytest.mark.parametrize("attentive", [True, False])
def test_while_a_reading_may_decide_the_clock_waits_after_each_and_readings_go_on(attentive: bool) -> None:
    """A simulator skips a charge without showing readings, where everybody rests: what lies in a bucket would
    never come to rest for a bin that waits for the next one."""
    asked: dict[str, Any] = {}
    clock = SimpleNamespace(wait_for=lambda done, stop, **how: asked.update(how))
    bin_: Any = SimpleNamespace(
        _process=SimpleNamespace(clock=clock, stop=threading.Event()),
        _bin=SimpleNamespace(attentive=attentive),
        _actions=queue.SimpleQueue(),
    )
    assert not Itrash._await_action(bin_)
    assert asked["resting"] is not attentive
    assert math.isinf(asked["every_s"]) is not attentive
