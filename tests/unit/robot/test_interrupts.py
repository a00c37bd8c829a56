"""What ends a motion or a wait."""

from __future__ import annotations

import pytest

from rodeo.robot.errors import Cancelled, GraspFailed, Stopped
from rodeo.robot.interrupts import Interrupts


def raising(error: Exception) -> None:
    raise error


def test_an_added_check_ends_with_its_block_however_that_ends() -> None:
    interrupts = Interrupts()
    with (
        pytest.raises(GraspFailed),
        interrupts.also(lambda: None),
        interrupts.also(lambda: raising(GraspFailed("lost"))),
    ):
        interrupts.check()
    interrupts.check()


def test_the_outer_reason_is_told_first() -> None:
    interrupts = Interrupts(lambda: raising(Stopped("ended")))
    with interrupts.also(lambda: raising(Cancelled("given up"))), pytest.raises(Stopped):
        interrupts.check()
