"""Photos from outside: hostile until measured. Bytes are limited first, then pixels, then they are decoded.

Only JPEG, PNG and WebP reach a decoder, whatever else OpenCV could open: every further format is one more
parser exposed to strangers.

    ImageError (RequestError)
    ├── ImageTooLarge         more bytes or more pixels than allowed
    ├── UnsupportedImage      not JPEG, PNG or WebP, or an animated PNG
    └── BrokenImage           the signature fits, the rest does not
"""

from __future__ import annotations

import struct
import zlib
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
"""Tables, applications' data and comments (same table) that libjpeg knows. It skips 00 and refuses the
others. A reader that took those for segments would continue at another place, and find another size there."""
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""By colour type (PNG, third edition, table 8)."""
_PNG_PASSES = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)
"""Passes of an interlaced PNG (the same, 8.1): first column, first row, and steps to the next ones."""
_INFLATED_AT_ONCE, _DEFLATED_AT_ONCE = 1 << 18, 1 << 16
"""Bytes: small enough for a processor's cache."""


class ImageError(RequestError):
    """The bytes are no picture that can be looked at."""


class ImageTooLarge(ImageError):
    """More bytes, pixels, scans or packed texts than allowed; nothing was decoded."""


class UnsupportedImage(ImageError):
    """Neither JPEG, PNG nor WebP, or an animated PNG."""


class BrokenImage(ImageError):
    """The signature is of a known format, the content is not."""


@dataclass(frozen=True)
class ImageLimits:
    """What one photo may cost. The same for a bin, a person and `rodeo classify`."""

    max_bytes: int = 8 * 1024 * 1024
    """Bytes of the picture: what follows its end is not looked at."""
    max_pixels: int = 64_000_000
    """A telephone's picture has 12 to 50 million pixels."""
    max_scans: int = 100
    """Passes over the pixels of a progressive JPEG: encoders make about ten, each costs the decoder time."""
    max_scanned: int = 1_600_000_000
    """Pixels times passes over them."""
    max_packed_texts: int = 8
    """Deflated texts and colour profiles of a PNG: cameras and editors write few, and libpng unpacks up to
    8 MB of each."""


IMAGE_LIMITS = ImageLimits()
MOST_READ_BYTES = 32 << 20
"""Bytes of a file that are read to find the picture in it."""


def decode_image(data: bytes, limits: ImageLimits = IMAGE_LIMITS) -> np.ndarray:
    """The photo as BGR, uint8, shape (height, width, 3). Raises ImageError."""
    data = picture_of(data)
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
    scans = data.count(b"\xff\xda") if data.startswith(_JPEG) else 0
    if (most := min(limits.max_scans, limits.max_scanned // (width_px * height_px))) < scans:
        raise ImageTooLarge("the photo has too many scans", scans=scans, max_scans=most)
    if data.startswith(_PNG):
        _check_png(data, limits)
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
    if data.startswith(_PNG):
        return "image/png"
    return "image/webp" if data.startswith(b"RIFF") and data[8:12] == b"WEBP" else "application/octet-stream"


def image_size(data: bytes) -> tuple[int, int]:
    """(width, height) in pixels as the header tells, without decoding. Raises UnsupportedImage, BrokenImage,
    and struct.error or IndexError where the header is cut."""
    if data.startswith(_JPEG):
        return _jpeg_size(data)
    if data.startswith(_PNG):
        if data[12:16] != b"IHDR":
            raise BrokenImage("a PNG begins with IHDR", found=data[12:16].hex())
        width_px, height_px = struct.unpack_from(">II5x", data, 16)  # what else stands there is read later
        return width_px, height_px
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return _webp_size(data)
    raise UnsupportedImage("the photo is neither JPEG, PNG nor WebP", starts_with=data[:8].hex())


def ends_early(data: bytes) -> bool:
    """Whether a JPEG or PNG that `decode_image` took lacks its end; decoders fill what is missing."""
    return _jpeg_end(data) < 0 if data.startswith(_JPEG) else b"IEND" not in data


def picture_of(data: bytes) -> bytes:
    """A JPEG without what follows its end, where telephones put videos, depths and further pictures; others,
    which have no such end or are read to theirs, as they are."""
    end = _jpeg_end(data) if data.startswith(_JPEG) else -1
    return data if end < 0 else data[:end]


def _jpeg_end(data: bytes) -> int:
    """Where a JPEG ends; -1 where that is not in `data`, or its beginning is none of a JPEG."""
    try:
        # A thumbnail among the segments has an end of its own.
        scan = next(at for marker, at in _jpeg_segments(data) if marker == 0xDA)
    except (BrokenImage, struct.error, IndexError):
        return -1
    end = data.find(b"\xff\xd9", scan)
    return -1 if end < 0 else end + 2


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


def _check_png(data: bytes, limits: ImageLimits) -> None:
    """OpenCV allocates the memory that a chunk's length claims before it checks that the file is that long,
    and libpng also unpacks what follows the last pixel. Raises ImageError for both.

    Animations are refused: OpenCV composes them by code of its own, and no camera makes any.
    """
    pixels = _Pixels(data)
    texts = 0
    for name, begin, end in _png_chunks(data):
        if name == b"IDAT":
            pixels.add(memoryview(data)[begin:end])
        elif name == b"acTL":
            raise UnsupportedImage("the PNG is animated", at=begin)
        elif name in (b"zTXt", b"iCCP") or (name == b"iTXt" and _is_packed(data[begin:end])):
            texts += 1
            if texts > limits.max_packed_texts:
                raise ImageTooLarge("the PNG has too many packed texts", max=limits.max_packed_texts)
        elif name == b"IEND" and not pixels.begun:
            # OpenCV would look for them behind it.
            raise BrokenImage("the PNG ends before its pixels", at=begin)


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Name, begin and end of each chunk's data, the last is IEND. Raises BrokenImage where one is cut."""
    at, name = len(_PNG), b""
    while name != b"IEND":
        if len(data) - at < 12:
            raise BrokenImage("the PNG ends before its last chunk", bytes=len(data))
        length, name = struct.unpack_from(">I4s", data, at)
        begin, end = at + 8, at + 8 + length
        at = end + 4  # its checksum
        if at > len(data):
            raise BrokenImage(
                "a PNG chunk is longer than what is left", chunk=name.hex(), length=length, bytes=len(data)
            )
        yield name, begin, end


def _is_packed(international_text: bytes) -> bool:
    flag = international_text.find(b"\0") + 1
    return international_text[flag : flag + 1] != b"\0"


class _Pixels:
    """Unpacks a PNG's pixels and forgets them, to see how many bytes they are."""

    def __init__(self, data: bytes) -> None:
        """A PNG whose header is all there. Raises BrokenImage for a kind of pixels that there is not."""
        width, height, bits, colour, _, _, interlaced = struct.unpack_from(">IIBBBBB", data, 16)
        if colour not in _PNG_CHANNELS or bits not in (1, 2, 4, 8, 16) or interlaced > 1:
            raise BrokenImage("no PNG has such pixels", bits=bits, colour=colour, interlaced=interlaced)
        self.begun = False
        self._allowed = sum(
            rows * (1 + (columns * bits * _PNG_CHANNELS[colour] + 7) // 8)
            for columns, rows in _png_passes(width, height, bool(interlaced))
        )
        self._left = self._allowed
        self._stream = zlib.decompressobj()

    def add(self, deflated: memoryview) -> None:
        """Raises BrokenImage where they are more than the picture has, or not deflated."""
        self.begun = True
        for at in range(0, len(deflated), _DEFLATED_AT_ONCE):
            rest: memoryview | bytes = deflated[at : at + _DEFLATED_AT_ONCE]
            while rest and not self._stream.eof:
                try:
                    inflated = self._stream.decompress(rest, _INFLATED_AT_ONCE)
                except zlib.error as error:
                    raise BrokenImage("the PNG's pixels cannot be unpacked", reason=str(error)) from error
                self._left -= len(inflated)
                if self._left < 0:
                    raise BrokenImage("the PNG has more bytes of pixels than its size", allowed=self._allowed)
                rest = self._stream.unconsumed_tail


def _png_passes(width: int, height: int, interlaced: bool) -> list[tuple[int, int]]:
    """Columns and rows of each pass that has pixels."""
    if not interlaced:
        return [(width, height)]
    sizes = (
        (-((column - width) // wide), -((row - height) // high)) for column, row, wide, high in _PNG_PASSES
    )
    return [(columns, rows) for columns, rows in sizes if columns > 0 and rows > 0]


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
