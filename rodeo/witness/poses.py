"""Poses as motion capture signs them: `POSE_BYTES` each, in base64.

Little-endian: microseconds after the statement's `start_us` (uint32); x, y, z in steps of `STEP_M` (24 bits
each); and the orientation as its three smallest components (48 bits). The largest component follows from the
unit norm, and q and -q are the same rotation, so it is taken as positive. Errors: half of `STEP_M`, and less
than 1e-4 rad.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from typing import Any

import numpy as np

from rodeo.evidence.errors import BadStatement
from rodeo.ros2.readings import UNIT_SLACK

Array = np.ndarray[Any, Any]

REST_M = 0.001
"""A body that stays this close to its last signed pose rests; motion capture repeats to a third of that."""
REST_RAD = 0.002
REST_PERIOD_US = 10_000_000
"""Time after which the pose of a resting body is signed again."""

STEP_M = 1e-4
POSE_BYTES = 19
MAX_POSES = 20_000
"""In one track: a statement covers a second, or ten of rest."""
LARGEST_M = (2**23 - 1) * STEP_M

_HALF = 20480
_LEVELS = np.uint64(2 * _HALF + 1)
"""Levels of each component: four times their cube, for the index of the largest, fits in 48 bits."""
_SCALE = _HALF * np.sqrt(2.0)
"""The three smallest components of a unit quaternion lie within 1/sqrt(2)."""
_RECORD = np.dtype([("offset_us", "<u4"), ("position", "u1", (3, 3)), ("orientation", "u1", 6)])
assert _RECORD.itemsize == POSE_BYTES


def pack(offset_us: Array, position_m: Array, quaternion: Array) -> str:
    """Poses (n,), (n, 3) and (n, 4) w, x, y, z as text.

    Raises ValueError beyond `LARGEST_M`, and for an orientation that is no unit quaternion.
    """
    steps = np.rint(np.asarray(position_m, float) / STEP_M)
    if not (np.abs(steps) < 2**23).all():
        raise ValueError(f"a position is beyond {LARGEST_M:.0f} m")
    records = np.zeros(len(steps), _RECORD)
    records["offset_us"] = offset_us
    records["position"] = steps.astype("<i4").view("u1").reshape(-1, 3, 4)[..., :3]
    norm = np.linalg.norm(quaternion, axis=1, keepdims=True)
    if not (np.abs(norm - 1) <= UNIT_SLACK).all():
        raise ValueError("an orientation is no unit quaternion")
    unit = np.asarray(quaternion, float) / norm
    largest = np.abs(unit).argmax(axis=1)
    rows = np.arange(len(unit))
    unit *= np.where(unit[rows, largest] < 0, -1.0, 1.0)[:, None]
    small = np.rint(unit[rows[:, None], _OTHERS[largest]] * _SCALE).astype(np.int64) + _HALF
    bits = largest.astype(np.uint64)
    for column in small.T:
        bits = bits * _LEVELS + column.astype(np.uint64)
    records["orientation"] = bits.astype("<u8").view("u1").reshape(-1, 8)[:, :6]
    return base64.b64encode(records.tobytes()).decode()


def unpack(text: str) -> tuple[Array, Array, Array]:
    """(n,) microseconds after `start_us`, (n, 3) m, and (n, 4) unit quaternions w, x, y, z.

    Raises BadStatement when it is no track, or longer than `MAX_POSES`.
    """
    return unpack_all([text])[0]


def unpack_all(texts: Sequence[str]) -> list[tuple[Array, Array, Array]]:
    """Unpack several tracks at once, because single ones cost most of their time in small arrays."""
    if not texts:
        return []
    parts = [_raw(text) for text in texts]
    records = np.frombuffer(b"".join(parts), _RECORD)
    wide = np.zeros((len(records), 3, 4), "u1")
    wide[..., 1:] = records["position"]
    position_m = (wide.view("<i4")[..., 0] >> 8) * STEP_M
    bits = np.zeros((len(records), 8), "u1")
    bits[:, :6] = records["orientation"]
    rest = bits.view("<u8")[:, 0].copy()
    small = np.empty((len(records), 3))
    for column in (2, 1, 0):
        rest, value = np.divmod(rest, _LEVELS)
        small[:, column] = (value.astype(float) - _HALF) / _SCALE
    square = (small**2).sum(axis=1)
    if (none := (rest > 3) | (square > 1.0)).any():
        raise BadStatement("an orientation is not a valid quaternion", index=int(none.argmax()))
    quaternion = np.empty((len(records), 4))
    rows, largest = np.arange(len(records)), rest.astype(int)
    quaternion[rows[:, None], _OTHERS[largest]] = small
    quaternion[rows, largest] = np.sqrt(1.0 - square)
    offset_us = records["offset_us"].astype(np.int64)
    ends = np.cumsum([len(part) // POSE_BYTES for part in parts])
    return [
        (offset_us[begin:end], position_m[begin:end], quaternion[begin:end])
        for begin, end in zip([0, *ends], ends, strict=False)
    ]


def _raw(text: str) -> bytes:
    """The bytes of a track. Raises BadStatement."""
    if len(text) > MAX_POSES * POSE_BYTES * 4 // 3 + 4:
        raise BadStatement("a track is too long", characters=len(text), limit_poses=MAX_POSES)
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise BadStatement("a track is not base64", cause=str(error)) from error
    if not data or len(data) % POSE_BYTES:
        raise BadStatement("a track does not hold whole poses", length_bytes=len(data), pose_bytes=POSE_BYTES)
    return data


_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Components beside the largest."""
