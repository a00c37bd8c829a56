"""What a recording of a cleaning still needs when a mind that is no behaviour says that it is done."""

from __future__ import annotations

from typing import Any

import pytest

from rodeo.lab.drop import RECORDED_AFTER_DROP_S
from rodeo.robot.behaviour import Done
from rodeo.robot.errors import NoAnswer, TakenOut
from rodeo.robot.interrupts import Interrupts
from rodeo_kinds.waste_disposal.behaviour import WasteDisposal
from tests.support.tasks import task
from tests.unit.robot.fakes import CLAIMANT, AnsweringBin, ManualClock, Notes


class Left:
    """Work that was done in front of a bin."""

    def __init__(self, *, presented: bool = True) -> None:
        self.clock, interrupts = ManualClock(), Interrupts()
        self.bin, self.record = AnsweringBin(self.clock, "yellow", interrupts), Notes(interrupts)
        self.bin.present(CLAIMANT, self.clock.now_s())
        self.bin.on_wait = lambda _kind: self.wait(1.0)
        self.began_s = self.clock.now_s()
        shown = ("itrash", self.began_s) if presented else None
        bins: Any = {"itrash": self.bin}
        record: Any = self.record
        self.done = Done(task("assigned"), record, bins, shown, self.clock, self.wait)

    def wait(self, seconds: float) -> None:
        self.clock.wait_until(self.clock.now_s() + seconds)

    def attend(self) -> None:
        WasteDisposal.attend(self.done)


def test_it_ends_when_the_item_has_stayed_in_the_bin() -> None:
    left = Left()
    left.attend()
    assert left.clock.now_s() - left.began_s >= RECORDED_AFTER_DROP_S
    assert len(left.record.motion_s) == 1


def test_work_that_showed_nothing_has_nothing_to_wait_for() -> None:
    left = Left(presented=False)
    left.attend()
    assert left.clock.now_s() == left.began_s


def test_a_bin_that_confirms_nothing_is_said() -> None:
    left = Left()
    left.bin.disposals = False
    with pytest.raises(NoAnswer, match="did not confirm"):
        left.attend()
    assert [note["event"] for note in left.record.notes] == ["unconfirmed"]


def test_what_was_taken_out_again_is_said() -> None:
    left = Left()
    left.bin.thefts = 1
    with pytest.raises(TakenOut):
        left.attend()
