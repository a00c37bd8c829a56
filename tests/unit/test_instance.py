"""One instance of a process per site."""

import os
from pathlib import Path

import pytest

from rodeo.errors import AlreadyRunning
from rodeo.instance import lock_holder, lock_instance


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
