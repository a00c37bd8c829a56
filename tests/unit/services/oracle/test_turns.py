"""Providers take turns, whatever one of them hands in."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rodeo.host.clock import WallClock
from rodeo_testing.waiting import HANG_S, wait_until
from services.oracle.turns import Key, Turns


class CountingClock(WallClock):
    """Counts how often a waiting thread looked and found nothing to do."""

    def __init__(self) -> None:
        super().__init__()
        self.looks = 0

    def wait_for(self, done: Callable[[], bool], *args: Any, **more: Any) -> bool:
        def look() -> bool:
            found = done()
            self.looks += not found
            return found

        return super().wait_for(look, *args, **more)


class Desk:
    """Turns of which each lasts until the test ends it."""

    def __init__(self, places: int) -> None:
        self._clock = CountingClock()
        self.turns = Turns(self._clock, places)
        self.begun: queue.SimpleQueue[int] = queue.SimpleQueue()
        """Tasks in the order in which they had their turns."""
        self._ends: dict[int, threading.Event] = {}
        self._leaves: dict[int, Callable[[], None]] = {}
        self.stopped = threading.Event()
        self._thread = threading.Thread(target=self.turns.run, args=(self.stopped, self.work), daemon=True)

    def work(self, key: Key, leave: Callable[[], None]) -> None:
        self._leaves[key[0]] = leave
        end = self._ends[key[0]] = threading.Event()
        self.begun.put(key[0])
        while not self.stopped.is_set() and not end.wait(0.01):
            pass

    def put(self, provider: str, *tasks: int, again: bool = False) -> None:
        for task in tasks:
            self.turns.put((task, 1), provider, again=again)

    def start(self) -> None:
        self._thread.start()

    def next(self) -> int:
        return self.begun.get(timeout=HANG_S)

    def look(self) -> None:
        """Return when `run` has looked twice without giving a turn. The second look saw all that was put."""
        seen = self._clock.looks
        wait_until(lambda: self._clock.looks >= seen + 2, "nobody looks for the next turn")

    def end(self, task: int) -> None:
        self._ends[task].set()

    def leave(self, task: int) -> None:
        self._leaves[task]()

    def order(self, count: int) -> list[int]:
        """The next so many, each ended before the one after it."""
        found = []
        for _ in range(count):
            found.append(self.next())
            self.end(found[-1])
        return found

    def stop(self) -> bool:
        """Whether it has ended."""
        self.stopped.set()
        self._thread.join(HANG_S)
        return not self._thread.is_alive()


@pytest.fixture
def desks() -> Iterator[Callable[[int], Desk]]:
    made: list[Desk] = []

    def make(places: int) -> Desk:
        made.append(Desk(places))
        return made[-1]

    yield make
    stopped = [desk.stop() for desk in made]
    assert all(stopped)


@pytest.mark.parametrize("places", [1, 2, 7])
def test_with_eight_of_one_provider_in_line_anothers_begins_next(
    desks: Callable[[int], Desk], places: int
) -> None:
    desk = desks(places)
    desk.put("many", *range(1, 9))
    desk.start()
    begun = max(1, places - 1)
    assert {desk.next() for _ in range(begun)} == set(range(1, begun + 1))
    desk.put("honest", 20)
    if places == 1:
        desk.end(1)
    assert desk.next() == 20


def test_providers_take_turns_and_each_ones_proofs_keep_their_order(desks: Callable[[int], Desk]) -> None:
    desk = desks(1)
    desk.put("many", 1, 2, 3, 4)
    desk.put("one", 11, 12)
    desk.put("other", 21)
    desk.start()
    assert desk.order(7) == [1, 11, 21, 2, 12, 3, 4]


def test_the_last_place_is_kept_for_a_provider_that_has_none(desks: Callable[[int], Desk]) -> None:
    desk = desks(3)
    desk.put("many", 1, 2, 3, 4)
    desk.start()
    assert {desk.next(), desk.next()} == {1, 2}
    desk.put("one", 11, 12)
    assert desk.next() == 11
    desk.end(1)
    desk.put("other", 21)
    assert desk.next() == 21
    assert desk.turns.waiting() == [(3, 1), (4, 1), (12, 1)]


def test_a_place_goes_to_who_has_the_fewest_in_work(desks: Callable[[int], Desk]) -> None:
    desk = desks(5)
    desk.put("many", 1, 2, 3, 4, 5)
    desk.start()
    assert {desk.next() for _ in range(4)} == {1, 2, 3, 4}
    desk.put("one", 11, 12)
    assert desk.next() == 11
    desk.end(1)
    desk.end(2)
    assert desk.next() == 12


def test_second_attempts_are_behind_all_first_ones_but_wait_for_no_later_ones(
    desks: Callable[[int], Desk],
) -> None:
    desk = desks(1)
    desk.put("many", 1, 2, 3)
    desk.start()
    assert desk.next() == 1
    desk.put("many", 4, again=True)
    desk.put("one", 11, again=True)
    desk.put("many", 5)
    desk.end(1)
    assert desk.order(5) == [2, 3, 11, 4, 5]


def test_a_second_attempt_takes_a_place_that_no_first_one_may_have(desks: Callable[[int], Desk]) -> None:
    desk = desks(2)
    desk.put("many", 1, 2)
    desk.start()
    assert desk.next() == 1
    desk.put("one", 11, again=True)
    assert desk.next() == 11


def test_who_leaves_its_turn_early_works_on_and_the_next_begins(desks: Callable[[int], Desk]) -> None:
    desk = desks(1)
    desk.put("many", 1, 2)
    desk.start()
    assert desk.next() == 1
    desk.leave(1)
    assert desk.next() == 2


def test_a_stop_ends_the_turns_and_begins_none_of_those_in_line(desks: Callable[[int], Desk]) -> None:
    desk = desks(1)
    desk.put("many", 1, 2)
    desk.put("one", 11)
    desk.start()
    assert desk.next() == 1
    assert desk.stop()
    assert desk.begun.empty()
    assert desk.turns.waiting() == [(2, 1), (11, 1)]
    desk.turns.run(desk.stopped, desk.work)  # now that a place is free
    assert desk.begun.empty()


def test_a_submission_that_is_in_line_again_before_its_turn_ends_has_a_place_of_its_own(
    desks: Callable[[int], Desk],
) -> None:
    desk = desks(3)
    desk.start()
    desk.put("p", 1)
    assert desk.next() == 1
    leave = desk._leaves[1]
    desk.put("p", 1, again=True)
    assert desk.next() == 1
    leave()  # the first turn's
    desk.put("q", 2)
    desk.put("r", 3)
    assert {desk.next(), desk.next()} == {2, 3}
    desk.put("s", 4)
    desk.look()
    assert desk.turns.waiting() == [(4, 1)], "the second turn of 1 has a place as well"
    desk.end(2)
    assert desk.next() == 4
