"""One instance of a process per site."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from rodeo.errors import AlreadyRunning
from rodeo.host.instance import forget_ending, last_ending, lock_holder, lock_instance, note_ending
from rodeo_testing.waiting import HANG_S

HOLDS = """
import sys
from pathlib import Path
from rodeo.host.instance import lock_instance

lock_instance(Path(sys.argv[1]))
print(flush=True)
input()
"""


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


def test_a_holder_that_is_ending_is_waited_for(tmp_path: Path) -> None:
    lock = lock_instance(tmp_path)
    threading.Timer(0.3, os.close, (lock,)).start()
    os.close(lock_instance(tmp_path, wait_s=10.0))


def test_who_is_asked_to_stop_waits_for_no_holder(tmp_path: Path) -> None:
    lock = lock_instance(tmp_path)
    stop = threading.Event()
    stop.set()
    with pytest.raises(AlreadyRunning):
        lock_instance(tmp_path, wait_s=60.0, stop=stop)
    os.close(lock)


def test_how_a_process_ended_is_known_until_it_starts_again(tmp_path: Path) -> None:
    note_ending(tmp_path, "config_error: no", gave_up=True)
    ending = last_ending(tmp_path)
    assert ending is not None
    assert (ending.reason, ending.gave_up, ending.pid) == ("config_error: no", True, os.getpid())
    forget_ending(tmp_path)
    assert last_ending(tmp_path) is None


def test_a_second_instance_leaves_no_ending_in_the_folder_of_the_first(tmp_path: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert holder.stdout is not None
    holder.stdout.readline()
    note_ending(tmp_path, "already_running", gave_up=True)
    holder.communicate(b"\n", timeout=HANG_S)
    assert last_ending(tmp_path) is None
