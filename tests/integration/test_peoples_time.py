"""A person's window on a site whose time runs faster than theirs."""

from __future__ import annotations

import re
import time

import pytest
from typer.testing import CliRunner

from rodeo_cli import app
from tests.support.dao import Dao
from tests.support.site import NewSite, RunningSite

LEAST_S = 600.0
SITE = f"""clock.speed = 20
clock.idle_speed = 400
agent.explore_when_idle = false
people.min_window_s = {LEAST_S}
participants = [{{ name = "alice" }}]
"""
# The two clocks agree while a machine under load simulates about as fast as real time.
TIME_LEFT = re.compile(r"of site time left, .* on the wall clock at the present speed|\d (s|min) left")


def rodeo(dao: Dao, *arguments: str) -> str:
    done = CliRunner().invoke(app, [*arguments, "--site", str(dao.running.path)])
    assert done.exit_code == 0, done.output
    return " ".join(str(done.output).split())


@pytest.mark.long
def test_a_person_has_the_named_time_on_the_wall_clock_and_is_told_both(new_site: NewSite) -> None:
    with RunningSite(new_site(SITE)) as running:
        running.start("router", "robot_sim", ready=False)
        dao = Dao(running)
        dao.start()
        shortest = ("--min-window", "600", "--grace", "300")
        rodeo(dao, "organization", "kind", "window_cleaning", "--judge", "auditor", *shortest)
        told = rodeo(dao, "service", "offer", "window_cleaning", "--price", "20", "--as", "alice")
        assert "its time, and with it every window, runs up to 400 times as fast" in told
        running.wait_for_status("robot_sim", lambda status: status.details.get("speed", 0) > 4)

        # At 20 times real time this window would last 90 s.
        window_s = 3 * LEAST_S
        terms = {"execution_window_s": round(window_s), "max_attempts": 1}
        task_id = dao.post("30", kind="window_cleaning", params={}, **terms)
        status = running.wait_for_status("robot_sim", lambda one: f"has task {task_id}" in one.activity)
        assert status.activity == f"simulating; slowly, because a person has task {task_id}"
        wall_s, site_s = time.monotonic(), running.status("robot_sim").details["site_time_s"]
        assert TIME_LEFT.search(rodeo(dao, "task", "show", str(task_id)))
        assert TIME_LEFT.search(rodeo(dao, "task", "accept", str(task_id), "--as", "alice"))
        site_s = running.status("robot_sim").details["site_time_s"] - site_s
        assert site_s <= window_s / LEAST_S * (time.monotonic() - wall_s) + 0.1
        rodeo(dao, "task", "submit", str(task_id), "--as", "alice", "--note", "One can see through them.")
        assert dao.task(task_id)["state"] == "submitted"
        rodeo(dao, "task", "judge", str(task_id), "--accept", "--reason", "So one can.")
        running.wait_for_status("robot_sim", lambda one: one.activity == "simulating")
        dao.close()
