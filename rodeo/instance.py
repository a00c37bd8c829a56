"""One process of a kind per site: the lock on its data, by which others see that it runs."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from rodeo.errors import AlreadyRunning

HEARTBEAT_S = 1.0
"""Wall time between two states that a running process publishes."""

GAVE_UP = 78
"""Exit status of a process that no restart can cure: EX_CONFIG of sysexits.h."""

PARENT_VARIABLE = "RODEO_PARENT"
"""Set by a launcher to its own process id: the process then ends when that one does, however it ends."""


def lock_instance(data_dir: Path) -> int:
    """Hold `data_dir` for this process alone; the kernel lets go of it however the process ends.

    Returns the descriptor that holds the lock. Raises AlreadyRunning.
    """
    data_dir.mkdir(parents=True, exist_ok=True)
    path = data_dir / "lock"
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        pid = os.read(descriptor, 32).decode().strip()
        os.close(descriptor)
        raise AlreadyRunning(
            f"{data_dir.name} is already running on this site as process {pid}", data_dir=str(data_dir)
        ) from error
    os.ftruncate(descriptor, 0)
    os.write(descriptor, str(os.getpid()).encode())
    return descriptor


def lock_holder(data_dir: Path) -> int | None:
    """The process that holds `data_dir`, or None."""
    try:
        descriptor = os.open(data_dir / "lock", os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return int(os.read(descriptor, 32) or 0) or None
    else:
        return None
    finally:
        os.close(descriptor)
