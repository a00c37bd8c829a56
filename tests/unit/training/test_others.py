"""Real photos of what is no waste come from installed and from fetched packages."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rodeo.vision.images import decode_image
from training import others
from training.others import (
    LEARNT,
    MEASURED,
    NoSamples,
    Package,
    World,
    fetch,
    installed_photos,
)


def test_each_real_photo_is_a_picture_of_its_own() -> None:
    photos = installed_photos()
    assert len(set(photos.values())) == len(photos) == 18
    assert all(min(decode_image(photo).shape[:2]) > 200 for photo in photos.values())


def test_a_package_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(others, "PHOTOS", {"no_such_package": ("photo.png",)})
    with pytest.raises(NoSamples) as refused:
        installed_photos()
    assert refused.value.details == {"package": "no_such_package"}


def test_what_measures_is_in_no_package_that_is_learnt_from() -> None:
    learnt, measured = ({package.name for package in some} for some in (LEARNT, MEASURED))
    assert len(learnt) == len(LEARNT) and len(measured) == len(MEASURED)
    assert not learnt & {*measured, *others.PHOTOS}


def test_training_without_the_photos_says_how_to_fetch_them(tmp_path: Path) -> None:
    with pytest.raises(NoSamples, match=r"python -m training\.others") as refused:
        World.load(tmp_path)
    assert refused.value.details["package"] == LEARNT[0].name


def put(name: str, into: Path) -> None:
    """A registry's client that brings a red scene, and a green thing in a transparent picture."""
    scene, thing = np.zeros((600, 800, 3), np.uint8), np.zeros((100, 100, 4), np.uint8)
    scene[..., 2] = 255
    thing[40:60, 20:80] = (0, 255, 0, 255)
    cv2.imwrite(str(into / "scene.jpg"), scene)
    cv2.imwrite(str(into / "thing.png"), thing)


PACKAGE = Package(put, "@some/photos@1", "MIT", ("*.jpg", "*.png"))


@pytest.fixture
def fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(others, "LEARNT", (PACKAGE,))
    monkeypatch.setattr(others, "MEASURED", ())
    assert list(fetch(tmp_path)) == ["@some/photos@1"]
    return tmp_path


def test_a_package_is_fetched_once(fetched: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def again(_name: str, _into: Path) -> None:
        raise AssertionError("fetched again")

    monkeypatch.setattr(others, "LEARNT", (Package(again, PACKAGE.name, "MIT", PACKAGE.files),))
    assert list(fetch(fetched)) == [PACKAGE.name]


def test_a_debian_package_is_unpacked_below_the_folder_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--out` is seen from where the command runs; the clients run in a folder below it."""

    def client(command: list[str], cwd: Path, check: bool) -> None:
        assert check
        if command[:2] == ["apt-get", "download"]:
            (cwd / "photos_2_all.deb").write_bytes(b"")
        else:
            assert command[:2] == ["dpkg", "-x"]
            assert (cwd / command[2]).exists()
            put("photos", cwd / command[3])

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(others.subprocess, "run", client)
    monkeypatch.setattr(others, "LEARNT", (Package(others._from_debian, "photos", "MIT", ("*.jpg",)),))
    monkeypatch.setattr(others, "MEASURED", ())
    left = Path("out/others/photos.part/photos_1_all.deb")  # of a try that ended before it was unpacked
    left.parent.mkdir(parents=True)
    left.write_bytes(b"")
    assert list(fetch(Path("out/others"))) == ["photos"]


def test_a_package_without_its_photos_is_named(fetched: Path) -> None:
    renamed = Package(put, PACKAGE.name, "MIT", ("*.jpg", "elsewhere/*.jpg"))
    with pytest.raises(NoSamples) as refused:
        World.load(fetched, [renamed])
    assert refused.value.details["missing"].endswith("elsewhere/*.jpg")


def test_parts_of_scenes_and_things_cut_out_are_drawn(fetched: Path) -> None:
    world, rng = World.load(fetched, [PACKAGE]), np.random.default_rng(0)
    (cut,) = world.cutouts
    assert cut.shape == (20, 60, 4)
    scene = world.scene(rng)
    assert min(scene.shape[:2]) >= 0.35 * 512 - 1 and scene[..., 2].min() > 200
    picture = world.thing(np.full((90, 120, 3), 255, np.uint8), rng)
    green = (picture == (0, 255, 0)).all(axis=2)
    assert picture.shape == (90, 120, 3)
    assert 60 * 20 <= green.sum() <= 120 * 40
    assert (picture[~green] == 255).all()


def test_other_files_make_another_hash(fetched: Path) -> None:
    before = World.load(fetched, [PACKAGE]).sha256
    assert World.load(fetched, [PACKAGE]).sha256 == before
    cv2.imwrite(str(PACKAGE.folder(fetched) / "scene.jpg"), np.zeros((600, 800, 3), np.uint8))
    assert World.load(fetched, [PACKAGE]).sha256 != before
