"""What may stand between an item and a clear picture, drawn at random and strongly: steam, ice, flakes, the
noise of a sensor, blur, glare, few pixels.

Networks learn from it. `corruptions.py`, which measures them, has disturbances of the same kinds, with other
generators and at five fixed severities; nothing here calls it.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from training import scenery
from training.dataset import recompress

Disturbance = Callable[[np.ndarray, np.random.Generator], np.ndarray]
"""(uint8 (side, side, 3) BGR, random numbers) -> the same shape and type."""

SECOND = 0.3
"""How often a second disturbance follows the first."""

FAINT = (0.15, 0.6)
"""How much of a disturbed view stands in one that is disturbed faintly."""


def disturbed(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The view after one disturbance, at times after two of them."""
    for _ in range(2 if rng.random() < SECOND else 1):
        which = int(rng.choice(len(DISTURBANCES), p=_OFTEN))
        view = DISTURBANCES[which](view, rng)
    return view


def faintly(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The view with a disturbance shining through it."""
    seen = rng.uniform(*FAINT)
    return cv2.addWeighted(view, 1 - seen, disturbed(view, rng), seen, 0)


def steam(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Droplets in the air or on the lens: light is lost on its way, and other light comes instead
    (Koschmieder, 1924), more in some places than in others."""
    side = view.shape[0]
    swaths = scenery.fractal(side, rng, rng.uniform(0.3, 0.85))[..., None]
    tint = rng.uniform(0.45, 1.0) * 255 * rng.uniform(0.93, 1.0, 3)
    if rng.random() < 0.5:
        passed = np.exp(-rng.uniform(0.3, 2.0) * (1 + rng.uniform(0, 1) * (2 * swaths - 1)))
        return _bytes(passed * view + (1 - passed) * tint)
    # The steam itself is lit unevenly, and dark where no light falls on it.
    kept, lit = rng.uniform(0.18, 0.7), rng.uniform(0, 0.5)
    return _bytes(kept * view + (1 - kept) * tint * (lit + (1 - lit) * swaths))


def ice(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Needles that grow inwards from the rim, with side branches, and rime between them."""
    side = view.shape[0]
    needles: np.ndarray = np.zeros((side, side), np.float32)
    for _ in range(int(rng.integers(8, 60))):
        angle = rng.uniform(0, 2 * np.pi)
        rim = 0.5 + rng.uniform(0.1, 0.7) * np.array([np.cos(angle), np.sin(angle)])
        _needle(needles, rim * side, angle + np.pi + rng.normal(0, 0.6), rng.uniform(0.08, 0.45) * side, rng)
    needles = cv2.GaussianBlur(needles, (0, 0), rng.uniform(0.4, 2.0))
    rime = scenery.fractal(side, rng, rng.uniform(0.4, 0.85))
    if rng.random() < 0.5:
        rime = 1 - np.abs(2 * rime - 1)
    cover = np.clip(rng.uniform(0, 1) * needles + rng.uniform(0.2, 1) * rime ** rng.uniform(1.5, 5), 0, 1)
    tint = 255 * np.array([1.0, *rng.uniform(0.85, 1.0, 2)])
    kept, added = rng.uniform(0.5, 1.0), rng.uniform(0.3, 0.9)
    return _bytes(kept * view + added * cover[..., None] * tint)


def _needle(
    mask: np.ndarray, start: np.ndarray, angle: float, length_px: float, rng: np.random.Generator
) -> None:
    """A straight line with branches at sixty degrees, as ice grows. In place."""

    def line(begin: np.ndarray, along: float, reach: float, width: int) -> None:
        end = begin + reach * np.array([np.cos(along), np.sin(along)])
        a, b = (tuple(map(int, point)) for point in (begin, end))
        cv2.line(mask, a, b, float(rng.uniform(0.4, 1.0)), width, cv2.LINE_AA)

    line(start, angle, length_px, int(rng.integers(1, 4)))
    for share in rng.uniform(0.1, 0.9, int(rng.integers(0, 8))):
        root = start + share * length_px * np.array([np.cos(angle), np.sin(angle)])
        line(root, angle + rng.choice((-1, 1)) * np.pi / 3, (1 - share) * 0.5 * length_px, 1)


def flakes(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Small bright things that fall past the lens: short strokes in about one direction, and a pale light."""
    side = view.shape[0]
    cover = np.zeros((side, side), np.float32)
    fall, length_px = rng.uniform(0, np.pi), rng.uniform(0.005, 0.06) * side
    count = int(np.exp(rng.uniform(np.log(60), np.log(1000))))
    begins = rng.uniform(0, side, (count, 2))
    angles, lengths = fall + rng.normal(0, 0.15, count), length_px * rng.uniform(0.5, 1.5, count)
    ends = begins + (lengths * np.array([np.cos(angles), np.sin(angles)])).T
    for (x0, y0), (x1, y1) in zip(begins.astype(int), ends.astype(int), strict=True):
        cv2.line(cover, (int(x0), int(y0)), (int(x1), int(y1)), float(rng.uniform(0.4, 1)), 1, cv2.LINE_AA)
    cover = np.clip(cv2.GaussianBlur(cover, (0, 0), rng.uniform(0.4, 1.2)) * rng.uniform(0.8, 1.8), 0, 1)
    pale = rng.uniform(0, 0.35)
    light = view + pale * (255.0 - view)
    return _bytes(light + cover[..., None] * (255.0 - light))


def sensor(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Little light: noise that grows with the root of the signal, and some that is always there."""
    signal = view.astype(np.float32) / 255
    electrons = float(np.exp(rng.uniform(np.log(4), np.log(150))))
    spread = np.sqrt(signal / electrons + rng.uniform(0, 0.08) ** 2)
    noise = rng.standard_normal(view.shape, np.float32)
    if rng.random() < 0.2:
        noise[:] = noise[..., :1]  # a camera without colour
    return _bytes(255 * (signal + spread * noise))


def lost_pixels(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Single pixels or single colours of pixels that say anything, mostly nothing or all."""
    share = rng.uniform(0.01, 0.3)
    shape = view.shape if rng.random() < 0.7 else (*view.shape[:2], 1)
    hit = rng.random(shape, np.float32) < share
    said = rng.integers(0, 256, view.shape).astype(np.uint8)
    if rng.random() < 0.7:
        said = np.where(said < 128, 0, 255).astype(np.uint8)
    return np.where(hit, said, view)


def out_of_focus(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A disc of light of each point, or a smear towards a place in the picture."""
    side = view.shape[0]
    if rng.random() < 0.5:
        radius = rng.uniform(0.004, 0.03) * side
        y, x = np.mgrid[-12:13, -12:13]
        disc = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1).astype(np.float32)
        return cv2.filter2D(view, -1, disc / disc.sum())
    centre = rng.uniform(0.3, 0.7, 2) * side
    total, nearer = np.zeros(view.shape, np.float32), rng.uniform(0.04, 0.35)
    for share in np.linspace(0, 1, 8):
        zoom = cv2.getRotationMatrix2D(tuple(map(float, centre)), 0, float(1 + nearer * share))
        total += cv2.warpAffine(view, zoom, (side, side), borderMode=cv2.BORDER_REFLECT_101)
    return _bytes(total / 8)


def rough_glass(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A pane whose surface bends light a little everywhere: finely (etched) or in waves (cast)."""
    side = view.shape[0]
    grain = rng.uniform(0.3, 1.0) if rng.random() < 0.6 else rng.uniform(2, 12)
    bend = rng.standard_normal((2, side, side), np.float32)
    bent = np.stack([cv2.GaussianBlur(one, (0, 0), grain) for one in bend])
    bent *= np.float32(rng.uniform(0.5, 2.2) * min(1 + grain / 8, 2) / bent.std())
    y, x = np.indices((side, side), np.float32)
    through = cv2.remap(view, x + bent[0], y + bent[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    return cv2.GaussianBlur(through, (0, 0), rng.uniform(0.3, 1.3))


def flat_light(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Little contrast, around any grey; or so much light that the sensor is full."""
    if rng.random() < 0.6:
        grey = 0.7 * float(view.mean()) + 0.3 * rng.uniform(0, 255)
        return _bytes((view - grey) * rng.uniform(0.12, 0.7) + grey)
    return _bytes(view * rng.uniform(1.0, 1.6) + rng.uniform(0, 100))


def few_pixels(view: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A small sensor, or a compression that spares nothing."""
    if rng.random() < 0.5:
        return recompress(view, int(rng.integers(4, 30)))
    side = view.shape[0]
    few = int(rng.uniform(0.15, 0.5) * side)
    small = cv2.resize(view, (few, few), interpolation=cv2.INTER_AREA)
    how = cv2.INTER_NEAREST if rng.random() < 0.6 else cv2.INTER_CUBIC
    return cv2.resize(small, (side, side), interpolation=how)


DISTURBANCES: tuple[Disturbance, ...] = (
    steam, ice, flakes, sensor, lost_pixels, out_of_focus, rough_glass, flat_light, few_pixels,
)  # fmt: skip
_OFTEN = np.array([4, 3, 2, 3, 3, 1, 2, 1, 1]) / 20
"""What the shipped networks know least comes most often."""


def _bytes(view: np.ndarray) -> np.ndarray:
    return np.clip(view, 0, 255).astype(np.uint8)
