"""What a mind says of what it shows to a bin: checked against the body, and answered by the bin."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.lab.world import GRIPPER_CLOSED_M, GRIPPER_OPEN_M
from rodeo.robot.errors import BodySilent, NoAnswer
from rodeo.robot.interrupts import Interrupts
from services.robot_recorder.errors import NothingGrasped, NothingRecorded, UnknownBin
from services.robot_recorder.showing import Showing
from tests.unit.robot.fakes import CLAIMANT, AnsweringBin, ManualClock

BEGUN_S = 100.0
AROUND_AN_ITEM_M = (GRIPPER_CLOSED_M + GRIPPER_OPEN_M) / 2


class Hands:
    """A showing, the body's fingers, and the recording that runs."""

    def __init__(self, resumed: bool = False) -> None:
        self.clock = ManualClock()
        self.clock.time_s = BEGUN_S + 60
        self.gripper_m: float | None = AROUND_AN_ITEM_M
        recording = SimpleNamespace(claimant=CLAIMANT)
        self.take: Any = SimpleNamespace(
            recording=recording, begun_s=BEGUN_S, resumed=resumed, presented=None
        )
        self.bin = AnsweringBin(self.clock, "yellow", Interrupts())
        self.bin.on_wait = lambda _kind: self._pass(1.0)
        takes: Any = SimpleNamespace(running=self.take)
        body: Any = SimpleNamespace(recent_gripper_m=lambda: self.gripper_m)
        bins: Any = {"itrash": self.bin}
        self.takes, self.showing = takes, Showing(takes, bins, body, self.clock)

    def _pass(self, seconds: float) -> None:
        self.clock.time_s += seconds

    def present(self, ago_s: float = 10.0, bin_name: str = "itrash") -> Any:
        return self.showing.present(bin_name, self.clock.now_s() - ago_s)


def test_what_is_held_is_presented_and_the_bin_answers() -> None:
    hands = Hands()
    assert hands.present().compartment == "yellow"
    assert hands.bin.presented == [CLAIMANT]
    assert hands.bin.grasps_s == [BEGUN_S + 50]
    assert hands.take.presented == ("itrash", BEGUN_S + 60)


@pytest.mark.parametrize("gripper_m", [GRIPPER_CLOSED_M, GRIPPER_OPEN_M])
def test_what_is_not_grasped_is_not_presented(gripper_m: float) -> None:
    hands = Hands()
    hands.gripper_m = gripper_m
    with pytest.raises(NothingGrasped):
        hands.present()
    assert (hands.bin.presented, hands.take.presented) == ([], None)


@pytest.mark.parametrize("ago_s", [-10.0, 61.0])
def test_a_grasp_that_is_not_in_the_recording_is_not_presented(ago_s: float) -> None:
    hands = Hands()
    with pytest.raises(NothingGrasped):
        hands.present(ago_s)
    assert hands.bin.presented == []


def test_a_grasp_from_before_an_interruption_is_presented_in_the_recording_that_goes_on() -> None:
    assert Hands(resumed=True).present(ago_s=61.0).compartment == "yellow"


def test_a_body_that_says_nothing_of_its_fingers_is_named() -> None:
    hands = Hands()
    hands.gripper_m = None
    with pytest.raises(BodySilent):
        hands.present()


def test_nothing_is_presented_without_a_recording_or_a_bin() -> None:
    hands = Hands()
    with pytest.raises(UnknownBin):
        hands.present(bin_name="elsewhere")
    hands.takes.running = None
    with pytest.raises(NothingRecorded):
        hands.present()


def test_a_word_on_what_others_show_is_passed_over() -> None:
    hands = Hands()
    hands.bin.mistaken = 1
    assert hands.present().compartment == "yellow"
    hands.bin.combining = [BEGUN_S]
    assert hands.present().compartment == "yellow", "the first had a picture from before the grasp"


def test_a_bin_that_stays_silent_is_no_answer() -> None:
    hands = Hands()
    hands.bin.silent = 1
    with pytest.raises(NoAnswer):
        hands.present()
