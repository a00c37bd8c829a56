"""The pictures that were classified lately, as the camera encoded them: proofs hold what they name."""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import Path

from rodeo.errors import DiskFull, RequestError, RodeoError
from rodeo.host.files import replace_file

_KEPT = 64
"""More than a robot causes in one recording (`rodeo.recording.pictures`)."""
_NAME = re.compile(r"0x[0-9a-f]{64}")


class NoSuchPicture(RequestError):
    """The bin never classified such a picture, or long ago."""


class PictureNotKept(RodeoError):
    """A picture that nobody could look at later is not classified."""


class Pictures:
    """Files named by the SHA-256 of what is in them. They survive a restart."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def keep(self, data: bytes) -> str:
        """Keep a picture and let go of the oldest; its SHA-256 (0x). Raises PictureNotKept."""
        name = "0x" + sha256(data).hexdigest()
        try:
            replace_file(self._folder / name, data)
            pictures = [path for path in self._folder.iterdir() if _NAME.fullmatch(path.name)]
            for path in sorted(pictures, key=lambda path: path.stat().st_mtime_ns)[:-_KEPT]:
                path.unlink(missing_ok=True)
        except (OSError, DiskFull) as error:
            raise PictureNotKept(
                "cannot store a picture", path=str(self._folder), cause=str(error)
            ) from error
        return name

    def has(self, name: str) -> bool:
        """Whether the picture with this SHA-256 (0x) is there."""
        return bool(_NAME.fullmatch(name)) and (self._folder / name).exists()

    def find(self, name: str) -> bytes:
        """The picture with this SHA-256 (0x). Raises NoSuchPicture."""
        if not self.has(name):
            raise NoSuchPicture("the bin has no such picture", sha256=name[:80])
        return (self._folder / name).read_bytes()
