"""What a recorder does by itself: on a disk that is full, with a mind that has work, for charges."""

from __future__ import annotations

import threading
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.errors import DiskFull
from rodeo.host.clocked import ClockedEvent
from rodeo.runtime.state import Notices
from services.robot_recorder.watch import Charges, Watch


class Process:
    """A process whose clock ends it at the second wait."""

    def __init__(self) -> None:
        self.stop, self.told, self.rests = threading.Event(), list[str](), list[bool]()
        self.clock = SimpleNamespace(wait_for=self._wait, acting=nullcontext)
        self.notices, self.clock_check = Notices(), SimpleNamespace(problem="")

    def _wait(self, *_args: Any, resting: bool, **_kwargs: Any) -> None:
        self.rests.append(resting)
        if len(self.rests) == 2:
            self.stop.set()

    def not_ready(self, why: str) -> None:
        self.told.append(why)

    def ready(self) -> None:
        self.told.append("ready")

    def activity(self, text: str, **_details: Any) -> None:
        self.told.append(text)


def watch(
    process: Any,
    orders: Any,
    *,
    assigned: Any = (),
    charge: Any = None,
    take: Any = None,
    stopped: list[bool] | None = None,
    wrong_clock: str = "",
) -> Watch:
    """A watch whose robot has the tasks `assigned`, the charge `charge` and the recording `take`; into
    `stopped` goes what it tells the body."""
    told = [] if stopped is None else stopped
    body: Any = SimpleNamespace(
        emergency_stop=told.append, unfit=lambda: wrong_clock, unknown="", vitals=dict
    )
    body.wrong_clock = wrong_clock
    mind: Any = SimpleNamespace(tell=lambda *_a: None, nodes=["/panther1/mind"])
    dao: Any = SimpleNamespace(name="panther1", tasks=lambda **_wanted: list(assigned))
    charges: Any = SimpleNamespace(look=lambda: charge)
    news = ClockedEvent(process.clock)
    takes: Any = SimpleNamespace(running=take)
    return Watch(process, dao, body, mind, takes, orders, charges, news)


TASK = SimpleNamespace(id=7, nonce="n")


@pytest.mark.parametrize(
    ("work", "may_jump"),
    [
        ({}, True),
        ({"assigned": [TASK]}, False),
        ({"charge": TASK}, False),
        ({"take": SimpleNamespace(attempt=SimpleNamespace(task=TASK), resumed=True)}, False),
    ],
)
def test_no_time_is_jumped_over_while_a_mind_has_something_to_do(work: Any, may_jump: bool) -> None:
    process: Any = Process()
    standing = SimpleNamespace(stopped=False, charge=False)
    orders = SimpleNamespace(standing=standing, cancelled=lambda _n: False)
    watch(process, orders, **work).run()
    assert process.rests == [may_jump] * 2


def test_time_is_not_jumped_over_before_it_is_known_what_there_is_to_do() -> None:
    process: Any = Process()
    unknown = DiskFull("nothing can be looked at")

    class Orders:
        @property
        def standing(self) -> Any:
            raise unknown

    watch(process, Orders()).run()
    assert process.rests == [False] * 2


def test_a_robots_clock_that_was_wrong_during_the_work_is_what_the_proof_lacks() -> None:
    process: Any = Process()
    standing = SimpleNamespace(stopped=False, charge=False)
    orders = SimpleNamespace(standing=standing, cancelled=lambda _n: False)
    take: Any = SimpleNamespace(attempt=SimpleNamespace(task=TASK), resumed=False, wrong_clock="")
    watch(process, orders, take=take, wrong_clock="1.50 s ahead").run()
    watch(process, orders, take=take).run()
    assert take.wrong_clock == "1.50 s ahead"


class Receipts:
    """Notes for which charges the device signs."""

    def __init__(self) -> None:
        self.done: list[Any] = []

    def begin(self, task: Any) -> None:
        self.done.append(("begin", task.id))

    def remind(self) -> None:
        self.done.append("remind")


@pytest.mark.parametrize(
    ("bought", "live"),
    [
        ({}, None),
        ({1: "settled", 2: "cancelled", 3: "submitted"}, None),
        ({1: "open"}, 1),
        ({1: "settled", 2: "assigned"}, 2),
        # A mind that has ordered twice has the newer one signed for.
        ({4: "assigned", 5: "open"}, 5),
    ],
)
def test_the_device_signs_for_the_charge_that_the_mind_has_ordered(bought: Any, live: int | None) -> None:
    asked: list[Any] = []

    def tasks(**wanted: Any) -> list[Any]:
        asked.append(wanted)
        return [SimpleNamespace(id=number, state=state) for number, state in bought.items()]

    dao: Any = SimpleNamespace(name="panther1", tasks=tasks)
    receipts, body = Receipts(), SimpleNamespace()
    found = Charges(dao, "battery_charging", receipts, body).look()
    assert (found and found.id) == live
    assert asked == [{"kind": "battery_charging", "creator": "panther1"}]
    assert receipts.done == ([] if live is None else [("begin", live), "remind"])


def test_a_full_disk_does_not_end_what_stops_the_robot() -> None:
    process: Any = Process()
    full = [DiskFull("the disk is full")]
    stopped: list[bool] = []

    def charge_bought() -> None:
        if full:
            raise full.pop()

    standing = SimpleNamespace(stopped=True, charge=True)
    orders: Any = SimpleNamespace(standing=standing, cancelled=lambda _n: False, charge_bought=charge_bought)
    watch(process, orders, charge=SimpleNamespace(id=3), stopped=stopped).run()
    assert stopped == [True, True]
    said = "stopped by an operator"
    assert process.told == [said, "the disk is full", said, "ready"]
