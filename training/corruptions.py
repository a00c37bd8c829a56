"""What a bin's camera does to a photo, at severities 1 to 5: the benchmark of how much accuracy that costs.

The fifteen of ImageNet-C (Hendrycks and Dietterich, 2019, arXiv:1903.12261), with frost drawn where they
overlay photos of it, and what a bin adds: odd white balance, dim light, a hand or a gripper in view, the item
cut by the frame, clutter behind it. Impulse noise, glass and zoom blur, fog and frost have the paper's
severities; the others are as strong as an indoor camera shows them, which is less.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from training import scenery
from training.augment import item_mask, motion_kernel
from training.dataset import recompress

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


def impulse_noise(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Dead and stuck pixels, bits lost on the way."""
    hit = rng.random(image.shape) < (0.03, 0.06, 0.09, 0.17, 0.27)[severity - 1]
    return np.where(hit, rng.choice(np.array([0, 255], np.uint8), image.shape), image)


def defocus_blur(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    radius = (1, 2, 3, 4, 6)[severity - 1]
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2).astype(np.float32)
    return cv2.filter2D(image, -1, disc / disc.sum())


def motion_blur(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    return cv2.filter2D(image, -1, motion_kernel((5, 8, 11, 15, 20)[severity - 1], rng.uniform(0, 180)))


def glass_blur(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Through frosted glass: each pixel is one of its neighbours."""
    sigma = (0.7, 0.9, 1.0, 1.1, 1.5)[severity - 1]
    reach, times = ((1, 2), (2, 1), (2, 3), (3, 2), (4, 2))[severity - 1]
    blurred = cv2.GaussianBlur(image, (0, 0), sigma)
    for _ in range(times):
        shift = rng.integers(-reach, reach + 1, (2, *image.shape[:2])).astype(np.float32)
        blurred = _displaced(blurred, shift[0], shift[1], cv2.INTER_NEAREST)
    return cv2.GaussianBlur(blurred, (0, 0), sigma)


def zoom_blur(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """It comes nearer while the shutter is open."""
    end, step = ((1.11, 0.01), (1.16, 0.01), (1.21, 0.02), (1.26, 0.02), (1.31, 0.03))[severity - 1]
    height, width = image.shape[:2]
    nearer = [
        cv2.warpAffine(
            image, cv2.getRotationMatrix2D((width / 2, height / 2), 0, float(zoom)), (width, height)
        )
        for zoom in np.arange(1, end, step)
    ]
    return _bytes(np.mean([image, *nearer], axis=0))


def elastic(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """A wavy lens."""
    side = min(image.shape[:2])
    strength = (0.01, 0.015, 0.02, 0.025, 0.03)[severity - 1] * side
    smoothness = (0.05, 0.03, 0.02, 0.015, 0.01)[severity - 1] * side
    shifts = []
    for _ in range(2):
        wave = cv2.GaussianBlur(rng.uniform(-1, 1, image.shape[:2]), (0, 0), smoothness)
        shifts.append((wave / np.abs(wave).max() * strength).astype(np.float32))
    return _displaced(image, shifts[0], shifts[1], cv2.INTER_LINEAR)


def _displaced(image: np.ndarray, dx: np.ndarray, dy: np.ndarray, how: int) -> np.ndarray:
    """Each pixel from (dx, dy) pixels away."""
    y, x = np.indices(image.shape[:2], np.float32)
    return cv2.remap(image, x + dx, y + dy, how, borderMode=cv2.BORDER_REFLECT_101)


def fog(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """A lens that steamed up."""
    amount, roughness = ((1.5, 2.0), (2.0, 2.0), (2.5, 1.7), (2.5, 1.5), (3.0, 1.4))[severity - 1]
    white = image / 255 + amount * _cloud(image.shape[:2], roughness, rng)[..., None]
    brightest = image.max() / 255
    return _bytes(white * brightest / (brightest + amount) * 255)


def _cloud(shape: tuple[int, ...], roughness: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of all scales in 0..1, each octave `roughness` times weaker than the one before."""
    height, width = shape
    octaves = range(int(np.log2(max(height, width))) + 1)
    layers = [
        cv2.resize(rng.random((2**n + 1, 2**n + 1)), (width, height), interpolation=cv2.INTER_LINEAR)
        / roughness**n
        for n in octaves
    ]
    cloud = np.sum(layers, axis=0)
    return (cloud - cloud.min()) / (cloud.max() - cloud.min())


def snow(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Flakes before the lens: dust and crumbs, in a bin."""
    share = (0.003, 0.006, 0.009, 0.012, 0.016)[severity - 1]
    length, kept = ((6, 0.9), (8, 0.85), (8, 0.8), (10, 0.75), (12, 0.7))[severity - 1]
    flakes = cv2.GaussianBlur((rng.random(image.shape[:2]) < share).astype(np.float32), (0, 0), 1.0) * 4
    flakes = np.clip(cv2.filter2D(flakes, -1, motion_kernel(length, rng.uniform(45, 135))), 0, 1)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[..., None].astype(np.float32)
    paler = kept * image + (1 - kept) * np.maximum(image, grey * 1.5 + 128)
    return _bytes(paler + 255 * flakes[..., None])


def frost(image: np.ndarray, severity: int, rng: np.random.Generator) -> np.ndarray:
    """Ice on the lens: bright veins, densest at the rim."""
    kept, added = ((1.0, 0.4), (0.8, 0.6), (0.7, 0.7), (0.65, 0.7), (0.6, 0.75))[severity - 1]
    height, width = image.shape[:2]
    veins = 1 - np.abs(2 * _cloud((height, width), 1.5, rng) - 1)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    ice = np.clip(veins**4 * (0.3 + 0.7 * np.maximum(np.abs(x), np.abs(y))), 0, 1)
    return _bytes(kept * image + added * 255 * ice[..., None] * np.array([1.0, 0.97, 0.92]))


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
        gaussian_noise, shot_noise, impulse_noise, defocus_blur, glass_blur, motion_blur, zoom_blur, snow,
        frost, fog, brightness, contrast, elastic, pixelate, jpeg, low_light, white_balance, cut_by_frame,
        turned, hand, gripper, clutter,
    )
}  # fmt: skip
