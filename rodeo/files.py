"""Files that must survive a kill."""

from __future__ import annotations

import os
from itertools import count
from pathlib import Path


def replace_file(path: Path, text: str) -> None:
    """Replace the file at `path`: whatever ends the process leaves the old one or the new one, on disk."""
    part = path.with_suffix(".part")
    with part.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def set_aside(path: Path, why: str) -> Path:
    """Rename file or folder `path` to `<name>.<why>-<number>`, which nothing has yet; where it lies now."""
    aside = next(
        one for number in count(1) if not (one := path.with_name(f"{path.name}.{why}-{number}")).exists()
    )
    return path.rename(aside)
