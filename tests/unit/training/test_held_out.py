"""What a network is tried on beside photos of waste."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rodeo.vision.classifier import Classifier
from rodeo.vision.images import decode_image
from rodeo_testing.recordings import RENDERINGS
from training import held_out
from training.dataset import CLASSES, NoPhotos, Sample
from training.held_out import HeldOut

_SEEN = {False: [1.0, 0.0], True: [0.0, 1.0]}
CAN, NOTHING = ((RENDERINGS / name).read_bytes() for name in ("metal_1.jpg", "unknown_1.jpg"))


def test_a_share_counts_what_is_right_of_its_kind() -> None:
    """Items are to be named, everything else is to be unknown."""
    can, nothing = decode_image(CAN), decode_image(NOTHING)
    kinds = HeldOut(
        rendered=[Sample(can, "metal"), Sample(can, "glass")],
        drawn=[Sample(nothing, None), Sample(nothing, None), Sample(nothing, None), Sample(can, None)],
        real=[NOTHING, CAN, CAN, CAN],
    )
    assert kinds.shares(Classifier()) == {
        "held-out renderings named rightly": 0.5,
        "drawn pictures without an item called unknown": 0.75,
        "real photos of other things called unknown": 0.25,
    }


def test_near_duplicates_of_corrected_pictures_do_not_count_unless_nothing_else_is_there() -> None:
    can, nothing = decode_image(CAN), decode_image(NOTHING)
    turned = np.rot90(can).copy()
    kinds = HeldOut([Sample(turned, "metal"), Sample(nothing, "glass")], [Sample(can, None)], [NOTHING])

    def seen(samples: list[Sample]) -> np.ndarray:
        """What shows no item differs, and of a can nothing but the hashes tell that it is one."""
        return np.array([_SEEN[bool(np.array_equal(o.image_bgr, nothing))] for o in samples])

    apart, told = kinds.apart_from([Sample(can, "metal")], seen)
    assert [one.label for one in apart.rendered] == ["glass"]
    assert (len(apart.drawn), apart.real) == (1, [NOTHING])
    assert told == [
        "1 of 2 held-out renderings are near-duplicates of corrected pictures: not counted",
        "1 of 1 drawn pictures without an item are near-duplicates of corrected pictures: "
        "counted all the same, as no others are there",
    ]


def test_the_pictures_are_those_of_the_model_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = {"renderings_seed": 7, "held_out_renderings_per_class": 1}
    asked: list[object] = []

    def samples(given: object, photos: list[Sample]) -> tuple[list[Sample], list[Sample]]:
        asked.extend((given, len(photos)))
        return [Sample(np.zeros((8, 8, 3), np.uint8), "metal")], [Sample(np.zeros((8, 8, 3), np.uint8), None)]

    monkeypatch.setattr(held_out, "held_out_samples", samples)
    monkeypatch.setattr(held_out.others, "measured_photos", lambda fetched: {str(fetched): NOTHING})
    with pytest.raises(NoPhotos):
        HeldOut.load(recipe, tmp_path, tmp_path)
    for label in CLASSES:
        path = tmp_path / "val" / label / "1.png"
        path.parent.mkdir(parents=True)
        cv2.imwrite(str(path), np.zeros((64, 64, 3), np.uint8))
    found = HeldOut.load(recipe, tmp_path, tmp_path)
    assert (len(found.rendered), len(found.drawn), found.real) == (1, 1, [NOTHING])
    assert asked == [recipe, len(CLASSES)]
