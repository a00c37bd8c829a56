"""The end of a process."""

import signal
import subprocess
import sys
import time


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
