"""Whether two photos are one photo: encoded again, resized, brightened, cut at the edges, turned or mirrored.

A photo's print is one perceptual hash per window of it: which of the 143 lowest frequencies of its cosine
transform are above their median (after Zauner, 2010, "Implementation and benchmarking of perceptual image
hash functions"). The windows leave out up to a tenth of the picture at each edge, so a cut copy is like one
of the original's windows.
"""

from __future__ import annotations

import base64
import binascii
import itertools
from collections.abc import Sequence

import cv2
import numpy as np

from rodeo.errors import RequestError

COPY_BITS = 24
"""Photos of which fewer bits differ are called alike. Chosen on TrashNet's 327 val photos: 13 ways to change
a copy made at most 22 bits differ; between different photos, 35,534 pairs, it was at least 26, but for one
pair that shows one thing."""
_HASH_PX, _FREQUENCIES = 48, 12
BITS = _FREQUENCIES**2 - 1
"""Without the mean, which only tells how bright it is."""
_THUMB_PX = 96
_CUTS = [(a, b) for a in (0.0, 0.05, 0.1) for b in (0.0, 0.05, 0.1)]
_WINDOWS = [(left, top, right, bottom) for (left, right), (top, bottom) in itertools.product(_CUTS, _CUTS)]
"""Shares of the picture that are cut off at its four edges; the first is the whole picture."""

Print = np.ndarray
"""(windows, BITS) bool."""


class BadPrint(RequestError):
    """The text is no photo's print."""


def photo_print(image_bgr: np.ndarray) -> Print:
    """The print of a picture: uint8 (h, w, 3) BGR."""
    return _print(_thumb(image_bgr))


def turned_prints(image_bgr: np.ndarray) -> list[Print]:
    """The prints of a picture in each of its eight positions: quarter turns, mirrored or not."""
    thumb = _thumb(image_bgr)
    return [
        _print(np.ascontiguousarray(np.rot90(side, turns)))
        for side in (thumb, thumb[:, ::-1])
        for turns in range(4)
    ]


def differing_bits(turned: Sequence[Print], other: Print) -> int:
    """How many of `BITS` differ where the two photos are most alike: each as a whole against the other's
    windows, the one in any of its eight positions."""
    return min(
        int(min((one[0] != other).sum(axis=1).min(), (one != other[0]).sum(axis=1).min())) for one in turned
    )


def to_text(one: Print) -> str:
    """A print as text, for an index."""
    return base64.b64encode(np.packbits(one).tobytes()).decode()


def from_text(text: str) -> Print:
    """Raises BadPrint."""
    size = len(_WINDOWS) * BITS
    try:
        packed = np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    except (binascii.Error, ValueError) as error:
        raise BadPrint("the fingerprint is not base64", cause=str(error)) from error
    if len(packed) != (size + 7) // 8:
        raise BadPrint("the fingerprint has another length", bytes=len(packed), expected=(size + 7) // 8)
    return np.unpackbits(packed, count=size).astype(bool).reshape(len(_WINDOWS), BITS)


def _thumb(image_bgr: np.ndarray) -> np.ndarray:
    grey = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY)
    return cv2.resize(grey, (_THUMB_PX, _THUMB_PX), interpolation=cv2.INTER_AREA)


def _print(thumb: np.ndarray) -> Print:
    found = np.array([_frequencies(_window(thumb, *window)) for window in _WINDOWS])
    return np.asarray(found > np.median(found, axis=1, keepdims=True))


def _window(thumb: np.ndarray, left: float, top: float, right: float, bottom: float) -> np.ndarray:
    height, width = thumb.shape
    return thumb[
        int(height * top) : height - int(height * bottom), int(width * left) : width - int(width * right)
    ]


def _frequencies(grey: np.ndarray) -> np.ndarray:
    """(BITS,)"""
    small = cv2.resize(grey, (_HASH_PX, _HASH_PX), interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray(cv2.dct(small)[:_FREQUENCIES, :_FREQUENCIES].ravel()[1:])
