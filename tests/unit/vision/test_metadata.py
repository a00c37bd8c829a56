"""EXIF by strangers: what it says is read, what is cut or absurd is no metadata."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from rodeo.vision.metadata import Metadata, parse_exif, read_metadata

PICTURE = np.random.default_rng(1).integers(0, 256, (40, 60, 3), dtype=np.uint8)


def exif(order: str = "<", make: bytes = b"Acme\0", taken: bytes = b"2026:11:21 10:00:00\0") -> bytes:
    """A camera's block: make, software, a sub-directory with the time, and a place."""
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    main_at, exif_at = 8, 8 + 2 + 12 * 4 + 4
    text_at = exif_at + 2 + 12 + 4
    entries = [
        struct.pack(order + "HHII", 0x010F, 2, len(make), text_at),
        struct.pack(order + "HHI4s", 0x0131, 2, 4, b"Gim\0"),
        struct.pack(order + "HHII", 0x8769, 4, 1, exif_at),
        struct.pack(order + "HHII", 0x8825, 4, 1, 0),
    ]
    main = struct.pack(order + "H", len(entries)) + b"".join(entries) + bytes(4)
    sub = struct.pack(order + "H", 1)
    sub += struct.pack(order + "HHII", 0x9003, 2, len(taken), text_at + len(make)) + bytes(4)
    assert len(head + main) == exif_at and main_at == len(head)
    return head + main + sub + make + taken


def photo(extension: str, block: bytes | None) -> bytes:
    if block is None:
        return cv2.imencode(extension, PICTURE)[1].tobytes()
    blocks = [np.frombuffer(block, np.uint8)]
    return cv2.imencodeWithMetadata(extension, PICTURE, [cv2.IMAGE_METADATA_EXIF], blocks)[1].tobytes()


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("extension", [".jpg", ".png"])
def test_time_device_software_and_place_are_read(extension: str, order: str) -> None:
    found = read_metadata(photo(extension, exif(order)))
    assert found == Metadata(taken="2026:11:21 10:00:00", device="Acme", software="Gim", has_place=True)


def test_a_photo_without_metadata_has_none() -> None:
    assert read_metadata(photo(".jpg", None)) is None


@pytest.mark.parametrize("block", [b"nonsense", b"II*\0\xff\xff\xff\x7f", exif()[:30]])
def test_what_is_cut_or_no_exif_is_no_metadata(block: bytes) -> None:
    assert read_metadata(photo(".jpg", block)) is None


def test_texts_that_a_terminal_would_obey_are_shown_as_plain_letters() -> None:
    found = parse_exif(exif(make=b"A\x1b[2Jcme\n" + b"x" * 500 + b"\0"))
    assert found.device is not None
    assert found.device.startswith("A[2Jcme")
    assert len(found.device) <= 100


def test_every_cut_of_a_block_is_read_or_refused() -> None:
    for size in range(4, len(exif())):
        try:
            parse_exif(exif()[:size])
        except struct.error:
            continue
