"""Photos from outside: hostile until measured. Bytes are limited first, then pixels, then they are decoded.

Only JPEG, PNG and WebP reach a decoder, whatever else OpenCV could open: every further format is one more
parser exposed to strangers.

    ImageError (RequestError)
    ├── ImageTooLarge         more bytes or more pixels than allowed
    ├── UnsupportedImage      not JPEG, PNG or WebP
    └── BrokenImage           the signature fits, the rest does not
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rodeo.errors import RequestError

_JPEG = b"\xff\xd8"
_JPEG_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Start-of-frame markers (ITU-T T.81, table B.1); C4, C8 and CC are tables, not frames."""
_JPEG_BARE_MARKERS = frozenset((0x01, *range(0xD0, 0xD9)))
"""Markers without a length field (same table)."""
_JPEG_SEGMENT_MARKERS = frozenset((0xC4, 0xCC, 0xDB, 0xDC, 0xDD, *range(0xE0, 0xF0), 0xFE))
"""Tables, applications' data and comments (same table), those that libjpeg knows. It skips 00 and refuses the
others: who took them for segments would read on in another place, and there another size."""


class ImageError(RequestError):
    """The bytes are no picture that can be looked at."""


class ImageTooLarge(ImageError):
    """More bytes, pixels or scans than allowed; nothing was decoded."""


class UnsupportedImage(ImageError):
    """Neither JPEG, PNG nor WebP."""


class BrokenImage(ImageError):
    """The signature is of a known format, the content is not."""


@dataclass(frozen=True)
class ImageLimits:
    """What one photo may cost."""

    max_bytes: int = 8 * 1024 * 1024
    max_pixels: int = 16_000_000
    max_scans: int = 100
    """Passes over the pixels of a progressive JPEG: encoders make about ten, each costs the decoder time."""


IMAGE_LIMITS = ImageLimits()


def decode_image(data: bytes, limits: ImageLimits = IMAGE_LIMITS) -> np.ndarray:
    """The photo as BGR, uint8, shape (height, width, 3). Raises ImageError."""
    if len(data) > limits.max_bytes:
        raise ImageTooLarge("the photo has too many bytes", bytes=len(data), max_bytes=limits.max_bytes)
    try:
        width_px, height_px = image_size(data)
    except (struct.error, IndexError):
        raise BrokenImage("the photo ends before its size", bytes=len(data)) from None
    if width_px < 1 or height_px < 1:
        raise BrokenImage("the photo has no pixels", width_px=width_px, height_px=height_px)
    if width_px * height_px > limits.max_pixels:
        raise ImageTooLarge(
            "the photo has too many pixels",
            width_px=width_px,
            height_px=height_px,
            max_pixels=limits.max_pixels,
        )
    # In a JPEG's coded data no 0xDA follows a 0xFF (ITU-T T.81, B.1.1.5): each pair begins a scan.
    if data.startswith(_JPEG) and (scans := data.count(b"\xff\xda")) > limits.max_scans:
        raise ImageTooLarge("the photo has too many scans", scans=scans, max_scans=limits.max_scans)
    # Imported here: who reads a header, or refuses by size, needs no OpenCV.
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise BrokenImage("the photo cannot be decoded", reason=error.err) from error
    if image is None:
        raise BrokenImage("the photo cannot be decoded", width_px=width_px, height_px=height_px)
    return image


def media_type(data: bytes) -> str:
    """The MIME type by the first bytes; what is none of the three is just bytes."""
    if data.startswith(_JPEG):
        return "image/jpeg"
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return "image/png"
    return "image/webp" if data.startswith(b"RIFF") and data[8:12] == b"WEBP" else "application/octet-stream"


def image_size(data: bytes) -> tuple[int, int]:
    """(width, height) in pixels as the header tells, without decoding. Raises UnsupportedImage, BrokenImage,
    and struct.error or IndexError where the header is cut."""
    if data.startswith(_JPEG):
        return _jpeg_size(data)
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        if data[12:16] != b"IHDR":
            raise BrokenImage("a PNG begins with IHDR", found=data[12:16].hex())
        width_px, height_px = struct.unpack_from(">II", data, 16)
        return width_px, height_px
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return _webp_size(data)
    raise UnsupportedImage("the photo is neither JPEG, PNG nor WebP", starts_with=data[:8].hex())


def ends_early(data: bytes) -> bool:
    """Whether a JPEG or PNG that `decode_image` took lacks its end; decoders fill what is missing."""
    if not data.startswith(_JPEG):
        return b"IEND" not in data
    # A thumbnail among the segments has an end of its own.
    scan = next((at for marker, at in _jpeg_segments(data) if marker == 0xDA), len(data))
    return data.find(b"\xff\xd9", scan) < 0


def _jpeg_size(data: bytes) -> tuple[int, int]:
    for marker, at in _jpeg_segments(data):
        if marker in _JPEG_FRAME_MARKERS:
            height_px, width_px = struct.unpack_from(">HH", data, at + 3)
            return width_px, height_px
        if marker in (0xD9, 0xDA):  # end of image, start of scan
            raise BrokenImage("the JPEG has no frame before its data", at=at)
    raise AssertionError("segments do not end")


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Markers with a length and where that stands; without end, so ask no further than the first scan. Raises
    BrokenImage, and struct.error or IndexError where the file is cut."""
    at = 2
    while True:
        if data[at] != 0xFF:
            raise BrokenImage("a JPEG marker was expected", at=at)
        marker = data[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        at += 2
        if marker in _JPEG_BARE_MARKERS:
            continue
        yield marker, at
        if marker not in _JPEG_SEGMENT_MARKERS | _JPEG_FRAME_MARKERS:
            raise BrokenImage("a JPEG marker is unknown", marker=f"{marker:02x}", at=at)
        (length,) = struct.unpack_from(">H", data, at)
        if length < 2:
            raise BrokenImage("a JPEG segment is shorter than its own length field", at=at)
        at += length


def _webp_size(data: bytes) -> tuple[int, int]:
    """Layouts: RFC 9649, sections 2.5 to 2.7 and 3.4."""
    chunk = data[12:16]
    if chunk == b"VP8X":
        width_less_one = int.from_bytes(data[24:27], "little")
        height_less_one = int.from_bytes(data[27:30], "little")
        return (width_less_one + 1, height_less_one + 1) if len(data) >= 30 else (0, 0)
    if chunk == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if chunk == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    raise BrokenImage("the WebP has no image chunk first", found=chunk.hex())
