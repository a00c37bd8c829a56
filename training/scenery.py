"""Pictures without waste, drawn by numbers: textures, plain boards, hands and grippers.

They stand behind items, in front of them and alone. The classifier learns from some of them what `unknown`
is; `HELD_OUT_TEXTURES` are kept for measuring.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

Texture = Callable[[int, np.random.Generator], np.ndarray]
"""(side in px, random numbers) -> uint8 (side, side, 3)."""


def _colour(rng: np.random.Generator) -> np.ndarray:
    """Any BGR colour, greyish ones more often than gaudy ones, as things around a bin are."""
    grey = rng.uniform(20, 240)
    return np.clip(grey + rng.normal(0, rng.choice((4.0, 40.0)), 3), 0, 255)


def fractal(side: int, rng: np.random.Generator, roughness: float) -> np.ndarray:
    """Noise summed over octaves, float32 (side, side) in 0..1; rougher means more of the small ones."""
    total = np.zeros((side, side), np.float32)
    cells, weight = int(rng.integers(2, 6)), 1.0
    while cells < side // 2:
        grid = rng.random((cells, cells), np.float32)
        total += weight * cv2.resize(grid, (side, side), interpolation=cv2.INTER_CUBIC)
        cells, weight = cells * 2, weight * roughness
    low, high = total.min(), total.max()
    return (total - low) / max(high - low, 1e-6)


def _blend(weight: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Two random colours mixed by `weight` (side, side) in 0..1."""
    w = weight[..., None]
    return (w * _colour(rng) + (1 - w) * _colour(rng)).astype(np.uint8)


def board(side: int, rng: np.random.Generator) -> np.ndarray:
    """A plain surface in uneven light, with the grain of a camera."""
    ramp = np.linspace(-1, 1, side, dtype=np.float32)
    slope_x, slope_y = rng.normal(0, 0.1, 2)
    light = 1 + slope_x * ramp[None, :, None] + slope_y * ramp[:, None, None]
    grain = rng.normal(0, rng.uniform(0.5, 4), (side, side, 1))
    return np.clip(_colour(rng) * light + grain, 0, 255).astype(np.uint8)


def clouds(side: int, rng: np.random.Generator) -> np.ndarray:
    """Soft spots: plaster, shadow, something out of focus."""
    return _blend(fractal(side, rng, 0.4), rng)


def grain(side: int, rng: np.random.Generator) -> np.ndarray:
    """Fine noise drawn out in one direction: carpet, wood, brushed concrete."""
    reach = int(rng.integers(1, 40))
    window = (reach, 1) if rng.random() < 0.5 else (1, reach)
    noise = np.asarray(cv2.blur(rng.random((side, side)).astype(np.float32), window))
    low, high = noise.min(), noise.max()
    return _blend((noise - low) / max(high - low, 1e-6), rng)


def stripes(side: int, rng: np.random.Generator) -> np.ndarray:
    """Parallel bands: boards, tiles seen along, a roller door."""
    y, x = np.mgrid[0:side, 0:side] / side
    angle, turns, sharp = rng.uniform(0, np.pi), rng.uniform(2, 24), rng.uniform(1, 8)
    wave = np.sin(2 * np.pi * turns * (x * np.cos(angle) + y * np.sin(angle)))
    return _blend((0.5 + 0.5 * np.tanh(sharp * wave)).astype(np.float32), rng)


def shapes(side: int, rng: np.random.Generator) -> np.ndarray:
    """Overlapping polygons and discs in flat colours: furniture, a wall with things on it."""
    image = board(side, rng)
    for _ in range(int(rng.integers(2, 12))):
        colour = tuple(map(float, _colour(rng)))
        if rng.random() < 0.7:
            centre, spread = rng.uniform(0, side, 2), rng.uniform(0.05, 0.5) * side
            corners = centre + rng.normal(0, spread, (int(rng.integers(3, 6)), 2))
            cv2.fillConvexPoly(image, cv2.convexHull(corners.astype(np.int32)), colour, cv2.LINE_AA)
        else:
            at = tuple(map(int, rng.uniform(0, side, 2)))
            cv2.circle(image, at, int(rng.uniform(0.03, 0.25) * side), colour, -1, cv2.LINE_AA)
    return image


def static(side: int, rng: np.random.Generator) -> np.ndarray:
    """What a camera without a signal sends: noise, blocks, or one colour."""
    cells = int(rng.choice((1, 4, 16, side)))
    noise = rng.integers(0, 256, (cells, cells, 3)).astype(np.uint8)
    return cv2.resize(noise, (side, side), interpolation=cv2.INTER_NEAREST)


def checks(side: int, rng: np.random.Generator) -> np.ndarray:
    """Tiles with joints."""
    image, tile = board(side, rng), int(rng.integers(side // 16, side // 3))
    joint = tuple(map(float, _colour(rng)))
    for at in range(int(rng.integers(tile)), side, tile):
        thick = int(rng.integers(1, 4))
        cv2.line(image, (at, 0), (at, side), joint, thick)
        cv2.line(image, (0, at), (side, at), joint, thick)
    return image


def marble(side: int, rng: np.random.Generator) -> np.ndarray:
    """Veins: rough fractal noise folded on itself."""
    veins = np.abs(np.sin(rng.uniform(4, 20) * fractal(side, rng, 0.6)))
    return _blend(veins.astype(np.float32), rng)


def hand(side: int, rng: np.random.Generator) -> np.ndarray:
    """A hand or a gripper reaching into an otherwise empty view."""
    image = TEXTURES[int(rng.integers(len(TEXTURES)))](side, rng)
    (draw_hand if rng.random() < 0.75 else draw_gripper)(image, rng, reach=rng.uniform(0.3, 0.7))
    return image


TEXTURES: tuple[Texture, ...] = (board, clouds, grain, stripes, shapes, static)
HELD_OUT_TEXTURES: tuple[Texture, ...] = (checks, marble)


def draw_hand(image_bgr: np.ndarray, rng: np.random.Generator, reach: float) -> None:
    """Draw a forearm, a palm and five fingers from an edge inwards over `reach` of the side, in place."""
    height, width_px = image_bgr.shape[:2]
    side = min(height, width_px)
    skin = np.array([135, 175, 225]) * rng.uniform(0.3, 1.1) * rng.uniform(0.9, 1.1, 3)
    angle = rng.uniform(0, 2 * np.pi)
    ahead = np.array([np.cos(angle), np.sin(angle)])
    aside = np.array([-ahead[1], ahead[0]])
    extent = np.array([width_px, height])
    tip = extent / 2 - (0.5 - reach) * ahead * extent + aside * rng.normal(0, 0.12) * side
    size = rng.uniform(0.1, 0.2) * side
    palm = tip - ahead * size * 2.2
    mask = np.zeros(image_bgr.shape[:2], np.uint8)

    def limb(start: np.ndarray, end: np.ndarray, width: float) -> None:
        a, b = (tuple(map(int, point)) for point in (start, end))
        cv2.line(mask, a, b, 255, max(int(width), 2), cv2.LINE_AA)

    limb(palm, palm - ahead * side * 1.5, size * 1.2)
    cv2.ellipse(mask, (tuple(map(float, palm)), (size * 2.0, size * 1.7), float(np.degrees(angle))), 255, -1)
    for finger in range(4):
        root = palm + aside * (finger - 1.5) * size * 0.45 + ahead * size * 0.6
        bend = rng.normal(0, 0.2)
        limb(root, root + (ahead + aside * bend) * size * rng.uniform(0.7, 1.6), size * 0.4)
    limb(palm, palm + (aside * rng.choice((-1, 1)) + 0.5 * ahead) * size * 1.3, size * 0.45)
    _paint(image_bgr, mask, skin, rng)


def draw_gripper(image_bgr: np.ndarray, rng: np.random.Generator, reach: float) -> None:
    """Draw two parallel fingers and their palm from an edge inwards over `reach` of the side, in place."""
    height, width_px = image_bgr.shape[:2]
    side = min(height, width_px)
    angle = rng.choice((0.0, 0.5, 1.0, 1.5)) * np.pi + rng.normal(0, 0.2)
    ahead = np.array([np.cos(angle), np.sin(angle)])
    aside = np.array([-ahead[1], ahead[0]])
    extent = np.array([width_px, height])
    tip = extent / 2 - (0.5 - reach) * ahead * extent
    gap, width = rng.uniform(0.1, 0.35) * side, rng.uniform(0.04, 0.12) * side
    mask = np.zeros(image_bgr.shape[:2], np.uint8)
    palm = tip - ahead * rng.uniform(0.15, 0.35) * side

    def box(centre: np.ndarray, along: float, across: float) -> None:
        corners = [centre + i * ahead * along / 2 + j * aside * across / 2
                   for i, j in ((1, 1), (1, -1), (-1, -1), (-1, 1))]  # fmt: skip
        cv2.fillConvexPoly(mask, np.array(corners).astype(np.int32), 255, cv2.LINE_AA)

    for finger in (-0.5, 0.5):
        centre = (tip + palm) / 2 + aside * finger * (gap + width)
        box(centre, float(np.linalg.norm(tip - palm)), width)
    box(palm - ahead * side * 0.5, side, (gap + 2 * width) * rng.uniform(0.8, 1.3))
    _paint(image_bgr, mask, _colour(rng), rng)


def _paint(image_bgr: np.ndarray, mask: np.ndarray, colour: np.ndarray, rng: np.random.Generator) -> None:
    """Fill `mask` with `colour`, lit unevenly so that it looks round."""
    height, width = mask.shape
    inside = cv2.GaussianBlur(mask, (0, 0), min(height, width) / 40).astype(np.float32) / 255
    spots = cv2.resize(fractal(min(height, width), rng, 0.4), (width, height))
    shade = (0.55 + 0.45 * inside + 0.15 * (spots - 0.5))[..., None]
    alpha = cv2.GaussianBlur(mask, (0, 0), 0.8).astype(np.float32)[..., None] / 255
    image_bgr[:] = np.clip(alpha * shade * colour + (1 - alpha) * image_bgr, 0, 255).astype(np.uint8)
