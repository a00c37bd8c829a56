"""How much room is left where a process writes."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote, urlsplit

from rodeo.site.config import Site

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
