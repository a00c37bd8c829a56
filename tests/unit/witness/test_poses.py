"""Poses as motion capture packs them."""

from __future__ import annotations

import base64
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rodeo.evidence.errors import BadStatement
from rodeo.witness.poses import LARGEST_M, POSE_BYTES, STEP_M, pack, unpack

CHANCE = np.random.default_rng(5)


def test_what_is_unpacked_is_what_was_packed_to_half_a_step() -> None:
    offset_us = np.arange(200) * 20_000
    position_m = CHANCE.uniform(-800, 800, (200, 3))
    turns = Rotation.random(200, rng=CHANCE)
    text = pack(offset_us, position_m, turns.as_quat(scalar_first=True))
    found_us, found_m, found = unpack(text)
    assert (found_us == offset_us).all()
    assert np.abs(found_m - position_m).max() <= STEP_M / 2 + 1e-9
    error_rad = (Rotation.from_quat(found, scalar_first=True) * turns.inv()).magnitude()
    assert error_rad.max() < 1e-4
    assert len(base64.b64decode(text)) == 200 * POSE_BYTES


@pytest.mark.parametrize("quaternion", [(1, 0, 0, 0), (0, 0, 0, -1), (0.5, 0.5, -0.5, 0.5), (0, 1, -1, 0)])
def test_orientations_on_the_edge_keep_their_sign(quaternion: tuple[float, ...]) -> None:
    unit = np.array([quaternion]) / np.linalg.norm(quaternion)
    _, _, found = unpack(pack(np.array([0]), np.zeros((1, 3)), unit))
    assert abs(float((found * unit).sum())) == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("w", [0.0, 0.5, 2.0, math.nan, math.inf])
def test_an_orientation_that_is_no_rotation_is_refused(w: float) -> None:
    with pytest.raises(ValueError, match="unit quaternion"):
        pack(np.array([0, 1]), np.zeros((2, 3)), np.array([[1.0, 0, 0, 0], [w, 0, 0, 0]]))


@pytest.mark.parametrize("x_m", [math.nan, math.inf, -math.inf])
def test_a_position_that_is_not_finite_is_refused(x_m: float) -> None:
    with pytest.raises(ValueError, match="beyond"):
        pack(np.array([0]), np.array([[0.0, x_m, 0.0]]), np.array([[1.0, 0, 0, 0]]))


def test_a_position_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="beyond"):
        pack(np.array([0]), np.array([[LARGEST_M * 1.01, 0, 0]]), np.array([[1.0, 0, 0, 0]]))


@pytest.mark.parametrize(
    "text",
    ["", "not base64!", base64.b64encode(b"x" * 18).decode(), base64.b64encode(b"\xff" * 19).decode()],
)
def test_what_is_no_track_is_refused(text: str) -> None:
    with pytest.raises(BadStatement):
        unpack(text)
