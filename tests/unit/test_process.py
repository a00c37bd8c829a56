"""The end of a process."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.session import Bus
from rodeo.host.instance import GAVE_UP
from rodeo.runtime.process import Process
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.clock import publish_clock
from tests.support.nodes import router_port as router_port
from tests.support.site import write_site


def test_a_process_that_was_asked_to_stop_is_gone_in_time_whatever_it_waits_for() -> None:
    waits_for_ever = """
import sys, threading
from rodeo.runtime.process import supervise

def body(stop):
    print("up", flush=True)
    threading.Event().wait()

sys.exit(supervise("stuck", body, stop_s=0.5))
"""
    child = subprocess.Popen(
        [sys.executable, "-c", waits_for_ever], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "up\n"
    asked_s = time.monotonic()
    child.send_signal(signal.SIGTERM)
    try:
        _, log = child.communicate(timeout=HANG_S)
    finally:
        child.kill()
    assert child.returncode == 0
    assert time.monotonic() - asked_s >= 0.5
    assert "exiting because the shutdown took longer than 0.5 s" in log
    assert "Traceback" not in log


@pytest.mark.long
@pytest.mark.parametrize(
    ("error", "status"), [("ConfigError", GAVE_UP), ("KeystoreMissing", 1), ("ValueError", 1)]
)
def test_the_exit_status_says_whether_a_restart_may_cure_it(error: str, status: int) -> None:
    fails = f"""
import sys
from rodeo.errors import *
from rodeo.runtime.process import supervise

def body(stop):
    raise {error}("the reason")

sys.exit(supervise("failing", body))
"""
    ended = subprocess.run([sys.executable, "-c", fails], capture_output=True, text=True, timeout=HANG_S)
    assert ended.returncode == status
    assert "the reason" in ended.stderr


OPEN_BUS = """clock.speed = {speed}
clock.idle_speed = {speed}
bus.open = true
bus.router = "tcp/127.0.0.1:{port}"
"""


@pytest.mark.parametrize(
    ("speed", "backend", "off_s", "reason"),
    [
        (1, "eth-tester", -7, "clock 7 s behind wall time; see robot_sim in `rodeo status`"),
        (1, "external", -7, "clock 7 s behind wall time; see robot_sim in `rodeo status`"),
        (1, "external", 7, "clock 7 s ahead of wall time; it waits for wall time to catch up"),
        (1, "eth-tester", 7, ""),
        (1, "eth-tester", 0, ""),
        (10, "eth-tester", -7, ""),
    ],
)
def test_a_process_whose_clock_should_be_the_walls_and_is_not_is_not_ready(
    tmp_path: Path, router_port: int, speed: int, backend: str, off_s: int, reason: str
) -> None:
    path = write_site(tmp_path, backend, OPEN_BUS.format(speed=speed, port=router_port))
    site = Site.load(path)
    with (
        Bus.open(site.bus.router, timeout_s=HANG_S) as bus,
        Process("oracle", site, threading.Event()) as process,
    ):
        process.ready()
        assert process.status().ready, "who needs the clock waits for it"

        def follows() -> bool:
            publish_clock(bus, site.bus.domain_id, time.time() + off_s)
            return process.clock.wait_ready(threading.Event(), 0.05)  # type: ignore[attr-defined]

        wait_until(follows)
        status = process.status()
        assert (status.ready, status.reason) == (not reason, reason)


def test_that_it_is_ready_is_said_at_once_and_not_with_the_next_heartbeat(
    tmp_path: Path, router_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rodeo.runtime.presence.HEARTBEAT_S", 3600.0)
    site = Site.load(write_site(tmp_path, extra=OPEN_BUS.format(speed=1, port=router_port)))
    heard = threading.Event()

    def on_status(_key: str, data: dict[str, Any]) -> None:
        if data["ready"]:
            heard.set()

    with (
        Bus.open(site.bus.router, timeout_s=HANG_S) as bus,
        Process("oracle", site, threading.Event()) as process,
    ):
        bus.subscribe_json(f"rodeo/{site.org}/status/oracle", on_status)

        def said() -> bool:
            # Again: the first may be said before the router knows who listens.
            process.not_ready("starting")
            process.ready()
            return heard.wait(0.05)

        wait_until(said)
