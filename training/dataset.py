"""Photos to learn from and to measure on: one folder per class, as TrashNet ships.

RodeoError
└── NoPhotos              there is no such folder
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from rodeo.errors import RodeoError
from rodeo.vision.classifier import shrink
from rodeo.vision.images import decode_image

CLASSES = ("cardboard", "glass", "metal", "paper", "plastic", "trash")


class NoPhotos(RodeoError):
    """A folder of photos is missing."""


@dataclass(frozen=True)
class Sample:
    """One picture and what it shows; `label` None means no item at all."""

    image_bgr: np.ndarray
    label: str | None
    name: str = ""
    """Where it came from."""
    corrected: bool = False
    """Whether a person said so against a network: none teaches another name for it."""


def load_photos(folder: Path) -> list[Sample]:
    """Every photo under `folder/<class>/`, in a stable order, as small as the bin makes it before its network
    sees it. Raises NoPhotos, ImageError."""
    for label in CLASSES:
        if not (folder / label).is_dir():
            raise NoPhotos("a folder of photos is missing", folder=str(folder / label))
    return [
        Sample(shrink(decode_image(path.read_bytes())), label, f"{label}/{path.name}")
        for label in CLASSES
        for path in sorted((folder / label).iterdir())
    ]


def recompress(image_bgr: np.ndarray, quality: int) -> np.ndarray:
    """The picture as a camera with JPEG compression of `quality` (0..100) would send it."""
    _, jpeg = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return decode_image(jpeg.tobytes())
