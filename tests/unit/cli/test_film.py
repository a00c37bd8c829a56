"""A moving picture of one cleaning, from its sealed recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from rodeo.checks.case import CaseError
from rodeo.lab.layout import BinLayout
from rodeo.lab.render import RendererUnavailable
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_cli.film import Film, write
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, seal

pytestmark = pytest.mark.long

SIZE_PX = (160, 90)


@pytest.fixture(scope="module")
def film(site: Site, cleaning: Take, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Film]:
    path = seal(cleaning, tmp_path_factory.mktemp("film") / "proof.mcap", BINDING, ROBOT).path
    try:
        found = Film(path, site, SIZE_PX, frames_per_s=1)
    except RendererUnavailable as error:
        pytest.skip(f"no OpenGL driver, which libEGL brings: {error}")
    yield found
    found.close()


def test_each_step_has_its_caption_in_the_words_of_the_recording(film: Film) -> None:
    times_s = [scene.until_s for scene in film.scenes]
    assert times_s == sorted(times_s)
    text = "; ".join(scene.caption for scene in film.scenes)
    for said in ("for 100 IEC", "grasps the can", "metal, into the yellow compartment", "100 IEC are paid"):
        assert said in text


def test_the_animation_has_every_frame_and_ends_with_the_item_in_the_bin(
    film: Film, site: Site, tmp_path: Path
) -> None:
    path = tmp_path / "cleaning.webp"
    count = write(film, path, quality=92)
    ok, found = cv2.imreadanimation(str(path))
    assert ok and len(found.frames) == count >= len(film.scenes)
    assert found.frames[0].shape[:2] == SIZE_PX[::-1]
    assert list(found.durations[-2:]) == [1000, 1500]
    first, *others = (frame[:, :, :3].astype(int) for frame in found.frames)
    assert all(np.abs(other - first).mean() > 1 for other in others)
    assert BinLayout(site.bins[0]).contains("yellow", film.item_m)


def test_a_recording_that_the_checks_refuse_is_not_filmed(site: Site, cleaning: Take, tmp_path: Path) -> None:
    take = cleaning.without(topics.JOINT_STATES.name(ns="panther1"))
    path = seal(take, tmp_path / "proof.mcap", BINDING, ROBOT).path
    with pytest.raises(CaseError, match="do not accept") as refused:
        Film(path, site, SIZE_PX)
    assert refused.value.details["reason"]
