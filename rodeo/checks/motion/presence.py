"""Was the robot where its task says, for as long as it says? For work that is done by being somewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rodeo.checks.case import NO_MOCAP, Case, CaseError
from rodeo.checks.motion.poses import motion_of, moving_s, pose_of
from rodeo.checks.motion.witnesses import UNSEEN_S, heads_of, listed_soon
from rodeo.checks.report import Finding, at_least, skipped, undecided
from rodeo.checks.signed.heads import fork
from rodeo.checks.signed.testimony import motion_capture_of

Place = tuple[float, float]
"""x and y in the frame map, m."""


@dataclass(frozen=True)
class Stay:
    """From when to when the robot was near a place, s."""

    from_s: float
    until_s: float


def stays(case: Case, place: Place, near_m: float, least_s: float) -> Finding:
    """How long the middle of the base stays within `near_m` of `place`, at a stretch; at least `least_s`.

    Over a stretch of UNSEEN_S of which nothing is signed, nobody knows where the robot was.
    """
    if not case.mocap:
        return undecided("the site has no motion capture: no witness saw where the robot was", "the site")
    lasts_s = max(
        (moving_s(case, one.from_s, one.until_s) for one in _stays(case, place, near_m)), default=0.0
    )
    return at_least(
        lasts_s,
        least_s,
        "s",
        source="the task's parameters",
        detail=f"longest time within {near_m:g} m of the place, as motion capture signed it",
    )


def listed(case: Case, place: Place, near_m: float, least_s: float) -> Finding:
    """While the robot is at `place`, motion capture lists what is recorded soon after it is recorded."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    if not case.proof.sealed:
        return skipped("a bag has no seals that witnesses could list")
    heads = heads_of(case)
    if (forked := fork(case, motion_of(case))) is not None:
        return forked
    if not heads:
        raise CaseError("no statement of the motion capture lists this recording")
    stay = stay_at(case, place, near_m, least_s)
    return listed_soon(case, heads, stay.from_s, stay.until_s)


def acts(case: Case, place: Place, near_m: float, least_s: float) -> list[str]:
    """The robot's time at `place`, which is paid for once."""
    stay = stay_at(case, place, near_m, least_s)
    from_us, until_us = round(stay.from_s * 1e6), round(stay.until_s * 1e6)
    return [f"mocap/{key}/{case.robot.name}/{from_us}-{until_us}" for key in motion_capture_of(case).keys]


def stay_at(case: Case, place: Place, near_m: float, least_s: float) -> Stay:
    """The first `least_s` of the longest stay near `place`. Raises CaseError where there is none."""
    found = _stays(case, place, near_m)
    if not found:
        raise CaseError("motion capture never saw the robot near the place", place=list(place))
    longest = max(found, key=lambda one: one.until_s - one.from_s)
    return Stay(longest.from_s, min(longest.until_s, longest.from_s + least_s))


def _stays(case: Case, place: Place, near_m: float) -> list[Stay]:
    pose = pose_of(case, case.robot.name)
    near = np.linalg.norm(pose.position_m[:, :2] - np.array(place), axis=1) <= near_m
    found: list[Stay] = []
    begun_s: float | None = None
    last_s = float(pose.time_s[0])
    unseen = [span for span in pose.unseen_s if span[1] - span[0] > UNSEEN_S]
    for time_s, is_near in zip(pose.time_s.tolist(), near.tolist(), strict=True):
        lost = any(start_s < time_s and end_s > last_s for start_s, end_s in unseen)
        if begun_s is not None and (lost or not is_near):
            found.append(Stay(begun_s, last_s))
            begun_s = None
        if is_near and begun_s is None:
            begun_s = time_s
        last_s = time_s
    if begun_s is not None:
        found.append(Stay(begun_s, last_s))
    return found
