"""Files that must survive a kill, and disks that are full."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from rodeo.errors import DiskFull

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""No room on the device, in the user's quota, or within the largest file that the process may write."""


def is_full(error: BaseException | None) -> bool:
    """Whether there was no room, in this error or in one that it was raised from."""
    while error is not None:
        if isinstance(error, DiskFull) or (isinstance(error, OSError) and error.errno in _FULL):
            return True
        error = error.__cause__ or error.__context__
    return False


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """What a full disk raises inside becomes DiskFull, with the path that was written."""
    try:
        yield
    except OSError as error:
        if error.errno not in _FULL:
            raise
        raise DiskFull(f"no space left to write {path}", reason=error.strerror) from error


def replace_file(path: Path, text: str) -> None:
    """Replace the file at `path`: whatever ends the process leaves the old one or the new one, on disk.

    Raises DiskFull, and then the old one is as it was.
    """
    part = path.with_suffix(".part")
    with writing(path):
        try:
            with part.open("w") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        except OSError:
            part.unlink(missing_ok=True)  # it would keep the room that others need
            raise


def set_aside(path: Path, why: str) -> Path:
    """Rename file or folder `path` to `<name>.<why>-<number>`, which nothing has yet; where it lies now."""
    aside = next(
        one for number in count(1) if not (one := path.with_name(f"{path.name}.{why}-{number}")).exists()
    )
    return path.rename(aside)
