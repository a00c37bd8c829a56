"""What a bin's camera does to a photo, at severities 1 to 5: the benchmark of how much accuracy that costs.

The noise, blur, weather and digital corruptions of ImageNet-C (Hendrycks and Dietterich, 2019,
arXiv:1903.12261) that an indoor camera can show, and what a bin adds: odd white balance, dim light, a hand
or a gripper in view, the item cut by the frame, clutter behind it.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from services.itrash import scenery
from services.itrash.augment import item_mask, motion_kernel
from services.itrash.dataset import recompress

SEVERITIES = (1, 2, 3, 4, 5)

Corruption = Callable[[np.ndarray, int, np.random.Generator], np.ndarray]
"""(uint8 (h, w, 3) BGR, severity 1..5, random numbers) -> the same shape and type."""


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.clip(image, 0, 255).astype(np.uint8)


def gaussian_noise(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """The sensor's own noise at high gain."""
    return _bytes(image + rng.normal(0, (8, 12, 18, 26, 38)[severity - 1], image.shape))


def shot_noise(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Few photons."""
    photons = (60, 25, 12, 8, 5)[severity - 1]
    return _bytes(rng.poisson(image / 255 * photons) / photons * 255)


def defocus_blur(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    radius = (1, 2, 3, 4, 6)[severity - 1]
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2).astype(np.float32)
    return cv2.filter2D(image, -1, disc / disc.sum())


def motion_blur(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    return cv2.filter2D(image, -1, motion_kernel((5, 8, 11, 15, 20)[severity - 1], rng.uniform(0, 180)))


def brightness(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Overexposed."""
    return _bytes(image.astype(np.float32) + (25, 50, 75, 95, 115)[severity - 1])


def low_light(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Dim, with the noise that comes with it."""
    dim = image.astype(np.float32) * (0.6, 0.45, 0.32, 0.22, 0.15)[severity - 1]
    return _bytes(dim + rng.normal(0, 3, image.shape))


def contrast(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """A haze, a dirty lens."""
    mean = image.mean(axis=(0, 1))
    return _bytes((image - mean) * (0.7, 0.55, 0.4, 0.3, 0.2)[severity - 1] + mean)


def white_balance(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """A camera set for other light, or coloured light: up to half of blue or red missing."""
    warmth = (0.1, 0.2, 0.3, 0.4, 0.5)[severity - 1] * rng.choice((-1, 1))
    return _bytes(image * np.array([1 - max(warmth, 0), 1 - abs(warmth) / 4, 1 + min(warmth, 0)]))


def pixelate(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """A low-resolution camera."""
    height, width = image.shape[:2]
    factor = (0.5, 0.38, 0.28, 0.22, 0.17)[severity - 1]
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST)


def jpeg(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    return recompress(image, (25, 18, 13, 9, 6)[severity - 1])


def cut_by_frame(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """The camera looks past the item: part of it is outside."""
    height, width = image.shape[:2]
    share = (0.1, 0.17, 0.24, 0.31, 0.38)[severity - 1]
    angle = rng.uniform(0, 2 * np.pi)
    shift = np.array([[1, 0, share * width * np.cos(angle)], [0, 1, share * height * np.sin(angle)]])
    return cv2.warpAffine(image, shift, (width, height), borderMode=cv2.BORDER_REPLICATE)


def turned(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Held askew, nearer."""
    height, width = image.shape[:2]
    angle = (10, 20, 35, 60, 90)[severity - 1] * rng.choice((-1, 1))
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), float(angle), 1.1)
    return cv2.warpAffine(image, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)


def hand(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    covered = image.copy()
    scenery.draw_hand(covered, rng, reach=(0.08, 0.14, 0.2, 0.26, 0.32)[severity - 1])
    return covered


def gripper(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    covered = image.copy()
    scenery.draw_gripper(covered, rng, reach=(0.08, 0.14, 0.2, 0.26, 0.32)[severity - 1])
    return covered


def clutter(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Something else than a plain board behind the item, more of it showing the more severe."""
    mask = item_mask(image)
    if mask is None:
        return image
    height, width = image.shape[:2]
    texture = scenery.HELD_OUT_TEXTURES[int(rng.integers(len(scenery.HELD_OUT_TEXTURES)))](192, rng)
    behind = cv2.resize(texture, (width, height), interpolation=cv2.INTER_LINEAR)
    alpha = (1 - mask[..., None]) * (0.3, 0.45, 0.6, 0.8, 1.0)[severity - 1]
    return _bytes(alpha * behind + (1 - alpha) * image)


CORRUPTIONS: dict[str, Corruption] = {
    function.__name__: function
    for function in (
        gaussian_noise, shot_noise, defocus_blur, motion_blur, brightness, low_light, contrast, white_balance,
        pixelate, jpeg, cut_by_frame, turned, hand, gripper, clutter,
    )
}  # fmt: skip
