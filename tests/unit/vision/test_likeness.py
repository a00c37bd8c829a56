"""Copies of a photo are known again however they were changed; different photos are told apart."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest

from rodeo.vision.likeness import (
    BITS,
    COPY_BITS,
    BadPrint,
    Print,
    differing_bits,
    from_text,
    photo_print,
    to_text,
    turned_prints,
)
from rodeo_testing import recordings
from tests.support.sweep import sweep

RENDERINGS = sorted(recordings.RENDERINGS.glob("*.jpg"))


def scene(seed: int) -> np.ndarray:
    """A drawn photo: shapes of random size, place and colour on a ground with a gradient."""
    rng = np.random.default_rng(seed)
    ground = np.linspace(*rng.uniform(40, 220, 2), 320)[None, :, None]
    picture = np.broadcast_to(ground, (240, 320, 3)).astype(np.uint8).copy()
    for _ in range(12):
        x, y, size = (int(rng.integers(low, high)) for low, high in ((0, 320), (0, 240), (8, 70)))
        colour = tuple(int(c) for c in rng.integers(0, 256, 3))
        if rng.random() < 0.5:
            cv2.circle(picture, (x, y), size, colour, -1)
        else:
            cv2.rectangle(picture, (x, y), (x + size, y + size // 2), colour, -1)
    return cv2.GaussianBlur(picture, (0, 0), 1.5)


@cache
def prints(seed: int) -> tuple[Print, list[Print]]:
    """Prints of a scene, as it is and in its eight positions."""
    return photo_print(scene(seed)), turned_prints(scene(seed))


def jpeg(picture: np.ndarray, quality: int) -> np.ndarray:
    return cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1)


def cut(picture: np.ndarray, left: float, top: float, right: float, bottom: float) -> np.ndarray:
    height, width = picture.shape[:2]
    return picture[
        int(height * top) : height - int(height * bottom), int(width * left) : width - int(width * right)
    ]


CHANGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "the same": lambda picture: picture,
    "encoded again": lambda picture: jpeg(picture, 40),
    "encoded badly": lambda picture: jpeg(picture, 12),
    "made smaller": lambda picture: cv2.resize(picture, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA),
    "enlarged": lambda picture: cv2.resize(picture, None, fx=2, fy=2),
    "squeezed": lambda picture: cv2.resize(picture, (200, 240), interpolation=cv2.INTER_AREA),
    "brightened": lambda picture: cv2.convertScaleAbs(picture, alpha=1.05, beta=15),
    "cut at all edges": lambda picture: cut(picture, 0.06, 0.06, 0.06, 0.06),
    "cut at one edge": lambda picture: cut(picture, 0.1, 0, 0, 0),
    "cut at a corner and encoded again": lambda picture: jpeg(cut(picture, 0.03, 0.08, 0, 0), 60),
    "mirrored": lambda picture: np.ascontiguousarray(picture[:, ::-1]),
    "turned": lambda picture: np.ascontiguousarray(np.rot90(picture)),
    "mirrored, cut and encoded again": lambda picture: jpeg(cut(picture[:, ::-1], 0.04, 0, 0.02, 0.05), 50),
}


@pytest.mark.parametrize("change", sweep(CHANGES.values(), 4), ids=CHANGES.keys())
def test_a_changed_copy_is_like_its_original_whichever_was_handed_in_first(
    change: Callable[[np.ndarray], np.ndarray],
) -> None:
    for seed in range(4):
        copy = change(scene(seed))
        as_is, turned = prints(seed)
        assert differing_bits(turned_prints(copy), as_is) < COPY_BITS
        assert differing_bits(turned, photo_print(copy)) < COPY_BITS


def test_different_photos_are_not_alike() -> None:
    known = [photo_print(scene(seed)) for seed in range(30)]
    for number in range(6):
        _, turned = prints(number)
        found = [differing_bits(turned, other) for other in known]
        assert found.pop(number) == 0
        assert min(found) >= COPY_BITS


def test_two_renderings_of_different_things_before_one_background_are_not_alike() -> None:
    metal, paper = (cv2.imread(str(path)) for path in RENDERINGS if path.stem in ("metal_1", "paper_1"))
    assert differing_bits(turned_prints(metal), photo_print(paper)) >= COPY_BITS


def test_a_print_survives_being_kept_as_text() -> None:
    one = photo_print(scene(1))
    assert np.array_equal(from_text(to_text(one)), one)
    assert one.shape[1] == BITS


@pytest.mark.parametrize("text", ["", "no base64!", "AAAA"])
def test_what_is_no_print_is_said_to_be_none(text: str) -> None:
    with pytest.raises(BadPrint):
        from_text(text)
