"""A whole site on a disk of its own that fills up: nothing ends, everything says so and continues by itself.

The disk is a tmpfs, where that may be mounted. In tests/unit/test_disk.py the largest file that a process may
write stands in for it.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from rodeo.errors import RemoteError
from rodeo_testing.waiting import wait_until
from tests.integration.test_agent import SITE
from tests.support.live import LiveDao
from tests.support.site import RunningSite, write_site

DISK_MB = 200
WRITERS = ("bridge", "oracle", "itrash", "charger", "robot_sim", "robot_agent")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "tmpfs", str(folder)], capture_output=True
    )
    if mounted.returncode:
        pytest.skip(f"no disk of its own to fill: {mounted.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(path: Path) -> None:
    """Down to the last byte."""
    with path.open("wb", buffering=0) as file:
        block = bytes(1 << 20)
        while block:
            try:
                file.write(block)
            except OSError:
                block = block[: len(block) // 2]
        os.fsync(file.fileno())


def post(organization: LiveDao) -> int:
    """The task, or 0 where the bridge cannot now: it may notice only after it was ready that what it wrote
    while the disk was full was not written."""
    try:
        return organization.clean("item1", request_id="when there is room")
    except RemoteError as refusal:
        assert refusal.passes, refusal
        return 0


@pytest.mark.long
def test_a_full_disk_pauses_every_process_and_ends_none(small_disk: Path, chain_backend: str) -> None:
    with RunningSite(write_site(small_disk, chain_backend, SITE)) as running:
        running.start_founded()
        running.start(*WRITERS)
        pids = {name: child.pid for name, child in running.children.items()}
        fill(small_disk / "filler")
        for name in WRITERS:
            status = running.wait_for_status(name, lambda status: not status.ready)
            # Who was just writing says what it could not write.
            named = "MB are left in" in status.reason or "is full" in status.reason
            assert named, (name, status.reason)
        (small_disk / "filler").unlink()
        running.wait_ready(*WRITERS)
        with closing(LiveDao(running)) as organization:
            task_id = wait_until(lambda: post(organization))
            organization.wait_for_event("TaskSettled", task_id)
        assert {name: child.pid for name, child in running.children.items() if child.poll() is None} == pids
        for name in WRITERS:
            log = (running.site.data_dir / "logs" / f"{name}.log").read_text()
            assert "Traceback" not in log, name
            assert all(line.startswith("20") for line in log.splitlines()), name
