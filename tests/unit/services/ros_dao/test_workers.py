"""Requests beyond what can wait are refused, and what is away is asked again."""

from __future__ import annotations

import threading

import pytest

from rodeo.errors import NoResponder, RemoteError
from rodeo_testing.waiting import wait_until
from services.ros_dao import workers
from services.ros_dao.workers import MOST_WAITING, Busy, Follower, Workers


def test_what_finds_no_place_is_refused_at_once_and_taken_again_later() -> None:
    go, done = threading.Event(), list[int]()
    pool = Workers("test", 1)
    for number in range(1 + MOST_WAITING):
        pool.submit(lambda number=number: (go.wait(), done.append(number)))  # type: ignore[misc]
    with pytest.raises(Busy):
        pool.submit(lambda: done.append(-1))
    go.set()
    wait_until(lambda: len(done) == 1 + MOST_WAITING)
    pool.submit(lambda: done.append(-1))
    wait_until(lambda: done[-1] == -1)
    pool.close()


def test_a_request_that_fails_keeps_no_place() -> None:
    pool, done = Workers("test", 1), threading.Event()

    def fail() -> None:
        raise ZeroDivisionError

    for _ in range(3 * MOST_WAITING):
        wait_until(lambda: _taken(pool, fail))
    wait_until(lambda: _taken(pool, done.set))
    wait_until(done.is_set)
    pool.close()


def _taken(pool: Workers, work: object) -> bool:
    try:
        pool.submit(work)  # type: ignore[arg-type]
    except Busy:
        return False
    return True


def test_what_is_away_is_asked_until_it_answers_and_what_is_refused_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(workers, "RETRY_S", 0.0)
    follower, calls = Follower(), {"away": 0, "refused": 0}

    def away() -> None:
        calls["away"] += 1
        if calls["away"] < 3:
            raise NoResponder("nobody", key="k")

    def refused() -> None:
        calls["refused"] += 1
        raise RemoteError("wrong_state", "no")

    follower.soon(b"1", away)
    follower.soon(b"2", refused)
    wait_until(lambda: calls == {"away": 3, "refused": 1})
    follower.close()
    assert calls == {"away": 3, "refused": 1}
