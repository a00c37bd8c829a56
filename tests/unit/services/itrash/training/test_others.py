"""Real photos of what is no waste come from installed packages."""

from __future__ import annotations

import pytest

from rodeo.vision.images import decode_image
from services.itrash.training import others
from services.itrash.training.others import NoSamples, real_photos


def test_each_real_photo_is_a_picture_of_its_own() -> None:
    photos = real_photos()
    assert len(set(photos.values())) == len(photos) == 18
    assert all(min(decode_image(photo).shape[:2]) > 200 for photo in photos.values())


def test_a_package_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(others, "PHOTOS", {"no_such_package": ("photo.png",)})
    with pytest.raises(NoSamples) as refused:
        real_photos()
    assert refused.value.details == {"package": "no_such_package"}
