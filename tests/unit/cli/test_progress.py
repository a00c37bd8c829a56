"""A command waits as long as something moves, on a clock that the test holds."""

from __future__ import annotations

import os
import time

import pytest

from rodeo.bus.messages import Status
from rodeo_cli.progress import NoProgress, Patience, TooSlow, cpu_s, duration, told_by


class Held:
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def looks(patience: Patience, clock: Held, told: dict[str, object], seconds: int) -> None:
    """Look once a second at the same."""
    for _ in range(seconds):
        clock.now_s += 1.0
        patience.look(told)


def status(**said: object) -> Status:
    return Status.model_validate(
        {
            "process": "robot_sim",
            "pid": 7,
            "ready": False,
            "reason": "",
            "activity": "simulating",
            "progress": None,
            "since_s": 0.0,
            "time_s": time.time(),
            **said,
        }
    )


def test_it_gives_up_when_nothing_has_moved_for_three_minutes() -> None:
    clock = Held()
    patience = Patience(now_s=clock)
    looks(patience, clock, {"bridge": "starting"}, 181)
    with pytest.raises(NoProgress, match="nothing has moved for 3 min"):
        looks(patience, clock, {"bridge": "starting"}, 1)


def test_one_process_that_moves_is_enough_for_an_hour_and_no_longer() -> None:
    clock = Held()
    patience = Patience(now_s=clock)
    for minute in range(60):
        looks(patience, clock, {"bridge": "starting", "robot_sim": minute}, 60)
    with pytest.raises(TooSlow, match="not done after 60 min"):
        looks(patience, clock, {"bridge": "starting", "robot_sim": 60}, 1)


def test_a_process_that_starts_again_and_again_makes_no_step() -> None:
    clock = Held()
    patience = Patience(now_s=clock)
    with pytest.raises(NoProgress):
        for _ in range(100):
            looks(patience, clock, {"oracle": "starting"}, 1)
            looks(patience, clock, {"oracle": "exited with status 1"}, 1)


def test_time_in_which_the_command_itself_was_stopped_does_not_count() -> None:
    clock = Held()
    patience = Patience(now_s=clock)
    looks(patience, clock, {"bridge": "starting"}, 100)
    clock.now_s += 600.0
    patience.look({"bridge": "starting"})
    assert patience.quiet_s < 110.0


def test_it_knows_since_when_each_says_the_same() -> None:
    clock = Held()
    patience = Patience(now_s=clock)
    looks(patience, clock, {"bridge": "starting", "oracle": "starting"}, 10)
    looks(patience, clock, {"bridge": "starting", "oracle": "ready"}, 5)
    assert (patience.since_s("bridge"), patience.since_s("oracle")) == (14.0, 4.0)


def test_a_heartbeat_is_no_news_but_the_sites_time_and_a_block_are() -> None:
    first = told_by(status(details={"speed": 9.9, "site_time_s": 5.0}))
    assert told_by(status(time_s=5.0, details={"speed": 9.7, "site_time_s": 5.0})) == first
    assert told_by(status(details={"site_time_s": 6.0})) != first
    assert told_by(status(details={"site_time_s": 5.0, "block": 3})) != first
    assert told_by(status(reason="waiting for /clock", details={"site_time_s": 5.0})) != first


def test_processor_time_is_that_of_the_process_and_none_of_one_that_ended() -> None:
    before_s = cpu_s(os.getpid())
    end_s = time.process_time() + 0.1
    while time.process_time() < end_s:
        pass
    assert before_s < cpu_s(os.getpid()) <= time.process_time() + 0.1
    assert cpu_s(2**22 + 1) == 0.0


@pytest.mark.parametrize(("seconds", "text"), [(45.2, "45 s"), (180.4, "3 min"), (7200.0, "2 h")])
def test_a_duration_is_told_as_people_do(seconds: float, text: str) -> None:
    assert duration(seconds) == text
