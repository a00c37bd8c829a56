"""How the bin lets a simulated clock go on."""

from __future__ import annotations

import math
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.payloads import EXAMPLES
from rodeo.site.config import Site
from rodeo.witness.statement import Presentation, parse
from rodeo_testing.assignments import devices
from services.itrash.behaviour import Bin, Memory, State
from services.itrash.process import present
from services.itrash.steps import Steps


@pytest.mark.parametrize(("attentive", "decides"), [(True, True), (True, False), (False, False)])
def test_while_a_reading_may_decide_the_clock_waits_after_each_and_readings_go_on(
    attentive: bool, decides: bool
) -> None:
    """A simulator skips a charge without showing readings, where everybody rests: what lies in a bucket would
    never come to rest for a bin that waits for the next one."""
    asked: dict[str, Any] = {}
    clock = SimpleNamespace(wait_for=lambda done, stop, **how: asked.update(how))
    bin_: Any = SimpleNamespace(attentive=attentive, decides=decides, memory=Memory())
    process: Any = SimpleNamespace(clock=clock, stop=threading.Event())
    assert not Steps(bin_, process).await_action()
    assert asked["resting"] is not attentive
    assert math.isinf(asked["every_s"]) is not decides


def test_what_is_awaited_is_not_decided_by_an_empty_view(site: Site) -> None:
    """While a drop is awaited and for a while after it, the clock waits for the bin only where something is
    in view or a weight is not at rest."""
    waiting = Memory(state=State.AWAITING_DROP)
    bin_ = Bin(site.bins[0], waiting)
    assert (bin_.attentive, bin_.decides) == (True, False)
    bin_.presence(math.inf, 0.0)
    assert not bin_.decides
    bin_.presence(0.2, 0.1)
    assert bin_.decides, "something is in view"
    bin_.presence(math.inf, 0.2)
    assert not bin_.decides
    compartment = next(iter(site.bins[0].compartments))
    for tenth in range(20):
        bin_.load(compartment, 0.0, tenth / 10)
    assert not bin_.decides
    bin_.load(compartment, 0.3, 2.0)
    assert bin_.decides, "a weight changes"


def test_a_weight_that_begins_to_change_wakes_the_bin_that_rests(site: Site) -> None:
    told: list[None] = []
    process: Any = SimpleNamespace(clock=SimpleNamespace(notify=lambda: told.append(None)))
    bin_ = Bin(site.bins[0], Memory())
    steps = Steps(bin_, process)
    compartment = next(iter(site.bins[0].compartments))

    def weigh(force_n: float, time_s: float) -> None:
        steps.feed("scale", lambda: bin_.load(compartment, force_n, time_s))

    for tenth in range(20):
        weigh(0.0, tenth / 10)
    assert not bin_.attentive
    before = len(told)
    weigh(0.0, 2.0)
    assert len(told) == before, "nothing changed"
    weigh(0.3, 2.1)
    assert bin_.attentive
    assert len(told) == before + 1


def test_the_bin_hears_from_a_robots_presentation_when_it_grasped(site: Site) -> None:
    bin_ = Bin(site.bins[0], Memory())
    robot = next(one for one in devices() if one.role == "robot")
    said = parse(EXAMPLES[Presentation] | {"bin": site.bins[0].name, "grasped_s": 990.5})
    present(bin_, site.bins[0].name, robot, said, 1_000.0)
    (presented,) = bin_.memory.presented
    assert (presented.claimant.device, presented.grasped_s) == ("panther1", 990.5)
