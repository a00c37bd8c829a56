"""The simulated time has one speaker, and nobody else moves it while that one stands: over a real router."""

from __future__ import annotations

import json
import struct
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from rodeo.bus.receiving import direct
from rodeo.bus.session import zenoh_config
from rodeo.host import clock as clock_module
from rodeo.host.clock import Patience
from rodeo.ros2.base import Publisher
from rodeo.ros2.node import Node
from rodeo.ros2.types import new
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.nodes import make_node as make_node
from tests.support.nodes import router_port as router_port

MakeNode = Callable[[str], Node]
SECOND_NS = 1_000_000_000
FUTURE_S = 2_000_000_000
KEY = "0/clock/rosgraph_msgs::msg::dds_::Clock_/RIHS01_test"


def clock_at(time_s: int) -> object:
    stamp = new("builtin_interfaces/msg/Time", sec=time_s, nanosec=0)
    return new("rosgraph_msgs/msg/Clock", clock=stamp)


def cdr_at(time_s: int) -> bytes:
    return b"\x00\x01\x00\x00" + struct.pack("<iI", time_s, 0)


def publisher(node: Node) -> Publisher:
    return node.publisher(topics.CLOCK.name(), topics.CLOCK.type)


@pytest.fixture
def follower(make_node: MakeNode) -> Iterator[SimClock]:
    clock = SimClock(make_node("follower").session, 0)
    yield clock
    clock.close()


def reaches(clock: SimClock, time_s: int, say: Callable[[], object]) -> None:
    """Says it again and again until the follower has it."""

    def follows() -> bool:
        say()
        return clock.wait_ready(threading.Event(), 0.05) and clock.now_ns() >= time_s * SECOND_NS

    wait_until(follows)


def refuses(clock: SimClock, say: Callable[[], object]) -> None:
    """Says it again and again until the follower tells of having refused it."""
    wait_until(lambda: say() or clock.warning())


def test_a_second_publisher_does_not_move_the_time_and_is_told_of(
    make_node: MakeNode, follower: SimClock, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = publisher(make_node("lab")), publisher(make_node("lab"))
    reaches(follower, 1000, lambda: first.publish(clock_at(1000)))
    assert follower.warning() == ""
    refuses(follower, lambda: second.publish(clock_at(FUTURE_S)))
    assert follower.now_ns() == 1000 * SECOND_NS
    assert "second publisher on /clock" in follower.warning()
    assert "second publisher on /clock" in caplog.text
    reaches(follower, 1001, lambda: first.publish(clock_at(1001)))


@pytest.mark.parametrize("stamps", [True, False])
def test_bytes_from_a_session_that_announces_nothing_do_not_move_it(
    make_node: MakeNode, follower: SimClock, router_port: int, stamps: bool
) -> None:
    first = publisher(make_node("lab"))
    reaches(follower, 1000, lambda: first.publish(clock_at(1000)))
    config = zenoh_config("client", connect=[f"tcp/127.0.0.1:{router_port}"])
    config.insert_json5("timestamping/enabled", json.dumps({"client": stamps}))
    with zenoh.open(config) as stranger:
        refuses(follower, lambda: stranger.put(KEY, cdr_at(FUTURE_S)))
    assert follower.now_ns() == 1000 * SECOND_NS


def test_nobody_takes_over_unannounced_when_the_body_has_ended(
    make_node: MakeNode, follower: SimClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rodeo.runtime.sim_clock._SILENT_S", 0.0)
    node, stranger = make_node("lab"), make_node("stranger")
    first = publisher(node)
    reaches(follower, 1000, lambda: first.publish(clock_at(1000)))
    node.close()
    refuses(follower, lambda: stranger.session.put(KEY, cdr_at(FUTURE_S)))
    assert follower.now_ns() == 1000 * SECOND_NS


def test_who_may_speak_and_what_is_said_are_heard_in_the_order_in_which_they_arrive(
    make_node: MakeNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both while they are received: in a thread beside, an announcement waits for its turn."""
    received: list[str] = []

    def noted(callback: Any, *more: Any) -> Any:
        received.append(callback.__name__)
        return direct(callback, *more)

    monkeypatch.setattr("rodeo.runtime.sim_clock.direct", noted)
    SimClock(make_node("follower").session, 0).close()
    assert received == ["_on_graph", "_on_clock"]


def test_the_end_of_its_process_ends_a_wait_at_once(
    make_node: MakeNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rodeo.runtime.sim_clock._UNSTOPPED_S", 2 * HANG_S)
    end = threading.Event()
    clock = SimClock(make_node("follower").session, 0, end=end)
    waiting = threading.Thread(target=clock.wait_for, args=(lambda: False, end))
    waiting.start()
    end.set()
    waiting.join(HANG_S)
    assert not waiting.is_alive()
    clock.close()


def test_the_last_words_of_the_speaker_are_no_second_speakers(
    make_node: MakeNode, follower: SimClock
) -> None:
    node = make_node("lab")
    first = publisher(node)
    reaches(follower, 1000, lambda: first.publish(clock_at(1000)))
    node.close()
    reaches(follower, 1001, lambda: node.session.put(KEY, cdr_at(1001)))
    assert follower.warning() == ""


def test_a_process_follows_its_own_clock_like_everybody_elses(make_node: MakeNode) -> None:
    node, stranger = make_node("lab"), make_node("stranger")
    body, own = publisher(node), SimClock(node.session, 0)
    reaches(own, 1000, lambda: body.publish(clock_at(1000)))
    second = publisher(stranger)
    refuses(own, lambda: second.publish(clock_at(FUTURE_S)))
    assert own.now_ns() == 1000 * SECOND_NS
    own.close()


def test_a_copied_gid_does_not_make_a_second_speaker_the_first(
    make_node: MakeNode, follower: SimClock
) -> None:
    first, stranger = publisher(make_node("lab")), make_node("stranger")
    heard: list[zenoh.Sample] = []
    ear = stranger.session.declare_subscriber("0/clock/**", heard.append)
    reaches(follower, 1000, lambda: first.publish(clock_at(1000)))
    reaches(follower, 1001, lambda: first.publish(clock_at(1001)))
    wait_until(lambda: first.publish(clock_at(1001)) or heard)  # a late subscriber may hear a later one
    copied = heard[-1]
    refuses(
        follower,
        lambda: stranger.session.put(
            copied.key_expr, cdr_at(FUTURE_S), attachment=copied.attachment.to_bytes()
        ),
    )
    ear.undeclare()
    assert follower.now_ns() == 1001 * SECOND_NS


def test_a_follower_that_comes_late_knows_who_may_speak(make_node: MakeNode) -> None:
    first, stranger = publisher(make_node("lab")), make_node("stranger")
    late = SimClock(make_node("late").session, 0)
    refuses(late, lambda: stranger.session.put(KEY, cdr_at(FUTURE_S)))
    reaches(late, 1000, lambda: first.publish(clock_at(1000)))
    assert late.now_ns() == 1000 * SECOND_NS
    late.close()


def test_the_next_body_is_followed_once_the_first_has_ended(make_node: MakeNode, follower: SimClock) -> None:
    node = make_node("lab")
    first, next_ = publisher(node), publisher(make_node("lab"))
    reaches(follower, 1000, lambda: first.publish(clock_at(1000)))
    node.close()
    reaches(follower, 1001, lambda: next_.publish(clock_at(1001)))
    assert follower.now_ns() == 1001 * SECOND_NS


def test_the_registered_body_takes_over_from_a_session_that_announced_nothing(
    make_node: MakeNode, follower: SimClock
) -> None:
    early = make_node("early").session
    reaches(follower, 1000, lambda: early.put(KEY, cdr_at(1000)))
    body = publisher(make_node("lab"))
    reaches(follower, 1001, lambda: body.publish(clock_at(1001)))
    refuses(follower, lambda: early.put(KEY, cdr_at(FUTURE_S)))
    assert follower.now_ns() == 1001 * SECOND_NS


def test_who_leaves_the_clock_may_still_have_threads_at_work(make_node: MakeNode) -> None:
    failures: list[Exception] = []

    def work(clock: SimClock, over: threading.Event) -> None:
        try:
            while not over.is_set():
                with clock.hold():
                    clock.notify()
        except Exception as error:  # noqa: BLE001 - asserted below, in the test's thread
            failures.append(error)

    for number in range(10):
        clock = SimClock(make_node(f"process{number}").session, 0, ("org", f"process{number}"))
        over = threading.Event()
        threads = [threading.Thread(target=work, args=(clock, over)) for _ in range(3)]
        for thread in threads:
            thread.start()
        try:
            clock.close()
        finally:
            over.set()
            for thread in threads:
                thread.join()
    assert failures == []


def test_patience_lasts_no_longer_where_the_clock_was_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    site_s = wall_s = 10_000.0
    monkeypatch.setattr(clock_module.time, "monotonic", lambda: wall_s)
    patience = Patience(SimpleNamespace(now_s=lambda: site_s, now_ns=lambda: 0), 10.0)
    site_s -= 3600.0
    assert not patience.is_over
    site_s, wall_s = site_s + 10.0, wall_s + 10.0
    assert patience.is_over
