"""One instance of a process per site."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rodeo.errors import AlreadyRunning
from rodeo.service import lock_holder, lock_instance


def test_a_second_instance_is_refused_and_told_who_runs(tmp_path: Path) -> None:
    lock = lock_instance(tmp_path / "oracle")
    with pytest.raises(AlreadyRunning, match=f"as process {os.getpid()}"):
        lock_instance(tmp_path / "oracle")
    os.close(lock)


def test_the_holder_is_known_while_it_runs_and_nobody_after(tmp_path: Path) -> None:
    assert lock_holder(tmp_path) is None
    lock = lock_instance(tmp_path)
    assert lock_holder(tmp_path) == os.getpid()
    os.close(lock)
    assert lock_holder(tmp_path) is None


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
