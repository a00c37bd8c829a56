"""The clock waits for those who hold it: real sessions on a real router, the simulation's side and theirs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
import zenoh

from rodeo.bus.holding import EVERYBODY
from rodeo.bus.receiving import direct
from rodeo.bus.session import Bus
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import robot_process
from rodeo_testing.waiting import HANG_S, PAUSE_S, wait_until
from services.robot_sim import holders as holders_module
from services.robot_sim import messages
from services.robot_sim import roster as roster_module
from services.robot_sim import standstill as standstill_module
from services.robot_sim.holders import Holders
from services.robot_sim.roster import NEVER_NS, Session
from services.robot_sim.standstill import LONG_S
from tests.support.site import LAB

NEVER = threading.Event()
BLOCK = zenoh.CongestionControl.BLOCK
"""By default a busy router drops what is put."""


class Simulator:
    """The simulator's side: a clock that is published, and whoever holds it."""

    def __init__(
        self,
        session: zenoh.Session,
        site: Site,
        asking: zenoh.Session,
        missing: Callable[[], frozenset[str]] = frozenset,
        taken: Callable[[], bool] = lambda: True,
    ) -> None:
        self.session = session
        self.now_ns_ = 1_000_000_000_000
        self.told: list[str] = []
        self.wake: Callable[[], None] = lambda: None
        node = Node(session, "lab", "", site.bus.domain_id, self)
        self._clock = node.publisher(topics.CLOCK.name(), topics.CLOCK.type)
        self.holders = Holders(
            Bus(session), site, lambda: self.wake(), self.told.append, asking, missing, taken
        )

    def now_ns(self) -> int:
        return self.now_ns_

    def tell_time(self) -> None:
        self._clock.publish(messages.clock(self.now_ns_), self.now_ns_)

    def then(self, send: Callable[[], None]) -> None:
        self.tell_time()
        send()

    def passes(self) -> bool:
        """Whether the time may go on now."""
        return self.holders.may_pass(self.now_ns_, self.then)

    def wait_to_pass(self) -> None:
        """Until the time may go on."""
        wait_until(self.passes, lambda: f"the clock stands still: {self.holders.roster.late()}")

    def stands(self, mind: Mind) -> bool:
        """Whether the time stays, also once `mind` has heard twice that it is asked again."""
        for _ in range(2):
            with (
                patch.object(holders_module, "_REPEAT_S", -1.0),
                patch.object(holders_module, "_BEGIN_S", -1.0),
            ):
                if self.passes():
                    return False
            wait_until(lambda: mind.heard == self.holders.marks.number)
        return not self.passes()

    def advance(self, seconds: float) -> None:
        self.now_ns_ += round(seconds * 1e9)


class Mind:
    """A process that follows and holds the clock; `work` runs in its acting thread."""

    def __init__(
        self, session: zenoh.Session, site: Site, name: str = "robot_agent", starting: bool = False
    ) -> None:
        self.session = session
        self.clock = SimClock(session, site.bus.domain_id, (site.org, name), starting)
        assert self.clock.holder is not None
        self.holder = self.clock.holder

    @property
    def heard(self) -> int:
        """Number of the last mark that it heard."""
        return self.holder.heard

    def start(self, work: Callable[[], object]) -> threading.Thread:
        def run() -> None:
            with self.clock.acting():
                work()

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        return thread


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine may be slow: nobody is asked again, or left out, for that."""
    monkeypatch.setattr(holders_module, "_REPEAT_S", HANG_S)
    monkeypatch.setattr(holders_module, "_BEGIN_S", HANG_S)


@pytest.fixture
def site() -> Site:
    return Site.load(LAB)


def holding(site: Site, *holders: str) -> Site:
    """The site whose clock they hold."""
    return site.model_copy(update={"clock": site.clock.model_copy(update={"holders": list(holders)})})


@pytest.fixture
def simulator(connect: Callable[[], zenoh.Session], site: Site) -> Simulator:
    simulator = Simulator(connect(), site, connect())
    simulator.wait_to_pass()  # nobody is there
    return simulator


@pytest.fixture
def mind(connect: Callable[[], zenoh.Session], site: Site, simulator: Simulator) -> Mind:
    mind = Mind(connect(), site)
    wait_until(lambda: simulator.tell_time() or mind.clock.wait_ready(NEVER, PAUSE_S))
    return mind


def begin(mind: Mind, simulator: Simulator, work: Callable[[], object]) -> threading.Thread:
    """Start `work`, and wait until the simulator knows that it holds the clock."""
    thread = mind.start(work)
    wait_until(lambda: simulator.holders.roster.seen)
    return thread


def begin_as_second(mind: Mind, simulator: Simulator, work: Callable[[], object]) -> None:
    mind.start(work)
    wait_until(lambda: len(simulator.holders.roster.seen) == 2)


def test_the_clock_does_not_pass_who_is_busy(simulator: Simulator, mind: Mind) -> None:
    done = threading.Event()
    begin(mind, simulator, lambda: (done.wait(HANG_S), mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)))
    assert simulator.stands(mind)
    done.set()
    simulator.wait_to_pass()


def test_the_clock_stops_at_the_time_for_which_somebody_waits(simulator: Simulator, mind: Mind) -> None:
    woken_ns: list[int] = []
    until_s = simulator.now_ns_ * 1e-9 + 0.05

    def work() -> None:
        mind.clock.wait_until(until_s)
        woken_ns.append(mind.clock.now_ns())
        mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)

    begin(mind, simulator, work)
    passed_ns = []
    for _ in range(10):
        simulator.wait_to_pass()
        passed_ns.append(simulator.now_ns_)
        simulator.advance(0.02)
    # At 0.06 s it is due. It is awake before the time advances, whatever the machine does meanwhile.
    assert woken_ns == [passed_ns[3]]


def test_only_who_has_something_to_do_is_asked_when_its_time_comes(
    simulator: Simulator, mind: Mind, connect: Callable[[], zenoh.Session], site: Site
) -> None:
    other = Mind(connect(), site, "itrash")
    until_s = simulator.now_ns_ * 1e-9 + 0.05
    looks: list[int] = []

    def timer() -> None:
        # A check is no work of which others hear.
        mind.clock.wait_for(
            NEVER.is_set, until_s=until_s + HANG_S, wall_s=HANG_S, every_s=0.05, check=lambda: looks.append(1)
        )

    begin(mind, simulator, timer)
    begin_as_second(other, simulator, lambda: other.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    simulator.wait_to_pass()
    asked, marks = other.heard, simulator.holders.marks.number
    for _ in range(10):
        simulator.advance(0.02)
        simulator.wait_to_pass()
    assert simulator.holders.marks.number - marks >= 3
    assert mind.heard == simulator.holders.marks.number
    assert other.heard == asked
    simulator.holders.sent()
    simulator.wait_to_pass()
    assert other.heard == simulator.holders.marks.number


def test_what_passes_between_threads_of_one_process_has_nobody_else_asked(
    simulator: Simulator, mind: Mind
) -> None:
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    simulator.wait_to_pass()

    def asked_after(within: bool) -> int:
        marks = simulator.holders.marks.number
        handing_over = mind.clock.hold(within)
        with handing_over:
            wait_until(lambda: any(one.hold.busy for one in simulator.holders.roster.seen.values()))
            assert not simulator.passes()
        simulator.wait_to_pass()
        return simulator.holders.marks.number - marks

    assert asked_after(within=True) == 0
    assert asked_after(within=False) == 1


@pytest.mark.parametrize("way", ["put", "query", "query_all", "publish"])
def test_only_work_in_which_something_was_sent_has_others_asked(
    simulator: Simulator, mind: Mind, site: Site, way: str
) -> None:
    bus, node = Bus(mind.session), Node(mind.session, "mind", "", site.bus.domain_id, mind.clock)
    served = bus.serve("asked", lambda _request: {})
    word = node.publisher("word", "std_msgs/msg/Empty")
    ways: dict[str, Callable[[], object]] = {
        "put": lambda: bus.put_json("news", {}),
        "query": lambda: bus.query("asked"),
        "query_all": lambda: bus.query_all("nobody", parameters={}, timeout_s=HANG_S, most=1),
        "publish": lambda: word.publish(types.new("std_msgs/msg/Empty")),
    }
    asked: list[Callable[[], object]] = []
    done: list[object] = []

    def work() -> None:
        while mind.clock.wait_for(lambda: bool(asked), wall_s=HANG_S):
            done.append(asked.pop()())

    def do(what: Callable[[], object]) -> None:
        count = len(done) + 1
        asked.append(what)
        mind.clock.notify()
        wait_until(lambda: len(done) == count)

    def works() -> int:
        (one,) = simulator.holders.roster.seen.values()
        return one.hold.works

    begin(mind, simulator, work)
    simulator.wait_to_pass()
    before = works()
    do(lambda: None)
    do(ways[way])
    wait_until(lambda: works() != before)
    simulator.wait_to_pass()
    assert works() == before + 1
    served.undeclare()
    node.close()


def test_who_hears_nothing_but_the_time_is_not_asked_about_what_the_simulation_sent(
    connect: Callable[[], zenoh.Session], site: Site
) -> None:
    own = holding(site, "robot_agent", "bridge")
    simulator = Simulator(connect(), own, connect())
    mind, bridge = (Mind(connect(), own, name) for name in ("robot_agent", "bridge"))
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    begin_as_second(bridge, simulator, lambda: bridge.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    simulator.wait_to_pass()
    heard = bridge.heard
    simulator.holders.sent()
    simulator.wait_to_pass()
    assert mind.heard == simulator.holders.marks.number
    assert bridge.heard == heard
    # What it does itself is heard by others, and it answers like them.
    with bridge.clock.hold():
        wait_until(lambda: not simulator.passes())
    simulator.wait_to_pass()
    assert bridge.heard == simulator.holders.marks.number


def test_what_was_sent_is_taken_before_the_time_goes_on(simulator: Simulator, mind: Mind) -> None:
    taken: list[int] = []
    arrived: list[int] = []

    def take(_sample: zenoh.Sample) -> None:
        arrived.append(1)
        mind.clock.notify()

    subscriber = mind.session.declare_subscriber("news", zenoh.handlers.Callback(take, indirect=False))

    def work() -> None:
        while len(taken) < 20:
            mind.clock.wait_for(lambda: len(arrived) > len(taken), wall_s=HANG_S)
            taken.append(mind.clock.now_ns())
        mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)

    begin(mind, simulator, work)
    simulator.wait_to_pass()
    sent_ns = []
    for _ in range(20):
        simulator.advance(0.02)
        simulator.then(lambda: simulator.session.put("news", b"", congestion_control=BLOCK))
        sent_ns.append(simulator.now_ns_)
        simulator.holders.sent()
        simulator.wait_to_pass()
    subscriber.undeclare()
    assert taken == sent_ns


def test_nobody_is_busy_with_news_for_which_he_does_not_wait(simulator: Simulator, mind: Mind) -> None:
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    simulator.wait_to_pass()
    said: list[bytes] = []
    everybody = topics.CLOCK_HOLD.name(org="*", process="*", session="*")
    listener = simulator.session.declare_subscriber(
        everybody,
        zenoh.handlers.Callback(lambda sample: said.append(sample.payload.to_bytes()), indirect=False),
    )
    for _ in range(3):
        for _ in range(100):
            mind.clock.notify()
        simulator.holders.sent()
        simulator.wait_to_pass()
    listener.undeclare()
    # The answers to the marks; the last may be under way.
    assert 2 <= len(said) <= 3


def test_who_only_looks_whether_to_go_on_is_not_asked_for_it(simulator: Simulator, mind: Mind) -> None:
    looks: list[int] = []
    begin(
        mind,
        simulator,
        lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S, check=lambda: looks.append(1)),
    )
    simulator.wait_to_pass()
    marks = simulator.holders.marks.number
    wait_until(lambda: len(looks) >= 5)
    simulator.advance(0.02)
    simulator.wait_to_pass()
    assert simulator.holders.marks.number == marks


def test_a_look_at_what_was_sent_takes_no_time(simulator: Simulator, mind: Mind) -> None:
    seen_ns: list[int] = []
    arrived: list[int] = []

    def take(_sample: zenoh.Sample) -> None:
        arrived.append(1)
        mind.clock.notify()

    def look() -> None:
        NEVER.wait(0.05)
        if arrived and not seen_ns:
            seen_ns.append(mind.clock.now_ns())

    subscriber = mind.session.declare_subscriber("news", zenoh.handlers.Callback(take, indirect=False))
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S, check=look))
    simulator.wait_to_pass()
    simulator.advance(0.02)
    simulator.then(lambda: simulator.session.put("news", b"", congestion_control=BLOCK))
    simulator.holders.sent()
    sent_ns = simulator.now_ns_
    simulator.wait_to_pass()
    simulator.advance(0.02)
    simulator.tell_time()
    subscriber.undeclare()
    assert seen_ns == [sent_ns]


def test_what_a_look_raises_ends_the_wait(simulator: Simulator, mind: Mind) -> None:
    raised: list[Exception] = []

    def refuse() -> None:
        raise ValueError("enough")

    def work() -> None:
        try:
            mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S, check=refuse)
        except ValueError as error:
            raised.append(error)

    begin(mind, simulator, work).join(HANG_S)
    assert [str(error) for error in raised] == ["enough"]
    simulator.wait_to_pass()


def test_who_looks_at_each_reading_is_asked_at_each(simulator: Simulator, mind: Mind) -> None:
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S, every_s=0.1))
    simulator.wait_to_pass()
    marks = simulator.holders.marks.number
    for _ in range(50):
        simulator.advance(0.02)
        simulator.wait_to_pass()
    assert simulator.holders.marks.number == marks + 10


def test_who_dies_while_it_holds_the_clock_is_not_waited_for(simulator: Simulator, mind: Mind) -> None:
    done = threading.Event()
    begin(mind, simulator, lambda: done.wait(HANG_S))
    assert simulator.stands(mind)
    mind.session.close()
    simulator.wait_to_pass()
    done.set()


def hears_through(monkeypatch: pytest.MonkeyPatch, passes: Callable[[zenoh.Sample], bool]) -> None:
    """The next simulator hears of a sample only if `passes` returns True."""

    def handler(callback: Callable[[Any], object], drop: Callable[[], object] | None = None) -> Any:
        return direct(lambda got: callback(got) if passes(got) else None, drop)

    monkeypatch.setattr(roster_module, "direct", handler)


def test_who_dies_busy_and_whose_end_is_not_heard_is_found_gone(
    connect: Callable[[], zenoh.Session], site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    hears_through(monkeypatch, lambda got: getattr(got, "kind", None) is not zenoh.SampleKind.DELETE)
    simulator = Simulator(connect(), site, connect())
    mind, next_one = Mind(connect(), site), Mind(connect(), site)
    wait_until(lambda: simulator.tell_time() or mind.clock.wait_ready(NEVER, PAUSE_S))
    done = threading.Event()
    begin(mind, simulator, lambda: done.wait(HANG_S))
    begin_as_second(next_one, simulator, lambda: next_one.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    mind.session.close()
    monkeypatch.setattr(holders_module, "_REPEAT_S", 0.05)
    simulator.wait_to_pass()
    done.set()
    held_by = [one.id for one in simulator.holders.roster.seen]
    assert held_by == [str(next_one.session.info.zid())]


def test_who_is_asked_about_and_there_is_waited_for(simulator: Simulator, mind: Mind) -> None:
    done = threading.Event()
    begin(mind, simulator, lambda: done.wait(HANG_S))
    assert simulator.stands(mind)  # asked again, and about
    done.set()
    simulator.wait_to_pass()


def test_who_comes_late_is_waited_for_from_then_on(
    connect: Callable[[], zenoh.Session], site: Site, simulator: Simulator, mind: Mind
) -> None:
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    for _ in range(5):
        simulator.wait_to_pass()
        simulator.holders.sent()
    late = Mind(connect(), site, "itrash")
    done = threading.Event()
    late.start(lambda: (done.wait(HANG_S), late.clock.wait_for(NEVER.is_set, wall_s=HANG_S)))
    wait_until(lambda: len(simulator.holders.roster.seen) == 2)
    assert simulator.stands(late)
    done.set()
    simulator.wait_to_pass()


def test_a_simulator_that_starts_again_waits_for_those_who_are_there(
    connect: Callable[[], zenoh.Session], site: Site, simulator: Simulator, mind: Mind
) -> None:
    done = threading.Event()
    begin(mind, simulator, lambda: (done.wait(HANG_S), mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)))
    simulator.holders.close()
    again = Simulator(connect(), site, connect())
    assert not again.passes()
    wait_until(lambda: again.holders.roster.seen)
    assert again.stands(mind)
    done.set()
    again.wait_to_pass()


def test_the_first_simulator_waits_for_who_was_busy_before_it_came(
    connect: Callable[[], zenoh.Session], site: Site
) -> None:
    done = threading.Event()
    everybody = topics.CLOCK_HOLD.name(org=site.org, process="*", session="*")
    asking, listening = connect(), connect()
    said = listening.declare_subscriber(everybody)
    mind = Mind(connect(), site)
    mind.start(lambda: (done.wait(HANG_S), mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)))
    wait_until(lambda: said.try_recv() and list(asking.liveliness().get(everybody)))
    simulator = Simulator(connect(), site, asking)
    assert not simulator.passes()
    wait_until(lambda: simulator.holders.roster.seen)
    assert simulator.stands(mind)
    done.set()
    simulator.wait_to_pass()


def test_a_mark_that_waits_for_the_router_does_not_keep_the_receiving_thread(
    connect: Callable[[], zenoh.Session], site: Site
) -> None:
    def taken() -> bool:
        """Whether the lock is free but for the moments in which a report arrives."""
        lock = simulator.holders.roster.lock
        return lock.acquire(timeout=HANG_S) and lock.release() is None

    simulator = Simulator(connect(), site, connect(), taken=taken)
    mind = Mind(connect(), site)
    wait_until(lambda: simulator.tell_time() or mind.clock.wait_ready(NEVER, PAUSE_S))
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    simulator.holders.sent()
    simulator.wait_to_pass()


def test_who_answers_later_than_it_is_asked_again_has_answered(
    connect: Callable[[], zenoh.Session], site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    late, waits = threading.Event(), [0.0]
    hears_through(monkeypatch, lambda _sample: not late.wait(waits[0]))
    simulator = Simulator(connect(), site, connect())
    mind = Mind(connect(), site)
    wait_until(lambda: simulator.tell_time() or mind.clock.wait_ready(NEVER, PAUSE_S))
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    simulator.wait_to_pass()
    monkeypatch.setattr(holders_module, "_REPEAT_S", 0.05)
    waits[0] = 0.2
    simulator.holders.sent()
    simulator.wait_to_pass()


def test_everybody_is_asked_after_work_during_which_they_were_asked_again(
    simulator: Simulator, mind: Mind
) -> None:
    done = threading.Event()
    begin(mind, simulator, lambda: (done.wait(HANG_S), mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)))
    assert simulator.stands(mind)
    marks = simulator.holders.marks.number
    done.set()
    simulator.wait_to_pass()
    assert simulator.holders.marks.number == marks + 1


def test_who_is_not_to_hold_the_clock_does_not(
    connect: Callable[[], zenoh.Session], site: Site, simulator: Simulator
) -> None:
    stranger = Mind(connect(), site, "console")
    stranger.start(lambda: NEVER.wait(1.0))
    key = topics.CLOCK_HOLD.name(org=site.org, process="itrash", session="0")
    token = stranger.session.liveliness().declare_token(key)
    Bus(stranger.session).put_json(key, {"busy": "yes"})
    simulator.holders.sent()
    simulator.wait_to_pass()
    token.undeclare()


def test_nothing_is_jumped_over_before_a_mind_is_ready(
    connect: Callable[[], zenoh.Session], site: Site, simulator: Simulator
) -> None:
    """It may have looked at something that arrived, and have nothing to do until its sensors are heard."""
    name = robot_process(site, site.robots[0].name)
    mind = Mind(connect(), site, name, starting=True)
    with mind.clock.hold():
        pass
    wait_until(lambda: simulator.holders.roster.seen)
    simulator.wait_to_pass()
    assert not simulator.holders.resting
    mind.clock.started()
    wait_until(lambda: simulator.holders.resting)
    simulator.wait_to_pass()


def test_the_last_word_of_who_has_gone_holds_nothing(
    connect: Callable[[], zenoh.Session], site: Site, simulator: Simulator
) -> None:
    # As when the token's end overtakes it, and when the next of this name is there already.
    successor = Mind(connect(), site)
    late = {"heard": 0, "busy": True, "until_ns": None, "works": 1, "resting": False}
    key = topics.CLOCK_HOLD.name(org=site.org, process="robot_agent", session="0")
    Bus(successor.session).put_json(key, late)
    simulator.holders.sent()
    simulator.wait_to_pass()


def test_who_dies_busy_is_not_waited_for_though_the_next_of_its_name_is_there(
    connect: Callable[[], zenoh.Session], site: Site, simulator: Simulator, mind: Mind
) -> None:
    done = threading.Event()
    begin(mind, simulator, lambda: done.wait(HANG_S))
    successor = Mind(connect(), site)
    assert simulator.stands(mind)
    mind.session.close()
    simulator.wait_to_pass()
    assert not successor.session.is_closed()
    done.set()


def test_a_mark_that_is_lost_is_sent_again(
    simulator: Simulator, mind: Mind, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    simulator.wait_to_pass()
    simulator.holders.sent()
    lost: list[object] = []
    assert not simulator.holders.may_pass(simulator.now_ns_, lost.append)
    assert len(lost) == 1
    monkeypatch.setattr(holders_module, "_REPEAT_S", 0.05)
    simulator.wait_to_pass()


def test_a_last_word_that_is_lost_is_asked_for_again(
    simulator: Simulator, mind: Mind, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = threading.Event()
    begin(mind, simulator, lambda: (done.wait(HANG_S), mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)))
    assert simulator.stands(mind)
    said: list[str] = []
    with monkeypatch.context() as away:
        away.setattr(mind.holder, "_publisher", SimpleNamespace(put=said.append))
        done.set()
        wait_until(lambda: said)
    monkeypatch.setattr(holders_module, "_REPEAT_S", 0.05)
    simulator.wait_to_pass()


def test_a_mark_that_is_none_is_left_out(
    simulator: Simulator, mind: Mind, site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    begin(mind, simulator, lambda: mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S))
    # The last one overflows the stack of who reads it with json.loads where py-evm has lifted the limit.
    nonsense = (b"", b"[]", b'{"number": null}', b"\xff", b'{"number": 1e999}', b"[" * 100_000)
    key = topics.CLOCK_MARK.name(org=site.org, to=EVERYBODY)
    for text in nonsense:
        simulator.session.put(key, text, congestion_control=BLOCK)
    simulator.holders.sent()
    simulator.wait_to_pass()
    assert caplog.text.count("not a ClockMark") == len(nonsense)


def test_what_somebody_says_of_a_time_far_off_is_heard(
    simulator: Simulator, connect: Callable[[], zenoh.Session], site: Site
) -> None:
    """A time that is no float any more, as anybody on the bus may say."""
    session = connect()
    who = Session("robot_agent", str(session.info.zid()))
    key = topics.CLOCK_HOLD.name(org=site.org, process=who.process, session=who.id)
    token = session.liveliness().declare_token(key)
    wait_until(lambda: who in simulator.holders.roster.there)
    said = '{"heard": 0, "busy": false, "until_ns": %s, "works": 0, "resting": true}'
    session.put(key, said % ("9" * 400), congestion_control=BLOCK)
    wait_until(lambda: who in simulator.holders.roster.seen)
    assert simulator.holders.next_ns == NEVER_NS
    token.undeclare()


def test_who_holds_it_for_long_is_named_until_it_goes_on(
    simulator: Simulator,
    mind: Mind,
    connect: Callable[[], zenoh.Session],
    site: Site,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall_s = 0.0
    monkeypatch.setattr(standstill_module, "time", SimpleNamespace(monotonic=lambda: wall_s))
    done = threading.Event()
    begin(mind, simulator, lambda: (done.wait(HANG_S), mind.clock.wait_for(NEVER.is_set, wall_s=HANG_S)))
    brief = Mind(connect(), site, "itrash")
    for wall_s in (1.0, 1.0 + 0.9 * LONG_S, 1.0 + 1.1 * LONG_S):  # noqa: B007
        # It comes and goes, and is there when the other is named.
        with brief.clock.hold():
            wait_until(lambda: "itrash" in {who.process for who in simulator.holders.roster.late()})
            assert not simulator.passes()
        wait_until(lambda: "itrash" not in {who.process for who in simulator.holders.roster.late()})
        assert not simulator.passes()
    assert simulator.told == ["the clock waits for robot_agent"]
    done.set()
    simulator.wait_to_pass()
    assert simulator.told[-1] == ""
    figures = simulator.holders.standstill.figures
    assert figures["waited_s"] == pytest.approx(1.1 * LONG_S)
    assert figures["waited_for_s"]["robot_agent"] == pytest.approx(1.1 * LONG_S)
    assert figures["waited_for_s"]["itrash"] < LONG_S


def test_an_experiment_begins_when_everybody_has_come_and_motion_capture_can_sign(
    connect: Callable[[], zenoh.Session], site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = holding(site, "robot_agent", "oracle", "arrivals")
    enrolled = threading.Event()
    simulator = Simulator(
        connect(), own, connect(), lambda: frozenset() if enrolled.is_set() else frozenset({"mocap"})
    )
    minds = [Mind(connect(), own, name) for name in ("robot_agent", "arrivals")]
    monkeypatch.setattr(holders_module, "_REPEAT_S", -1.0)
    monkeypatch.setattr(holders_module, "_BEGIN_S", -1.0)
    wait_until(lambda: len(simulator.holders.roster.there) == 2)
    assert not simulator.passes()
    assert minds[0].clock.wait_ready(NEVER, HANG_S)  # who comes hears what time it is
    Mind(connect(), own, "oracle")
    wait_until(lambda: len(simulator.holders.roster.there) == 3)
    assert not simulator.passes()
    enrolled.set()
    simulator.wait_to_pass()
