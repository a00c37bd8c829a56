"""Real photos of what is no waste: the samples that scikit-image and scikit-learn install (dev extra).

They measure how often the bin says `unknown` of the world, and choose no threshold. Drawings, screens and a
page of paper among the samples are left out.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

from rodeo.errors import RodeoError

PHOTOS = {
    "skimage": (
        "data/astronaut.png", "data/brick.png", "data/camera.png", "data/cell.png", "data/chelsea.png",
        "data/clock_motion.png", "data/coffee.png", "data/coins.png", "data/grass.png", "data/gravel.png",
        "data/hubble_deep_field.jpg", "data/ihc.png", "data/moon.png", "data/motorcycle_left.png",
        "data/retina.jpg", "data/rocket.jpg",
    ),
    "sklearn": ("datasets/images/china.jpg", "datasets/images/flower.jpg"),
}  # fmt: skip
"""Package -> its photos."""


class NoSamples(RodeoError):
    """A package that brings photos is not installed."""


def real_photos() -> dict[str, bytes]:
    """Name -> encoded photo. Raises NoSamples."""
    return {
        f"{package}/{name}": (_folder(package) / name).read_bytes()
        for package, names in PHOTOS.items()
        for name in names
    }


def _folder(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise NoSamples("install the dev extra", package=package)
    return Path(spec.submodule_search_locations[0])
