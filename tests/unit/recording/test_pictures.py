"""The pictures that a proof needs are in the recording, whatever else the bin was shown."""

from __future__ import annotations

import base64
import threading
from collections.abc import Iterator
from hashlib import sha256
from typing import Any

import pytest

from rodeo.recording.pictures import PictureFetcher
from rodeo.ros2 import types
from rodeo.site.topics import BIN_IMAGE
from rodeo.witness.statement import Classification, Drop
from rodeo_testing.waiting import HANG_S
from tests.unit.robot.fakes import BIN, payload_of

PICTURES = {"0x" + sha256(data).hexdigest(): data for data in (b"%d" % number for number in range(400))}
NAMES = list(PICTURES)


class Gallery:
    """A bus on which a bin has all pictures, and a fetcher of them. It answers nothing before `open`."""

    def __init__(self) -> None:
        self.open = threading.Event()
        self.written: list[bytes] = []
        bus: Any = self
        self.fetcher = PictureFetcher(bus, "lab", self._write)

    def query_all(self, _key: str, parameters: dict[str, str], **_more: Any) -> list[dict[str, Any]]:
        assert self.open.wait(HANG_S)
        return [{"data_base64": base64.b64encode(PICTURES[parameters["sha256"]]).decode()}]

    def _write(self, _bin_name: str, cdr: bytes, _time_ns: int) -> None:
        self.written.append(types.deserialize(cdr, BIN_IMAGE.type).data.tobytes())

    def shows(self, number: int, first: int, count: int) -> Classification:
        """The bin combines `count` pictures from number `first` on."""
        *earlier, last = NAMES[first : first + count]
        looks = [{"image_sha256": name, "taken_s": 1.0} for name in earlier]
        more = {"number": number, "image_sha256": last, "earlier": looks, "shown_s": 2.0}
        said = Classification.model_validate(payload_of(Classification, number, BIN, **more))
        self.fetcher.want(said)
        return said

    def falls(self, classification: int) -> None:
        self.fetcher.fell(Drop.model_validate(payload_of(Drop, 999, BIN, classification=classification)))

    def lacks(self, *said: Classification) -> list[str]:
        self.open.set()
        assert self.fetcher.wait(HANG_S)
        return [look.image_sha256 for one in said for look in one.looks if not self._has(look.image_sha256)]

    def _has(self, name: str) -> bool:
        return PICTURES[name] in self.written


@pytest.fixture
def gallery() -> Iterator[Gallery]:
    gallery = Gallery()
    yield gallery
    gallery.open.set()
    gallery.fetcher.close()


def test_all_pictures_that_a_robot_may_cause_are_fetched(gallery: Gallery) -> None:
    said = [
        gallery.shows(1 + 3 * delivery + show, 9 * delivery, 3 * (show + 1))
        for delivery in range(4)
        for show in range(3)
    ]
    assert gallery.lacks(*said) == []


def test_what_fell_is_fetched_after_any_number_of_pictures_that_others_caused(gallery: Gallery) -> None:
    for number in range(1, 41):
        gallery.shows(number, 3 * number, 3)
    own = gallery.shows(50, 200, 9)
    gallery.falls(50)
    assert gallery.lacks(own) == []


def test_what_fell_is_fetched_although_the_classification_is_heard_after_the_drop(gallery: Gallery) -> None:
    for number in range(1, 41):
        gallery.shows(number, 3 * number, 3)
    gallery.falls(50)
    assert gallery.lacks(gallery.shows(50, 200, 9)) == []


def test_what_fell_is_fetched_before_what_was_only_shown(gallery: Gallery) -> None:
    for number in range(1, 41):
        gallery.shows(number, 3 * number, 3)
    own = gallery.shows(50, 200, 9)
    gallery.falls(50)
    assert gallery.lacks(own) == []
    # The one that was being fetched meanwhile came first.
    first = {PICTURES[look.image_sha256] for look in own.looks}
    assert set(gallery.written[1:10]) == first or set(gallery.written[:9]) == first


def test_a_flood_of_classifications_and_drops_fetches_no_more_than_a_proof_may_hold(gallery: Gallery) -> None:
    for number in range(1, 41):
        gallery.shows(number, 9 * number, 9)
        gallery.falls(number)
    gallery.lacks()
    assert len(gallery.written) <= 36 + 12 * 9
