"""Losses are counted by the numbers of each sender, and told once."""

from __future__ import annotations

import logging

import pytest
from rodeo_ros1.health import ERROR, OK, WARN, Health


def test_a_gap_in_one_senders_numbers_is_a_loss_and_a_new_beginning_is_none() -> None:
    line = Health().line("odom")
    for sender, sequence in (("a", 5), ("b", 1), ("a", 6), ("a", 9), ("b", 2), ("a", 1), ("a", 2)):
        line.heard(sender, sequence)
        line.passed()
    level, words, values = line.status()
    assert (level, values["lost"], values["carried"]) == (WARN, "2", "7") and "lost" in words


def test_trouble_is_told_at_once_and_then_seldom(caplog: pytest.LogCaptureFixture) -> None:
    line = Health().line("odom")
    with caplog.at_level(logging.WARNING):
        for _ in range(50):
            line.bad("no odometry")
    assert caplog.text.count("no odometry") == 1
    assert line.status()[2]["refused"] == "50"


def test_a_link_that_goes_and_comes_is_told_each_time(caplog: pytest.LogCaptureFixture) -> None:
    health = Health()
    with caplog.at_level(logging.WARNING):
        for there in (True, False, False, True):
            health.router.seen(there)
            expected = OK if there else ERROR
            assert dict(health.statuses())["the router"][0] == expected
    assert [one.getMessage().split(":")[0] for one in caplog.records] == [
        "the router is gone",
        "the router is back",
    ]


def test_the_numbers_of_many_senders_do_not_fill_the_memory() -> None:
    line = Health().line("odom")
    for sender in range(10_000):
        line.heard(sender, 1)
    # The oldest are forgotten, the newest are not.
    line.heard(0, 50)
    assert line.status()[2]["lost"] == "0"
    line.heard(9_999, 50)
    assert line.status()[2]["lost"] == "48"
