"""The end of a process."""

import signal
import subprocess
import sys
import time

import pytest

from rodeo.instance import GAVE_UP


def test_a_process_that_was_asked_to_stop_is_gone_in_time_whatever_it_waits_for() -> None:
    waits_for_ever = """
import sys, threading
from rodeo.service import supervise

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
        _, log = child.communicate(timeout=10)
    finally:
        child.kill()
    assert child.returncode == 0
    assert time.monotonic() - asked_s >= 0.5
    assert "leaving what does not end within 0.5 s" in log
    assert "Traceback" not in log


@pytest.mark.parametrize(
    ("error", "status"), [("ConfigError", GAVE_UP), ("KeystoreMissing", 1), ("ValueError", 1)]
)
def test_the_exit_status_says_whether_a_restart_may_cure_it(error: str, status: int) -> None:
    fails = f"""
import sys
from rodeo.errors import *
from rodeo.service import supervise

def body(stop):
    raise {error}("the reason")

sys.exit(supervise("failing", body))
"""
    ended = subprocess.run([sys.executable, "-c", fails], capture_output=True, text=True, timeout=30)
    assert ended.returncode == status
    assert "the reason" in ended.stderr
