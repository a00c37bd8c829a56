"""Random views of a picture, so that a few photos on white boards teach what a bin sees: turned, cut by the
frame, cluttered, half covered, blurred, dim, in coloured light, through cheap cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from training import scenery
from training.dataset import recompress


@dataclass(frozen=True)
class Chances:
    """How often a view suffers from what; each is drawn on its own.

    Twice as often cost two points on clean photos for two on corrupted ones.
    """

    any_turn: float = 0.4
    cut: float = 0.08
    clutter: float = 0.08
    covered: float = 0.2
    blur: float = 0.12
    low_resolution: float = 0.06
    noise: float = 0.15
    compression: float = 0.12
    coloured_light: float = 0.1
    dim_or_bright: float = 0.12


CHANCES = Chances()
SELDOM = Chances(
    any_turn=0.3,
    cut=0.04,
    clutter=0.04,
    covered=0.08,
    blur=0.06,
    low_resolution=0.03,
    noise=0.06,
    compression=0.06,
    coloured_light=0.05,
    dim_or_bright=0.06,
)
"""Little of everything, so that what was learnt of it is not forgotten."""


Background = Callable[[np.random.Generator], np.ndarray]
"""Random numbers -> uint8 (h, w, 3)."""


def drawn(rng: np.random.Generator) -> np.ndarray:
    """A drawn texture."""
    return scenery.TEXTURES[int(rng.integers(len(scenery.TEXTURES)))](192, rng)


def augment(
    image_bgr: np.ndarray,
    side: int,
    rng: np.random.Generator,
    chances: Chances = CHANCES,
    background: Background = drawn,
) -> np.ndarray:
    """A random view of the picture, uint8 (side, side, 3). Clutter is before a `background`."""
    if rng.random() < chances.clutter:
        image_bgr = before_clutter(image_bgr, rng, background)
    view = _reframed(image_bgr, side, rng, chances)
    if rng.random() < chances.covered:
        _cover(view, rng)
    return _through_a_camera(_lit(view, rng, chances), rng, chances)


def item_mask(image_bgr: np.ndarray) -> np.ndarray | None:
    """Where the item is on a plain board: float32 (h, w) in 0..1, None where that cannot be told.

    The board is what the picture's rim shows; the item is the filled outline of what differs from it.
    """
    height, width = image_bgr.shape[:2]
    small = cv2.resize(image_bgr, (96, 96), interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(small, cv2.COLOR_BGR2LAB).astype(np.float32)
    rim = np.concatenate([lab[:6].reshape(-1, 3), lab[-6:].reshape(-1, 3),
                          lab[:, :6].reshape(-1, 3), lab[:, -6:].reshape(-1, 3)])  # fmt: skip
    board = np.median(rim, axis=0)
    # The board's brightness falls off towards its corners, its colour does not.
    weight = np.array([0.6, 1.5, 1.5], np.float32)
    distance = np.linalg.norm((lab - board) * weight, axis=2)
    differs = (distance > 14).astype(np.uint8)
    differs = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    outlines, _ = cv2.findContours(differs, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not outlines:
        return None
    mask = np.zeros((96, 96), np.uint8)
    cv2.drawContours(mask, [max(outlines, key=cv2.contourArea)], -1, 255, -1)
    on_rim = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).mean() / 255
    if not 0.12 < mask.mean() / 255 < 0.8 or on_rim > 0.35:
        return None
    return cv2.resize(mask, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.float32) / 255


def before_clutter(
    image_bgr: np.ndarray, rng: np.random.Generator, background: Background = drawn
) -> np.ndarray:
    """The item cut out and put before something else; the picture itself where it cannot be cut out."""
    mask = item_mask(image_bgr)
    if mask is None:
        return image_bgr
    height, width = image_bgr.shape[:2]
    behind = cv2.resize(background(rng), (width, height), interpolation=cv2.INTER_LINEAR)
    alpha = mask[..., None]
    return (alpha * image_bgr + (1 - alpha) * behind).astype(np.uint8)


def _reframed(image_bgr: np.ndarray, side: int, rng: np.random.Generator, chances: Chances) -> np.ndarray:
    """Turned, mirrored, stretched, enlarged and shifted, by one affine warp."""
    height, width = image_bgr.shape[:2]
    shown = np.sqrt(rng.uniform(0.4, 1.0))
    stretch = np.sqrt(rng.uniform(0.75, 1.33))
    angle = rng.uniform(-np.pi, np.pi) if rng.random() < chances.any_turn else rng.normal(0.0, 0.15)
    flip = rng.choice((-1.0, 1.0))
    slack = (1.0 - shown) / 2 + (0.2 if rng.random() < chances.cut else 0.0)
    centre = np.array([width, height]) * (0.5 + rng.uniform(-slack, slack, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    photo_per_view = turn @ np.diag([flip * width * shown * stretch, height * shown / stretch]) / side
    offset = centre - photo_per_view @ np.full(2, side / 2)
    return cv2.warpAffine(
        image_bgr,
        np.column_stack([photo_per_view, offset]),
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )


def _cover(view: np.ndarray, rng: np.random.Generator) -> None:
    """Something stands in the way: a hand, a gripper, anything. In place."""
    side, what = view.shape[0], rng.random()
    if what < 0.3:
        scenery.draw_hand(view, rng, reach=rng.uniform(0.1, 0.35))
    elif what < 0.5:
        scenery.draw_gripper(view, rng, reach=rng.uniform(0.1, 0.35))
    else:
        w, h = (rng.uniform(0.1, 0.4, 2) * side).astype(int)
        x, y = rng.integers(0, side - w), rng.integers(0, side - h)
        patch = scenery.TEXTURES[int(rng.integers(len(scenery.TEXTURES)))](64, rng)
        view[y : y + h, x : x + w] = cv2.resize(patch, (int(w), int(h)))


def _lit(view: np.ndarray, rng: np.random.Generator, chances: Chances) -> np.ndarray:
    """Exposure, white balance and contrast."""
    cast = 0.3 if rng.random() < chances.coloured_light else 0.1
    gain = rng.uniform(0.65, 1.35) * rng.uniform(1 - cast, 1 + cast, 3)
    contrast, gamma = rng.uniform(0.75, 1.25), 1.0
    if rng.random() < chances.dim_or_bright:
        gain *= rng.uniform(0.25, 1.7)
        gamma = rng.uniform(0.6, 1.6)
        contrast *= rng.uniform(0.5, 1.2)
    levels = np.arange(256, dtype=np.float32)[:, None]
    grey = float(view.mean())
    table = ((levels - grey) * contrast + grey) * gain
    table = 255 * (np.clip(table, 0, 255) / 255) ** gamma
    return cv2.LUT(view, table.astype(np.uint8)[None])


def _through_a_camera(view: np.ndarray, rng: np.random.Generator, chances: Chances) -> np.ndarray:
    """Blur, few pixels, noise, compression."""
    side = view.shape[0]
    if rng.random() < chances.blur:
        if rng.random() < 0.5:
            view = cv2.GaussianBlur(view, (0, 0), rng.uniform(0.5, 3.0))
        else:
            view = cv2.filter2D(view, -1, motion_kernel(int(rng.integers(3, 16)), rng.uniform(0, 180)))
    if rng.random() < chances.low_resolution:
        few = int(rng.uniform(0.2, 0.7) * side)
        view = cv2.resize(view, (few, few), interpolation=cv2.INTER_AREA)
        how = cv2.INTER_NEAREST if rng.random() < 0.3 else cv2.INTER_LINEAR
        view = cv2.resize(view, (side, side), interpolation=how)
    if rng.random() < chances.noise:
        noise = rng.standard_normal(view.shape, np.float32) * np.float32(rng.uniform(2, 30))
        view = np.clip(view + noise, 0, 255).astype(np.uint8)
    if rng.random() < chances.compression:
        view = recompress(view, int(rng.integers(8, 70)))
    return view


def motion_kernel(length_px: int, angle_deg: float) -> np.ndarray:
    """Kernel of a straight move of `length_px`."""
    kernel = np.zeros((length_px, length_px), np.float32)
    kernel[length_px // 2] = 1
    centre = (length_px - 1) / 2
    turn = cv2.getRotationMatrix2D((centre, centre), angle_deg, 1)
    turned = np.asarray(cv2.warpAffine(kernel, turn, (length_px, length_px)))
    return turned / max(float(turned.sum()), 1e-6)
