"""Does the recording hold what the other checks need, without holes?"""

import math

import numpy as np

from rodeo.dao import CHARGING
from rodeo.evidence.recorder import CLOSED, Tally
from rodeo.lab.layout import BinLayout
from rodeo.topics import (
    ARM_STATE,
    BATTERY_STATE,
    DOCK_OUTPUT,
    GRIPPER_STATE,
    JOINT_STATES,
    MOCAP_POSE,
    ODOM,
    POSE,
    Topic,
)
from services.oracle.case import NO_MOCAP, Case, CaseError, increasing
from services.oracle.report import Finding, at_least, at_most, equal, skipped
from services.oracle.rest import Rest, compartment_of

RATE_SHARE = 0.9
"""Of the nominal rate in the key table: a site's scheduler is not a metronome. What comes faster than it is
published was recorded once and written at another pace."""
COVERED_SHARE = 0.9
"""Of the recording; the rest may be missing around a restart of the recorder."""
HOLE_PERIODS = 25
"""A silence of so many nominal periods (0.5 s at 50 Hz) is a hole. One over which nothing moved, the item
already in the bin, misses nothing (`services.oracle.rest`)."""
_NO_NUMBERS = "a bag does not tell the publishers' sequence numbers"
UNSIGNED_S = 2.5
"""Motion capture signs every second: one statement may be lost."""


def _cleaning(case: Case) -> list[tuple[Topic, str]]:
    namespace = case.robot.namespace
    own = [
        (ODOM, ODOM.name(ns=namespace)),
        (JOINT_STATES, JOINT_STATES.name(ns=namespace)),
        (ARM_STATE, ARM_STATE.name(ns=namespace)),
        (GRIPPER_STATE, GRIPPER_STATE.name(ns=namespace)),
    ]
    if not case.mocap:
        return [*own, (POSE, POSE.name(ns=namespace))]
    return [*own, *((MOCAP_POSE, MOCAP_POSE.name(body=body)) for body in (case.robot.name, case.item.id))]


def _charging(case: Case) -> list[tuple[Topic, str]]:
    return [
        (DOCK_OUTPUT, DOCK_OUTPUT.name(dock=case.site.dock.name)),
        (BATTERY_STATE, BATTERY_STATE.name(ns=case.robot.namespace)),
    ]


def streams(case: Case) -> list[tuple[Topic, str]]:
    """What a recording of this kind of task must hold: topic of the key table, name."""
    return _charging(case) if case.kind == CHARGING else _cleaning(case)


def cleaning_topics(case: Case) -> Finding:
    """Odometry, joints, their controllers and motion capture at their nominal rates."""
    return _rates(case, _cleaning(case))


def item_outside_bin(case: Case) -> Finding:
    """There was something to do: the item was not in the bin when the recording began."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    layout, item = BinLayout(case.site.bin), case.pose(case.item.id)
    found = compartment_of(layout, item, 0)
    return Finding(
        passed=found is None,
        measured=found,
        source="motion capture of the item",
        detail="the item was already in the bin" if found else "where the item lay at first",
    )


def cleaning_gaps(case: Case) -> Finding:
    """Few holes in them, but for those in which everything lay still."""
    span = case.proof.start_ns * 1e-9, case.proof.end_ns * 1e-9
    return _least_covered(case, _cleaning(case), *span, _rest(case))


def charging_topics(case: Case) -> Finding:
    """The dock's meter and the battery at their nominal rates."""
    return _rates(case, _charging(case))


def charging_gaps(case: Case) -> Finding:
    """Few holes in them while current flows."""
    return _least_covered(case, _charging(case), *_flowing(case))


def _flowing(case: Case) -> tuple[float, float]:
    """When current first and last flowed, s."""
    output = case.table(DOCK_OUTPUT, dock=case.site.dock.name)
    flowing = increasing(output)[output["current"] > 0]
    if len(flowing) < 2:
        raise CaseError("the meter never saw a current", topic=output.topic)
    return float(flowing[0]), float(flowing[-1])


def in_order(case: Case) -> Finding:
    """No topic's messages were recorded out of their order in time."""
    backwards = {
        topic: int((np.diff(np.frombuffer(column.log_ns, np.uint64).astype(np.int64)) < 0).sum())
        for topic, column in case.proof.topics.items()
        if column.ros_type
    }
    worst = max(backwards, key=lambda topic: backwards[topic], default="")
    return at_most(
        backwards.get(worst, 0), 0, "", source="log times of the recording", detail=f"steps back in {worst}"
    )


def tallied(case: Case) -> Finding:
    """The recorder's own count of what it saw and what was published, at its end, fits what is there."""
    if not case.proof.sealed:
        return skipped(_NO_NUMBERS)
    counts = next((e.get("topics") for e in reversed(case.events) if e.get("event") == CLOSED), None)
    if not isinstance(counts, dict):
        raise CaseError("the recording does not end with its counts")
    found = {
        topic: Tally.of(column.sequence).counts()
        for topic, column in case.proof.topics.items()
        if column.ros_type
    }
    wrong = [topic for topic in found.keys() | counts.keys() if found.get(topic) != counts.get(topic)]
    return equal(
        len(wrong),
        0,
        source="the recorder's counts",
        detail=f"topics that differ: {', '.join(sorted(wrong))[:200]}",
    )


def cleaning_missed(case: Case) -> Finding:
    """Share of what was published on one topic and not recorded, holes at rest not counted."""
    return _missed(case, _cleaning(case), _rest(case))


def charging_missed(case: Case) -> Finding:
    """Share of what was published on one topic while current flowed, and not recorded."""
    start_s, end_s = _flowing(case)
    return _missed(case, _charging(case), None, start_s, end_s)


def poses_signed(case: Case) -> Finding:
    """The lab's motion capture vouches for the poses of base and item, but for short stretches."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    if not case.proof.sealed:
        return skipped("a bag does not keep the sequence numbers that motion capture signs")
    worst_s, body = max((_longest_unsigned_s(case, body), body) for body in (case.robot.name, case.item.id))
    return at_most(
        worst_s,
        UNSIGNED_S,
        "s",
        source="statements of the motion capture, one per second",
        detail=f"poses of {body} that it did not sign, at a stretch",
    )


def _rest(case: Case) -> Rest | None:
    """Without motion capture nobody knows whether the item lay still in a hole."""
    return Rest(case) if case.mocap else None


def _longest_unsigned_s(case: Case, body: str) -> float:
    """Holes do not count: what was not recorded needs no signature."""
    time_s, signed = case.pose(body).time_s, case.witnessed(body)
    period_s = 1 / (MOCAP_POSE.rate_hz or 1)
    lasted_s = np.minimum(np.append(np.diff(time_s), period_s), HOLE_PERIODS * period_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~signed, [False]])))
    stretches = zip(edges[::2], edges[1::2], strict=True)
    return max((float(lasted_s[first:end].sum()) for first, end in stretches), default=0.0)


def _missed(
    case: Case,
    topics: list[tuple[Topic, str]],
    rest: Rest | None,
    start_s: float = -math.inf,
    end_s: float = math.inf,
) -> Finding:
    if not case.proof.sealed:
        return skipped(_NO_NUMBERS)
    shares = []
    for topic, name in topics:
        steps = np.diff(np.frombuffer(case.proof.topics["/" + name].sequence, np.uint32).astype(np.int64))
        # A publisher that restarts counts from the beginning again.
        steps = np.maximum(steps, 1)
        time_s = _times(case, topic, name)
        if rest is not None:
            steps[_at_rest(time_s, topic, rest)] = 1
        steps = steps[(time_s[:-1] >= start_s) & (time_s[1:] <= end_s)]
        shares.append((float((steps - 1).sum()) / (float(steps.sum()) + 1), name))
    share, name = max(shares)
    return at_most(
        share,
        1 - COVERED_SHARE,
        "",
        source="sequence numbers on the bus",
        detail=f"published and not recorded: /{name}",
    )


def _times(case: Case, topic: Topic, name: str) -> np.ndarray:
    if case.proof.count("/" + name) < 2:
        raise CaseError("the topic is not in the recording", topic="/" + name)
    return increasing(case.proof.table("/" + name, topic.type))


def _rates(case: Case, topics: list[tuple[Topic, str]]) -> Finding:
    """The median rate that is farthest from nominal, as a share of it."""
    shares = [
        (1 / (float(np.median(np.diff(_times(case, topic, name)))) * (topic.rate_hz or 1)), name)
        for topic, name in topics
    ]
    source = "nominal rates of the key table"
    fastest, name = max(shares)
    if fastest > 1 / RATE_SHARE:
        return at_most(fastest, 1 / RATE_SHARE, "", source, f"fastest: /{name}")
    slowest, name = min(shares)
    return at_least(slowest, RATE_SHARE, "", source, f"slowest: /{name}")


def _least_covered(
    case: Case, topics: list[tuple[Topic, str]], start_s: float, end_s: float, rest: Rest | None = None
) -> Finding:
    """Lowest share of the time from `start_s` to `end_s` that is free of holes, those at `rest` excepted."""
    shares = []
    for topic, name in topics:
        times_s = _times(case, topic, name)
        steps_s = np.diff(np.clip(times_s, start_s, end_s))
        missed = _holes(times_s, topic)
        if rest is not None:
            missed &= ~_at_rest(times_s, topic, rest)
        shares.append((float(steps_s[~missed].sum()) / (end_s - start_s), name))
    share, name = min(shares)
    return at_least(
        share, COVERED_SHARE, "", source="the recording's own span", detail=f"least covered: /{name}"
    )


def _holes(times_s: np.ndarray, topic: Topic) -> np.ndarray:
    """(n - 1,) whether the step from each sample to the next is a hole."""
    return np.asarray(np.diff(times_s) > HOLE_PERIODS / (topic.rate_hz or 1))


def _at_rest(times_s: np.ndarray, topic: Topic, rest: Rest) -> np.ndarray:
    """(n - 1,) whether it is a hole in which everything lay still."""
    holes = _holes(times_s, topic)
    for index in np.flatnonzero(holes):
        holes[index] = rest.across(float(times_s[index]), float(times_s[index + 1]))
    return holes
