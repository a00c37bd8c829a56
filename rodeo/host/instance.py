"""One process of a kind per site: the lock on its data, by which others see that it runs, and its ending."""

from __future__ import annotations

import fcntl
import logging
import os
import threading
import time
from pathlib import Path

from pydantic import BaseModel, ValidationError

from rodeo.errors import AlreadyRunning, DiskFull
from rodeo.host.files import writing
from rodeo.text.redaction import redacted

log = logging.getLogger(__name__)

HEARTBEAT_S = 1.0
"""Wall time between two states that a running process publishes."""

LAUNCHER = "launcher"
"""Folder in the data directory whose locks show the launchers at work."""

GAVE_UP = 78
"""Exit status of a process that no restart can cure: EX_CONFIG of sysexits.h."""

PARENT_VARIABLE = "RODEO_PARENT"
"""Set by a launcher to its own process id: the process then ends when that one does, however it ends."""


PREDECESSOR_S = 8.0
"""Wall time for which a process waits for one that is ending (at most `rodeo.runtime.process.STOP_S`)."""

_LOOK_S = 0.1
"""Wall time between two looks whether it has ended."""

_ENDING = "ended.json"


class Ending(BaseModel):
    """How a process ended by itself the last time."""

    pid: int
    time_s: float
    """Wall time."""
    reason: str
    gave_up: bool
    """Whether no restart can cure it."""


def lock_instance(data_dir: Path, wait_s: float = 0.0, stop: threading.Event | None = None) -> int:
    """Hold `data_dir` for this process alone; the kernel lets go of it however the process ends.

    A holder may need `wait_s` of wall time for its end. Returns the descriptor that holds the lock. Raises
    AlreadyRunning, at once when `stop` is set, and DiskFull where there is no room for its file.
    """
    deadline_s = time.monotonic() + wait_s
    said = False
    while True:
        try:
            return _lock(data_dir)
        except AlreadyRunning as error:
            if time.monotonic() >= deadline_s or (stop is not None and stop.is_set()):
                raise
            if not said:
                log.info("%s; waiting up to %.0f s for it to exit", error.message, wait_s)
                said = True
        (stop or threading.Event()).wait(_LOOK_S)


def _lock(data_dir: Path) -> int:
    path = data_dir / "lock"
    with writing(path):
        data_dir.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        pid = os.read(descriptor, 32).decode().strip()
        os.close(descriptor)
        raise AlreadyRunning(
            f"{data_dir.name} is already running on this site as process {pid}", data_dir=str(data_dir)
        ) from error
    holder = str(os.getpid()).encode()
    try:
        with writing(path):
            # Over what stood there: on a full disk there is room for no other block.
            os.pwrite(descriptor, holder, 0)
            os.ftruncate(descriptor, len(holder))
    except DiskFull:
        os.close(descriptor)
        raise
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


def note_ending(data_dir: Path, reason: str, gave_up: bool) -> None:
    """Keep how this process ends where `last_ending` finds it, unless another one is at work there."""
    if lock_holder(data_dir) not in (None, os.getpid()):
        return
    ending = Ending(pid=os.getpid(), time_s=time.time(), reason=redacted(reason), gave_up=gave_up)
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        (data_dir / _ENDING).write_text(ending.model_dump_json())
    except OSError as error:
        # The reason is in the log as well, and the disk may be what the process ends for.
        log.warning("cannot record how it ended: %s", error)


def last_ending(data_dir: Path) -> Ending | None:
    """How the process of `data_dir` ended, or None when it did not end by itself since its last start."""
    try:
        return Ending.model_validate_json((data_dir / _ENDING).read_bytes())
    except (OSError, ValidationError):
        # Nobody needs it to continue: one that was cut off by a full disk is none.
        return None


def forget_ending(data_dir: Path) -> None:
    """The process starts again."""
    (data_dir / _ENDING).unlink(missing_ok=True)
