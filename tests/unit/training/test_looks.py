"""The bench asks the bin's own state machine what it says of several angles."""

from __future__ import annotations

from rodeo.vision.classification import UNKNOWN
from rodeo.vision.classifier import Classifier
from rodeo_testing.recordings import RENDERINGS
from training.looks import said_of

CAN, NOTHING = ((RENDERINGS / name).read_bytes() for name in ("metal_1.jpg", f"{UNKNOWN}_1.jpg"))


def test_a_sure_first_view_needs_no_other() -> None:
    (said,) = said_of(Classifier(), [CAN, NOTHING])
    assert (said.item_class, said.earlier) == ("metal", ())


def test_other_views_are_shown_while_the_bin_asks_for_them() -> None:
    said = said_of(Classifier(), [NOTHING, CAN])
    assert said[0].item_class == UNKNOWN
    assert said[0].another_angle
    assert len(said[-1].earlier) == 1
