"""How much room is left where a process writes, and waiting for more."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar
from urllib.parse import unquote, urlsplit

from rodeo.errors import Interrupted
from rodeo.host.files import is_full
from rodeo.host.instance import HEARTBEAT_S
from rodeo.site.config import Site

log = logging.getLogger(__name__)

Result = TypeVar("Result")

_MB = 1_000_000
_SMALL_SHARE = 0.05
"""Share of a file system: more than that is never asked for, or a small one would never do."""
_MIN_FILES = 100
"""Files that can still be made, where the file system counts them."""


def written_folders(site: Site, data_dir: Path) -> list[Path]:
    """Where a process with this folder writes: its data, its logs, and the store if that is a folder."""
    folders = [data_dir, site.data_dir / "logs"]
    store = urlsplit(site.store_url)
    if store.scheme == "file":
        folders.append(Path(unquote(store.path)))
    return folders


def problem(folders: Iterable[Path], min_free_mb: float) -> str:
    """What is wrong with the first of `folders` that has too little room; "" if none has."""
    seen = set()
    for folder in folders:
        there = folder
        while not there.exists() and there != there.parent:
            there = there.parent
        try:
            device = there.stat().st_dev
            if device in seen:
                continue
            seen.add(device)
            found = os.statvfs(there)
        except OSError as error:
            return f"cannot inspect {folder}: {error.strerror}"
        free_mb = found.f_bavail * found.f_frsize / _MB
        wanted_mb = min(min_free_mb, _SMALL_SHARE * found.f_blocks * found.f_frsize / _MB)
        if free_mb < wanted_mb:
            return (
                f"the disk is full: {free_mb:.1f} MB are left in {folder}, and {wanted_mb:.1f} MB are needed "
                "([disk] min_free_mb)"
            )
        if found.f_files and found.f_favail < min(_MIN_FILES, _SMALL_SHARE * found.f_files):
            return f"the disk is full: {found.f_favail} more files fit into {folder}"
    return ""


class Disk:
    """The room in the folders of a process; `not_ready(reason)` hears what it waits for."""

    def __init__(
        self,
        folders: Sequence[Path],
        min_free_mb: float,
        stop: threading.Event,
        not_ready: Callable[[str], None],
    ) -> None:
        self.problem = ""
        """Why nothing new should be written now; "" while there is room. Looked at with each heartbeat."""
        self._folders, self._min_free_mb = folders, min_free_mb
        self._stop, self._not_ready = stop, not_ready

    def look(self) -> str:
        """`problem` as it is now."""
        found = problem(self._folders, self._min_free_mb)
        # What is measured changes with every message: once is enough for the log.
        if bool(found) != bool(self.problem):
            log.warning("%s", found or "there is room on the disk again")
        self.problem = found
        return found

    def with_room(self, work: Callable[[], Result]) -> Result:
        """What `work` returns; it is done again while the disk has no room for what it writes.

        Raises Interrupted when stopped before.
        """
        while True:
            try:
                return work()
            except Exception as error:
                if not is_full(error):
                    raise
                log.error("waiting for room on the disk: %s", error)
                self._not_ready(f"waiting for room on the disk: {error}")
            # The threshold may be far above what is missing: `work` itself has to find out.
            if self._stop.wait(HEARTBEAT_S):
                raise Interrupted("stopped while waiting for room on the disk")
