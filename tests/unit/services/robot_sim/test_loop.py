"""How fast the loop lets the site's time go."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from types import SimpleNamespace

import pytest

from rodeo.site.sections import ClockConfig
from rodeo_testing.waiting import HANG_S, wait_until
from services.robot_sim import loop as loop_module
from services.robot_sim.loop import JUMP_NS, Loop
from services.robot_sim.people import PeoplesTime
from services.robot_sim.roster import NEVER_NS
from services.robot_sim.simulation import IDLE_PERIOD_NS, PERIOD_NS
from tests.unit.services.robot_sim.test_people import START_S, SilentBus, lab, task

WALL_S = 1.5


class World:
    """A robot that charges, or only stands there, and nothing else."""

    still = True

    def __init__(self, begin_ns: int = 0, parked: bool = True) -> None:
        self.time_ns, self.parked = begin_ns, parked
        self.skipped = self.stepped = 0

    def step(self) -> None:
        self.time_ns += PERIOD_NS
        self.stepped += 1

    def skip(self, lasted_ns: int) -> None:
        self.time_ns += lasted_ns
        self.skipped += 1

    def row(self) -> None:
        pass

    halt = row


class Nothing:
    """Neither saves nor publishes."""

    def save(self, *_state: object) -> None:
        pass

    def publish(self, skipped: bool) -> None:
        pass

    def publish_power(self, due: bool) -> None:
        pass


class Resting:
    """A holder of the clock that has something to do at these times (ns), and not before."""

    resting = True

    def __init__(self, times_ns: list[int]) -> None:
        self.left_ns = times_ns

    @property
    def next_ns(self) -> int:
        return self.left_ns[0]

    def may_pass(self, now_ns: int, _then: object) -> bool:
        if len(self.left_ns) > 1 and self.left_ns[0] <= now_ns:
            del self.left_ns[0]
        return True


class Dock(Nothing):
    """Sees at which times power is published, and at which somebody is due."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.told_ns: list[int] = []
        self.due_ns: list[int] = []

    def publish_power(self, due: bool) -> None:
        self.told_ns.append(self.world.time_ns)
        if due:
            self.due_ns.append(self.told_ns[-1])


@pytest.mark.parametrize(
    ("limited", "most", "skips"),
    [
        (lambda speed: speed, 400.0, True),
        (lambda speed: min(speed, 40.0), 40.0, True),
        (lambda speed: min(speed, 4.0), 4.0, False),
    ],
    ids=["free", "between working and idle", "slower than either"],
)
def test_the_clock_goes_no_faster_than_it_may_idle_or_not(
    limited: Callable[[float], float], most: float, skips: bool
) -> None:
    world, stop = World(), threading.Event()
    clock = ClockConfig(speed=10, idle_speed=400)
    loop = Loop(world, Nothing(), clock, stop, limited)  # type: ignore[arg-type]
    thread = threading.Thread(target=loop.run, args=(Nothing(),))
    begun_s = time.monotonic()
    thread.start()
    wait_until(lambda: world.skipped + world.stepped >= 20)
    stop.set()
    thread.join()
    passed_s = time.monotonic() - begun_s
    assert world.time_ns * 1e-9 <= most * passed_s + IDLE_PERIOD_NS * 1e-9
    assert (world.skipped > 0) == skips


def test_a_charge_is_skipped_also_where_everything_is_as_fast_as_can_be() -> None:
    world, stop = World(), threading.Event()
    loop = Loop(world, Nothing(), ClockConfig(speed=0, idle_speed=0), stop)  # type: ignore[arg-type]
    thread = threading.Thread(target=loop.run, args=(Nothing(),))
    thread.start()
    wait_until(lambda: world.skipped >= 20)
    stop.set()
    thread.join()
    assert world.time_ns == world.skipped * IDLE_PERIOD_NS


def test_a_charge_is_told_each_second_and_at_each_time_that_somebody_named() -> None:
    named_s, second_ns = [0.5, 4.0, 4.02, 9.999, 30.0, 1e6], IDLE_PERIOD_NS
    world, stop = World(), threading.Event()
    dock = Dock(world)
    loop = Loop(world, Nothing(), ClockConfig(speed=0, idle_speed=0), stop)  # type: ignore[arg-type]
    loop.holders = Resting([round(time_s * 1e9) for time_s in named_s])  # type: ignore[assignment]
    thread = threading.Thread(target=loop.run, args=(dock,))
    thread.start()
    while world.time_ns < 40 * second_ns:
        threading.Event().wait(0.01)
    stop.set()
    thread.join()
    # The next whole period after each.
    assert dock.due_ns == [round(time_s * 1e9) for time_s in (0.5, 4.0, 4.02, 10.0, 30.0)]
    strides_ns = [b - a for a, b in zip(dock.told_ns, dock.told_ns[1:], strict=False)]
    assert max(strides_ns) == second_ns


class TellsTheEnd(Nothing):
    """Notes when (monotonic) the site's time has come to `end_ns`."""

    def __init__(self, world: World, end_ns: int) -> None:
        self.world, self.end_ns = world, end_ns
        self.ended_s: float | None = None

    def publish(self, skipped: bool) -> None:
        if self.ended_s is None and self.world.time_ns >= self.end_ns:
            self.ended_s = time.monotonic()

    publish_power = publish


@pytest.mark.parametrize(
    ("speeds", "parked", "window_s"),
    [
        pytest.param((10, 0), False, 7200.0, id="it would jump"),
        pytest.param((0, 0), False, 7200.0, id="it would jump, and go as fast as it can"),
        pytest.param((0, 0), False, WALL_S, id="in real time"),
        pytest.param((10, 400), True, 12 * WALL_S, id="it would skip a charge"),
    ],
)
def test_a_person_gets_the_least_wall_time_however_the_clock_would_skip(
    speeds: tuple[float, float], parked: bool, window_s: float
) -> None:
    world, stop = World(), threading.Event()
    world.parked, world.time_ns = parked, round(START_S * 1e9)
    held = PeoplesTime(SilentBus(), lab(WALL_S, speeds), lambda: world.time_ns * 1e-9)  # type: ignore[arg-type]
    clock = ClockConfig(speed=speeds[0], idle_speed=speeds[1])
    loop = Loop(world, Nothing(), clock, stop, held.speed)  # type: ignore[arg-type]
    loop.holders = Resting([NEVER_NS])  # type: ignore[assignment]
    seen = TellsTheEnd(world, round((START_S + window_s) * 1e9))
    begun_s = time.monotonic()
    held.windows.take([task(window_s=window_s)], begun_s)
    held.windows.adjust(begun_s)
    thread = threading.Thread(target=loop.run, args=(seen,))
    thread.start()
    while seen.ended_s is None:
        threading.Event().wait(0.1)
        held.windows.adjust(time.monotonic())
    stop.set()
    thread.join()
    held.close()
    # A machine that is late does not take anybody's time, so there is no bound above but the test's own.
    assert seen.ended_s - begun_s >= WALL_S - PERIOD_NS * 1e-9


class Assigning(Resting):
    """Gives, when `at_ns` has come, a person a task before the clock may pass: `assign` is called then."""

    def __init__(self, at_ns: int, assign: Callable[[], None]) -> None:
        super().__init__([at_ns, NEVER_NS])
        self.assign = assign

    def may_pass(self, now_ns: int, _then: object) -> bool:
        assigns = len(self.left_ns) > 1 and self.left_ns[0] <= now_ns
        passes = super().may_pass(now_ns, _then)
        if assigns:
            self.assign()
        return passes


def up_to(limit: list[float]) -> Callable[[float], float]:
    """What `PeoplesTime.speed` is, with `limit[0]`."""
    return lambda speed: limit[0] if limit[0] < (speed or math.inf) else speed


def test_a_clock_that_has_to_stand_does_not_jump_and_then_keeps_to_the_limit() -> None:
    world, stop, known, limit = World(), threading.Event(), threading.Event(), [math.inf]
    world.parked = False
    assigned = threading.Event()
    stood_ns: list[int] = []

    def assign() -> None:
        stood_ns.append(world.time_ns)
        assigned.set()

    loop = Loop(world, Nothing(), ClockConfig(speed=0, idle_speed=0), stop, up_to(limit))  # type: ignore[arg-type]
    loop.holders = Assigning(JUMP_NS, assign)  # type: ignore[assignment]
    looks = 0

    def stands() -> bool:
        nonlocal looks
        looks += assigned.is_set()
        return assigned.is_set() and not known.is_set()

    loop.stands = stands
    thread = threading.Thread(target=loop.run, args=(Nothing(),))
    thread.start()
    assert assigned.wait(HANG_S)
    wait_until(lambda: looks >= 3)
    stood_ns.append(world.time_ns)
    limit[0] = 1.0
    known.set()
    loop.wake()
    known_s = time.monotonic()
    while world.time_ns == stood_ns[-1]:
        threading.Event().wait(0.01)
    stood_ns.append(world.time_ns)
    passed_s = time.monotonic() - known_s
    stop.set()
    thread.join()
    assert stood_ns[:2] == [JUMP_NS, JUMP_NS]
    assert stood_ns[2] - JUMP_NS <= (passed_s + PERIOD_NS * 1e-9) * 1e9


def test_a_limit_that_is_set_while_the_clock_was_held_counts_for_the_next_jump() -> None:
    world, stop, limit = World(), threading.Event(), [math.inf]
    world.parked = False

    def assign() -> None:
        limit[0] = 1.0

    class Shows(Nothing):
        def __init__(self) -> None:
            self.told_ns: list[int] = []

        def publish(self, skipped: bool) -> None:
            self.told_ns.append(world.time_ns)
            if limit[0] == 1.0:
                stop.set()

    shown = Shows()
    loop = Loop(world, Nothing(), ClockConfig(speed=0, idle_speed=0), stop, up_to(limit))  # type: ignore[arg-type]
    loop.holders = Assigning(JUMP_NS, assign)  # type: ignore[assignment]
    loop.run(shown)
    assert shown.told_ns == [JUMP_NS, JUMP_NS + PERIOD_NS]


class DoneLate(Future[object]):
    """Is done just after whoever asks for its result has waited for long enough."""

    def result(self, timeout: float | None = None) -> object:
        done = super().result()
        if timeout is not None:
            raise TimeoutError
        return done


def test_what_is_done_just_after_the_wait_for_it_is_no_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "Future", DoneLate)
    stop = threading.Event()
    loop = Loop(World(), Nothing(), ClockConfig(), stop)  # type: ignore[arg-type]
    thread = threading.Thread(target=loop.run, args=(Nothing(),))
    thread.start()

    def fail() -> None:
        raise TimeoutError("the job's own")

    try:
        assert loop.call(lambda: 7) == 7
        with pytest.raises(TimeoutError, match="the job's own"):
            loop.call(fail)
    finally:
        stop.set()
        thread.join()


def test_a_turn_after_another_has_its_say_from_the_end_of_that_one() -> None:
    """The first needs time to end; from then on time stands until what the second asked for has begun."""
    loop = Loop(World(), Nothing(), ClockConfig(), threading.Event())  # type: ignore[arg-type]
    with ExitStack() as around:
        first = around.enter_context(loop.turn())
        with loop.turn(first) as second:
            first.begins(threading.Event())
            assert not second.holds
            around.close()
            assert second.holds
            second.begins(threading.Event())
            assert not second.holds


class FirstAdvance(Nothing):
    """Ends the loop after it, and tells how far it went."""

    def __init__(self, world: World, stop: threading.Event) -> None:
        self.world, self.stop = world, stop
        self.time_ns: int | None = None

    def publish(self, skipped: bool) -> None:
        self.time_ns = self.time_ns or self.world.time_ns
        self.stop.set()


def test_what_is_commanded_before_a_jump_is_not_jumped_over() -> None:
    world, stop = World(), threading.Event()
    world.parked = False
    loop = Loop(world, Nothing(), ClockConfig(speed=0, idle_speed=0), stop)  # type: ignore[arg-type]
    loop.holders = Resting([NEVER_NS])  # type: ignore[assignment]
    loop.command(lambda: setattr(world, "still", False))
    seen = FirstAdvance(world, stop)
    loop.run(seen)
    assert seen.time_ns == PERIOD_NS


def test_who_was_waited_for_and_rests_now_keeps_no_period_from_being_jumped_over() -> None:
    class GoesToRest(Resting):
        resting = False

        def may_pass(self, now_ns: int, _then: object) -> bool:
            self.resting = True
            return super().may_pass(now_ns, _then)

    world, stop = World(), threading.Event()
    world.parked = False
    loop = Loop(world, Nothing(), ClockConfig(speed=0, idle_speed=0), stop)  # type: ignore[arg-type]
    loop.holders = GoesToRest([NEVER_NS])  # type: ignore[assignment]
    seen = FirstAdvance(world, stop)
    loop.run(seen)
    assert seen.time_ns == JUMP_NS


class ByHand(queue.SimpleQueue[object]):
    """The loop's jobs, and the wall's time: a wait is over at once, and took as long as it had to."""

    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def get(self, block: bool = True, timeout: float | None = None) -> object:
        if self.empty() and block:
            self.now_s += timeout or 0.0
        return super().get(block=False)


class Listener(Nothing):
    """Notes at which time of the wall each period is published, in periods, and ends after some of them."""

    def __init__(self, wall: ByHand, stop: threading.Event, most: int) -> None:
        self.wall, self.stop, self.most = wall, stop, most
        self.heard: list[int] = []

    def publish(self, skipped: bool) -> None:
        self.heard.append(round(self.wall.now_s * 1e9 / PERIOD_NS))
        if len(self.heard) == self.most:
            self.stop.set()


@pytest.mark.parametrize(
    ("still", "due_s", "heard"),
    [
        pytest.param(True, [], [0, 4, 4, 4, 4, 9, 9, 9, 9, 9, 14], id="nobody has anything to do"),
        pytest.param(True, [0.13], [0, 4, 4, 4, 4, 6, 6, 7, 9, 9, 14], id="somebody has, in the seventh"),
        pytest.param(False, [], [*range(11)], id="something moves"),
    ],
)
def test_while_nothing_moves_nobody_is_woken_for_each_period(
    monkeypatch: pytest.MonkeyPatch, still: bool, due_s: list[float], heard: list[int]
) -> None:
    world, stop, wall = World(parked=False), threading.Event(), ByHand()
    world.still = still
    monkeypatch.setattr(loop_module, "time", wall)
    jobs = SimpleNamespace(SimpleQueue=lambda: wall, Empty=queue.Empty)
    monkeypatch.setattr(loop_module, "queue", jobs)
    loop = Loop(world, Nothing(), ClockConfig(speed=1, idle_speed=400), stop)  # type: ignore[arg-type]
    loop.holders = Resting([*(round(one * 1e9) for one in due_s), NEVER_NS])  # type: ignore[assignment]
    seen = Listener(wall, stop, len(heard))
    loop.run(seen)
    assert seen.heard == heard


def test_of_actions_that_end_at_the_same_time_none_keeps_the_clock() -> None:
    stop = threading.Event()
    loop = Loop(World(), Nothing(), ClockConfig(), stop)  # type: ignore[arg-type]

    def act() -> None:
        for _ in range(2000):
            with loop.turn():
                pass

    threads = [threading.Thread(target=act) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not loop._turns.hold
