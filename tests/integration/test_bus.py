"""The bus over a real router: errors keep their code, nothing hangs, and a router may be restarted."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
import zenoh

from rodeo.bus.session import Bus, Handler, Request
from rodeo.commands.treasury import Transfer
from rodeo.errors import (
    BusUnavailable,
    InvalidRequest,
    MalformedAnswer,
    NoResponder,
    QueryTimeout,
    RemoteError,
)
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import RunningSite, free_port


@pytest.fixture
def peer(running: RunningSite) -> Iterator[Bus]:
    """A second process's session, served by the site's router."""
    running.start("router")
    bus = Bus.open(running.site.bus.router, timeout_s=HANG_S)
    yield bus
    bus.close()


@contextmanager
def made_known(asking: Bus, key: str) -> Iterator[None]:
    """Leaves once `asking` knows that `key`, declared inside, is served: that takes its time through the
    router."""
    known = threading.Event()
    querier = asking.session.declare_querier(key)
    listener = querier.declare_matching_listener(lambda status: known.set() if status.matching else None)
    yield
    assert known.wait(HANG_S)
    listener.undeclare()
    querier.undeclare()


def serve(peer: Bus, asking: Bus, key: str, handler: Handler) -> None:
    """Serve `key` and return once `asking` knows."""
    with made_known(asking, key):
        peer.serve(key, handler)


def test_an_answer_comes_back(running: RunningSite, peer: Bus) -> None:
    serve(peer, running.bus, "t/echo", lambda request: {"got": request.json(), "with": request.parameters})
    answer = running.bus.query("t/echo", {"a": 1}, parameters={"limit": 5})
    assert answer == {"got": {"a": 1}, "with": {"limit": "5"}}


def test_an_error_of_the_responder_keeps_code_and_values(running: RunningSite, peer: Bus) -> None:
    def handler(request: Request) -> dict[str, Any]:
        raise InvalidRequest("no such thing", thing=7)

    serve(peer, running.bus, "t/fails", handler)
    with pytest.raises(RemoteError) as caught:
        running.bus.query("t/fails")
    assert (caught.value.code, caught.value.details) == ("invalid_request", {"thing": 7})


@pytest.mark.parametrize(("closed", "error"), [(False, InvalidRequest), (True, BusUnavailable)])
def test_what_is_no_key_and_a_bus_that_was_left_are_told_apart(
    peer: Bus, closed: bool, error: type[Exception]
) -> None:
    if closed:
        peer.close()
    key = "t/key" if closed else "t//key"
    with pytest.raises(error):
        peer.query(key)
    with pytest.raises(error):
        peer.query_all(key, parameters={"a": "1"}, timeout_s=1.0, most=1)


@pytest.mark.parametrize(
    ("payload", "code"),
    [
        (b"{", "malformed_json"),
        (b"[1]", "malformed_json"),
        (b"\xff\xfe", "malformed_json"),
        (b"[" * 100_000, "malformed_json"),
        (b'{"to": "x"}', "invalid_request"),
        (b'{"to": "x", "amount_iec": "-1"}', "invalid_request"),
        (b'{"to": "x", "amount_iec": "NaN"}', "invalid_request"),
        (b'{"to": "x", "amount_iec": "1", "extra": 1}', "invalid_request"),
    ],
)
def test_a_bad_payload_is_the_senders_error_and_the_next_is_served(
    running: RunningSite, peer: Bus, payload: bytes, code: str
) -> None:
    serve(peer, running.bus, "t/transfer", lambda request: request.parse(Transfer).model_dump(mode="json"))
    with pytest.raises(RemoteError) as caught:
        running.bus.query("t/transfer", payload)
    assert caught.value.code == code
    assert running.bus.query("t/transfer", {"to": "x", "amount_iec": "1"})["to"] == "x"


def test_a_handler_that_breaks_answers_and_serves_the_next(running: RunningSite, peer: Bus) -> None:
    serve(peer, running.bus, "t/divide", lambda request: {"value": 1 // request.json()["by"]})
    with pytest.raises(RemoteError) as caught:
        running.bus.query("t/divide", {"by": 0})
    assert caught.value.code == "internal"
    assert running.bus.query("t/divide", {"by": 1}) == {"value": 1}


def test_nobody_serving_and_nobody_answering_are_different_errors(running: RunningSite, peer: Bus) -> None:
    with pytest.raises(NoResponder):
        running.bus.query("t/nobody")
    hold = threading.Event()
    serve(peer, running.bus, "t/slow", lambda request: {"late": hold.wait(HANG_S)})
    with pytest.raises(QueryTimeout):
        running.bus.query("t/slow", timeout_s=0.3)
    hold.set()


@pytest.mark.parametrize("answer", [b"\xff", b"[1]", b'{"code": NaN}'])
@pytest.mark.parametrize("how", ["reply", "reply_err"])
def test_an_answer_that_is_no_json_object_is_the_responders_error(
    running: RunningSite, peer: Bus, how: str, answer: bytes
) -> None:
    def reply(query: zenoh.Query) -> None:
        _ = query.reply("t/garbage", answer) if how == "reply" else query.reply_err(answer)

    with made_known(running.bus, "t/garbage"):
        queryable = peer.session.declare_queryable("t/garbage", reply)
    with pytest.raises(MalformedAnswer) as caught:
        running.bus.query("t/garbage")
    assert caught.value.details["key"] == "t/garbage"
    queryable.undeclare()


def test_an_error_without_a_code_is_malformed(running: RunningSite, peer: Bus) -> None:
    with made_known(running.bus, "t/garbage"):
        queryable = peer.session.declare_queryable("t/garbage", lambda query: query.reply_err(b'{"code": 1}'))
    with pytest.raises(MalformedAnswer):
        running.bus.query("t/garbage")
    queryable.undeclare()


def test_an_error_may_have_any_names(running: RunningSite, peer: Bus) -> None:
    def refuse(_request: Request) -> dict[str, Any]:
        error = InvalidRequest("wrong")
        error.details = {"message": "why", "self": 1}
        raise error

    serve(peer, running.bus, "t/refused", refuse)
    with pytest.raises(RemoteError) as caught:
        running.bus.query("t/refused")
    assert caught.value.details == {"message": "why", "self": 1}


def test_sessions_work_again_after_the_router_was_killed_and_started(running: RunningSite, peer: Bus) -> None:
    heard = threading.Event()
    peer.subscribe_json("t/news", lambda _key, data: heard.set())
    serve(peer, running.bus, "t/echo", lambda request: {})
    running.kill("router")
    running.start("router")

    # The peer reconnects in its own time: publish until it hears, ask until it answers.
    wait_until(lambda: running.bus.put_json("t/news", {}) or heard.is_set())

    def answers() -> bool:
        with suppress(NoResponder):
            return running.bus.query("t/echo") == {}
        return False

    wait_until(answers)


def test_no_router_is_an_error_and_not_a_wait_without_end() -> None:
    with pytest.raises(BusUnavailable):
        Bus.open(f"tcp/127.0.0.1:{free_port()}", timeout_s=0.1)
