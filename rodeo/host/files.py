"""Files that must survive a kill, and disks that are full."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import BinaryIO, TypeVar

from pydantic import BaseModel, ValidationError

from rodeo.errors import DiskFull, FolderTaken, RodeoError, unreadable

Model = TypeVar("Model", bound=BaseModel)

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""No room on the device, in the user's quota, or within the largest file that the process may write."""


def is_full(error: BaseException | None) -> bool:
    """Whether there was no room, in this error or in one that it was raised from."""
    while error is not None:
        if isinstance(error, DiskFull) or (isinstance(error, OSError) and error.errno in _FULL):
            return True
        error = error.__cause__ or error.__context__
    return False


def begin_folder(folder: Path, first_line: str) -> None:
    """Make `folder` new and empty. What an earlier run left there is removed: its site.toml begins with
    `first_line`. Raises FolderTaken for a folder that holds anything else, and leaves it as it is."""
    if folder.exists() and not _left_by_run(folder, first_line):
        raise FolderTaken(
            "this folder holds something else than an earlier run: name another one, or empty it yourself",
            path=str(folder),
        )
    folder.mkdir(parents=True, exist_ok=True)
    # What shows whose the folder is goes last: this may be interrupted, and then done again.
    for entry in sorted(folder.iterdir(), key=lambda one: one.name == "site.toml"):
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _left_by_run(folder: Path, first_line: str) -> bool:
    if not folder.is_dir() or folder.is_symlink():
        return False
    try:
        with (folder / "site.toml").open() as file:
            return file.readline().rstrip("\n") == first_line
    except FileNotFoundError:
        # One that was killed while it wrote its site file has left a part of that.
        return all(entry.name == "site.part" for entry in folder.iterdir())


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """What a full disk raises inside becomes DiskFull, with the path that was written."""
    try:
        yield
    except OSError as error:
        if error.errno not in _FULL:
            raise
        raise DiskFull(f"no space left to write {path}", reason=error.strerror) from error


@contextmanager
def replacing(path: Path, *, mode: int = 0o666, part: Path | None = None) -> Iterator[BinaryIO]:
    """A file to write, which takes the place of `path` at the end of the block.

    Whatever ends the process leaves the old one or the new one, on disk; an error leaves the old one. Raises
    OSError.

    Args:
        mode: permissions of a new file, less the umask.
        part: where it is written, in the same folder; several writers of one file need one each.
    """
    part = path.with_suffix(".part") if part is None else part
    try:
        with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)  # it would keep the room that others need
        raise


def replace_file(path: Path, content: str | bytes, *, mode: int = 0o666) -> None:
    """Replace the file at `path` with `content`, as `replacing` does. Raises DiskFull, and other OSErrors."""
    data = content.encode() if isinstance(content, str) else content
    with writing(path), replacing(path, mode=mode) as file:
        file.write(data)


def read_model(model: type[Model], path: Path, damaged: type[RodeoError], words: str) -> Model | None:
    """What the file at `path` holds, None where there is none. Raises `damaged` with `words` and why."""
    try:
        return model.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise damaged(words, path=str(path), reason=unreadable(error)) from error


def set_aside(path: Path, why: str) -> Path:
    """Rename file or folder `path` to `<name>.<why>-<number>`, which nothing has yet; where it lies now."""
    aside = next(
        one for number in count(1) if not (one := path.with_name(f"{path.name}.{why}-{number}")).exists()
    )
    return path.rename(aside)
