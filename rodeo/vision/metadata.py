"""What a photo says of itself: when, with what and with which software it was made (EXIF 3.0, TIFF 6.0).

Anybody can write anything there: it is shown to who judges, and decides nothing.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

_MAKE, _MODEL, _SOFTWARE, _CHANGED, _EXIF, _GPS, _TAKEN = (
    0x010F, 0x0110, 0x0131, 0x0132, 0x8769, 0x8825, 0x9003
)  # fmt: skip
_ASCII, _LONG = 2, 4
"""Types of values (TIFF 6.0, section 2)."""
_MAX_ENTRIES = 512
_MAX_CHARACTERS = 100


@dataclass(frozen=True)
class Metadata:
    """What stands in a photo's EXIF; None where it says nothing."""

    taken: str | None = None
    """The camera's own clock, without a time zone: YYYY:MM:DD HH:MM:SS."""
    device: str | None = None
    software: str | None = None
    has_place: bool = False


def read_metadata(data: bytes) -> Metadata | None:
    """The metadata of an encoded picture that `decode_image` took; None where it carries none that can be
    read."""
    import cv2

    buffer = np.frombuffer(data, np.uint8)
    try:
        _, kinds, blocks = cv2.imdecodeWithMetadata(buffer, cv2.IMREAD_REDUCED_GRAYSCALE_8)
    except cv2.error:
        return None
    for kind, block in zip(kinds, blocks, strict=True):
        if kind == cv2.IMAGE_METADATA_EXIF:
            try:
                return parse_exif(np.asarray(block).tobytes())
            except (struct.error, KeyError):
                return None
    return None


def parse_exif(tiff: bytes) -> Metadata:
    """The TIFF structure of an EXIF block. Raises struct.error where it is cut, KeyError for no TIFF."""
    order = {b"II*\0": "<", b"MM\0*": ">"}[tiff[:4]]
    (first,) = struct.unpack_from(order + "I", tiff, 4)
    main = _directory(tiff, order, first)
    exif = _directory(tiff, order, _pointer(main, _EXIF, order)) if _EXIF in main else {}
    device = " ".join(text for tag in (_MAKE, _MODEL) if (text := _text(tiff, main, tag, order)))
    return Metadata(
        taken=_text(tiff, exif, _TAKEN, order) or _text(tiff, main, _CHANGED, order),
        device=device or None,
        software=_text(tiff, main, _SOFTWARE, order),
        has_place=_GPS in main,
    )


Directory = dict[int, tuple[int, int, bytes]]
"""Tag -> type, count, and the four bytes that are the value or its offset."""


def _directory(tiff: bytes, order: str, at: int) -> Directory:
    (count,) = struct.unpack_from(order + "H", tiff, at)
    entries = (
        struct.unpack_from(order + "HHI4s", tiff, at + 2 + 12 * index)
        for index in range(min(count, _MAX_ENTRIES))
    )
    return {tag: (kind, length, value) for tag, kind, length, value in entries}


def _pointer(entries: Directory, tag: int, order: str) -> int:
    kind, _, value = entries[tag]
    if kind != _LONG:
        raise KeyError(tag)
    return int(struct.unpack(order + "I", value)[0])


def _text(tiff: bytes, entries: Directory, tag: int, order: str) -> str | None:
    kind, length, value = entries.get(tag, (0, 0, b""))
    if kind != _ASCII:
        return None
    if length > 4:
        (at,) = struct.unpack(order + "I", value)
        value = tiff[at : at + length]
    text = value[:length].split(b"\0")[0][:_MAX_CHARACTERS].decode("ascii", "replace")
    return "".join(c for c in text if c.isprintable()).strip() or None
