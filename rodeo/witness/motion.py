"""From the poses that motion capture sees to the fields of its `mocap.motion` statements, and back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rodeo.evidence.errors import BadStatement
from rodeo.ros2.readings import is_rotation
from rodeo.witness.poses import LARGEST_M, REST_M, REST_PERIOD_US, REST_RAD, pack, unpack_all
from rodeo.witness.statement import MAX_STALLS, Motion

Array = np.ndarray[Any, Any]

PERIOD_US = 1_000_000
"""Time that a statement covers while a body moves."""
LISTENING_PERIOD_US = 2_000_000
"""Time that a statement covers while nothing moves and heads of others were heard."""

_REST_DOT = float(np.cos(REST_RAD / 2))
"""Dot product of two unit quaternions that are `REST_RAD` apart."""


LOST_US = 2_000_000
"""Time without a sighting after which nothing is known of a body meanwhile, wherever it is then. A
simulated lab that skips idle time shows its bodies once a second."""
STEP_US = 200_000
"""Between two poses of a moving body: more shows nothing of the way."""
SEEN_US = 50_000
"""A body at rest that was seen so shortly before counts as seen: cameras take some ten to a hundred poses a
second."""


class Sample(NamedTuple):
    """One pose: position in m, unit quaternion w, x, y, z."""

    time_us: int
    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


class MotionFields(NamedTuple):
    """What a `Motion` statement says beside its header."""

    start_us: int
    end_us: int
    tracks: dict[str, str]
    resting: dict[str, int]
    unseen_us: dict[str, int]
    stalls_us: tuple[tuple[int, int], ...]


class _Body:
    def __init__(self) -> None:
        self.signed: Sample | None = None
        """Its last signed pose."""
        self.signed_in = 0
        """`seq` of the statement that has it."""
        self.told_us = 0
        """When a pose of it was signed last, as this one or as one at rest."""
        self.moved = False
        """Since then."""
        self.lost = False
        """Not seen for a while since the last statement."""
        self.seen_us: int | None = None
        self.samples: list[Sample] = []
        """Since the last statement, from the last pose at rest on."""
        self.taken = False
        """Whether the pose that was told last is among them."""

    def add(self, sample: Sample) -> None:
        self.taken = False
        if self.seen_us is not None:
            if sample.time_us <= self.seen_us:
                return
            if sample.time_us - self.seen_us > LOST_US:
                # Its track begins anew where it is seen again.
                self.lost, self.moved, self.samples = True, True, []
        self.seen_us, self.taken = sample.time_us, True
        if not self.moved and self.signed is not None:
            # What sleeps in a simulated lab does not differ by a bit from what was found at rest.
            known = self.samples and self.samples[-1][1:] == sample[1:]
            if known or _rests(self.signed, sample):
                self.samples = [sample]
                return
        self.moved = True
        self.samples.append(sample)

    def add_all(self, samples: list[Sample]) -> None:
        if self.moved and self.seen_us is not None:
            first_us, last_us = samples[0].time_us, samples[-1].time_us
            if self.seen_us < first_us and last_us - self.seen_us <= LOST_US:
                self.seen_us, self.taken = last_us, True
                self.samples += samples
                return
        for sample in samples:
            self.add(sample)

    def stays(self, time_us: int) -> bool:
        if self.moved or self.signed is None or self.seen_us is None or not (self.taken and self.samples):
            return False
        if not 0 < time_us - self.seen_us <= LOST_US:
            return False
        self.seen_us = time_us
        _, position_m, quaternion = self.samples[-1]
        self.samples = [Sample(time_us, position_m, quaternion)]
        return True

    def stood_still(self, from_us: int, to_us: int) -> None:
        """Nothing moved in this time, seen or not."""
        if self.seen_us is not None:
            self.seen_us += to_us - from_us

    def until(self, now_us: int) -> tuple[list[Sample], list[Sample]]:
        """What was seen up to now, and what is stamped later, taken away. A camera's stamp may be some
        milliseconds ahead: a moving body's pose then belongs to the next statement."""
        if self.moved:
            split = sum(one.time_us <= now_us for one in self.samples)
            seen, ahead = self.samples[:split], self.samples[split:]
        else:
            seen, ahead = [one._replace(time_us=min(one.time_us, now_us)) for one in self.samples], []
        self.moved, self.samples = False, []
        return seen, ahead

    def keep(self, ahead: list[Sample]) -> None:
        """What `until` left over."""
        for one in ahead:
            self.seen_us = None
            self.add(one)


def _can_be_signed(sample: Sample) -> bool:
    """Whether the position is finite and near enough, and the orientation a rotation."""
    _, (x_m, y_m, z_m), quaternion = sample
    # False for NaN.
    near = -LARGEST_M < x_m < LARGEST_M and -LARGEST_M < y_m < LARGEST_M and -LARGEST_M < z_m < LARGEST_M
    return near and is_rotation(*quaternion)


def _rests(signed: Sample, sample: Sample) -> bool:
    (x, y, z), (a, b, c) = signed.position_m, sample.position_m
    if (x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2 > REST_M**2:
        return False
    (p, q, r, s), (t, u, v, w) = signed.quaternion, sample.quaternion
    dot = p * t + q * u + r * v + s * w
    return abs(dot) >= _REST_DOT


class MotionLog:
    """Collects poses of `bodies` from `start_us` on. One thread at a time."""

    def __init__(self, bodies: Iterable[str], start_us: int) -> None:
        self._bodies = {name: _Body() for name in bodies}
        self._start_us = start_us
        self._stalls_us: list[tuple[int, int]] = []

    def stall(self, from_us: int, to_us: int) -> None:
        """The simulated lab stood still in this time, which nobody saw pass."""
        if len(self._stalls_us) == MAX_STALLS:
            return  # a hole like others
        self._stalls_us.append((from_us, to_us))
        for body in self._bodies.values():
            body.stood_still(from_us, to_us)

    def add(self, body: str, sample: Sample) -> None:
        """A pose. One that is not later than the one before, or cannot be signed, counts as not seen."""
        if _can_be_signed(sample):
            self._bodies[body].add(sample)
        else:
            self._bodies[body].taken = False

    def add_all(self, body: str, samples: list[Sample]) -> None:
        """Poses at rising times; like `add`, and faster for a moving body."""
        if all(map(_can_be_signed, samples)):
            self._bodies[body].add_all(samples)
        else:
            for sample in samples:
                self.add(body, sample)

    def stays(self, body: str, time_us: int) -> bool:
        """The body is seen in the pose that was told of it last, to the bit. False, and nothing done, where
        that is more than a further moment of rest: it has to be added."""
        return self._bodies[body].stays(time_us)

    @property
    def undue_until_us(self) -> int:
        """No statement is due before."""
        whole_us = (self._start_us // REST_PERIOD_US + 1) * REST_PERIOD_US
        return min(self._start_us + PERIOD_US, whole_us)

    def due(self, now_us: int, heads: bool) -> bool:
        """Whether a statement is due; `heads` tells whether heads of others were heard.

        At rest it is due at whole periods of the time, not of the witness: who waits for it, such as a
        recording that begins with it, waits as long whenever the witness was started.
        """
        lasted_us = now_us - self._start_us
        for body in self._bodies.values():
            if body.moved:
                return lasted_us >= PERIOD_US
        if now_us // REST_PERIOD_US > self._start_us // REST_PERIOD_US:
            return True
        return heads and lasted_us >= LISTENING_PERIOD_US

    def take(self, now_us: int, seq: int) -> MotionFields:
        """What was seen since the last call, for the statement with this number."""
        tracks: dict[str, str] = {}
        resting: dict[str, int] = {}
        unseen_us: dict[str, int] = {}
        moved = {name for name, body in self._bodies.items() if body.moved}
        taken = {name: body.until(now_us) for name, body in self._bodies.items()}
        # What is stamped before the last statement's end, and came after it, is signed all the same.
        first_us = [seen[0].time_us for name, (seen, _) in taken.items() if name in moved and seen]
        start_us = min([self._start_us, *first_us])
        for name, body in self._bodies.items():
            samples, ahead = taken[name]
            if body.lost:
                body.signed, body.lost = None, False
            if not samples or now_us - samples[-1].time_us > LOST_US:
                body.signed = None
                body.keep(ahead)
                continue
            newest = samples[-1]
            if name in moved or body.signed is None or now_us - body.told_us >= REST_PERIOD_US:
                rested = body.signed is not None and _rests(body.signed, samples[0])
                if body.signed is not None and rested and samples[0].time_us > self._start_us:
                    samples = [body.signed._replace(time_us=self._start_us), *samples]
                tracks[name] = pack(
                    np.array([max(one.time_us - start_us, 0) for one in samples]),
                    np.array([one.position_m for one in samples]),
                    np.array([one.quaternion for one in samples]),
                )
                body.told_us = newest.time_us
                if name in moved or body.signed is None:
                    body.signed, body.signed_in = newest, seq
                else:  # signed again at rest: who misses this statement understands the later ones
                    resting[name] = body.signed_in
            else:
                resting[name] = body.signed_in
                if now_us - newest.time_us > SEEN_US:
                    unseen_us[name] = now_us - newest.time_us
            body.keep(ahead)
        fields = MotionFields(start_us, now_us, tracks, resting, unseen_us, tuple(self._stalls_us))
        self._start_us = now_us
        self._stalls_us = []
        return fields


@dataclass(frozen=True)
class Track:
    """What motion capture signed of one body."""

    time_us: Array
    """(n,) int64, strictly increasing; where the body rested there is a pose at either end of the rest"""
    position_m: Array
    """(n, 3)"""
    quaternion: Array
    """(n, 4) w, x, y, z"""
    statement: Array
    """(n,) index of the statement that says so, into what was read"""
    unseen_us: tuple[tuple[int, int], ...]
    """Times after the first pose, up to the last statement, over which nothing is signed."""


def _times(statement: Motion, body: str, offset_us: Array) -> Array:
    """When the poses of `body` were seen. Raises BadStatement."""
    time_us = statement.start_us + offset_us
    if (np.diff(time_us) <= 0).any() or time_us[-1] > statement.end_us:
        raise BadStatement("the times of a track do not fit its statement", seq=statement.seq, body=body)
    return time_us


def track(statements: Sequence[Motion], body: str) -> Track | None:
    """The signed motion of `body` in `statements`, which are in the order of `seq`; None if it is in none.

    A statement may be missing: what rested before and rests after by the same pose rested in between. What
    came to rest in the missing one lies where it is signed next, ever since.
    Raises BadStatement when a track is malformed or its times do not fit its statement.
    """
    times: list[Array] = []
    positions: list[Array] = []
    quaternions: list[Array] = []
    numbers: list[Array] = []
    unseen: list[tuple[int, int]] = []
    known_us = statements[0].start_us if statements else 0
    """Up to when the body's pose is known without a break."""
    signed_in = 0
    """Number of the statement in which the body came to rest."""
    unpacked, lies = _signed(statements, body)
    for index, statement in enumerate(statements):
        number = statement.resting.get(body)
        rests = bool(times) and number == signed_in
        if body in statement.tracks:
            offset_us, position_m, quaternion = unpacked[statement.seq]
            time_us = _times(statement, body, offset_us)
            if not rests:
                unseen += _holes(time_us, position_m)
            if times and signed_in and not rests:
                both_us = np.array([times[-1][-1], time_us[0]])
                unseen += _holes(both_us, np.array([positions[-1][-1], position_m[0]]))
            lost = bool(times) and not rests and time_us[0] - times[-1][-1] > LOST_US
            if lost or (times and not rests and (not signed_in or statement.start_us > known_us)):
                unseen.append((int(times[-1][-1]), int(time_us[0])))
            # It may have come to rest before the first statement that is here.
            signed_in = statement.resting.get(body, statement.seq)
        elif rests:
            # Only as far as it was seen: who waits for a moment without cameras gains nothing.
            time_us = np.array([statement.end_us - statement.unseen_us.get(body, 0)])
            position_m, quaternion = positions[-1][-1:], quaternions[-1][-1:]
        elif times and number in lies:
            time_us, position_m, quaternion = _lying(statement, body, lies[number])
            unseen.append((int(times[-1][-1]), int(time_us[0])))
            signed_in = number
        else:
            if times:
                # A moving body may be lost well before the end of the statement that has its last pose.
                unseen.append((int(times[-1][-1]), statement.end_us))
            known_us = statement.end_us
            signed_in = 0
            continue
        known_us = statement.end_us
        fresh = time_us > (times[-1][-1] if times else -1)
        if fresh.any():
            times.append(time_us[fresh])
            positions.append(position_m[fresh])
            quaternions.append(quaternion[fresh])
            numbers.append(np.full(int(fresh.sum()), index))
    if not times:
        return None
    time_us, position_m, quaternion, index_of = map(np.concatenate, (times, positions, quaternions, numbers))
    return Track(time_us, position_m, quaternion, index_of, _merged(unseen))


def _signed(
    statements: Sequence[Motion], body: str
) -> tuple[dict[int, tuple[Array, Array, Array]], dict[int, tuple[Array, Array, Array]]]:
    """Times, positions and orientations of `body` by the number of the statement that has them, and by the
    number of the one in which it came to rest there."""
    signed = [one for one in statements if body in one.tracks]
    unpacked = dict(
        zip((one.seq for one in signed), unpack_all([one.tracks[body] for one in signed]), strict=True)
    )
    return unpacked, {one.resting[body]: unpacked[one.seq] for one in reversed(signed) if body in one.resting}


def _lying(statement: Motion, body: str, there: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """The same of a body that lies through a statement, as far as it was seen, where it came to rest."""
    seen_us = statement.end_us - statement.unseen_us.get(body, 0)
    time_us = np.unique([min(statement.start_us, seen_us), seen_us])
    position_m, quaternion = (one[:1].repeat(len(time_us), axis=0) for one in there[1:])
    return time_us, position_m, quaternion


def _holes(time_us: Array, position_m: Array) -> list[tuple[int, int]]:
    """Steps of one track over which a body went somewhere unseen."""
    return [
        (int(time_us[step]), int(time_us[step + 1]))
        for step in np.flatnonzero(np.diff(time_us) > STEP_US)
        if math.dist(position_m[step], position_m[step + 1]) > REST_M
    ]


def _merged(spans: list[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    merged: list[tuple[int, int]] = []
    for start, end in spans:
        if merged and start <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(end, merged[-1][1])
        elif end > start:
            merged.append((start, end))
    return tuple(merged)
