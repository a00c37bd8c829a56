"""Does the recording hold what the other checks need, without holes?"""

import numpy as np

from rodeo.lab.layout import BinLayout
from rodeo.topics import BATTERY_STATE, DOCK_OUTPUT, JOINT_STATES, MOCAP_POSE, ODOM, Topic
from services.oracle.case import Case, CaseError, increasing
from services.oracle.report import Finding, at_least, at_most
from services.oracle.rest import Rest, compartment_of

RATE_SHARE = 0.9
"""Of the nominal rate in the key table: a site's scheduler is not a metronome."""
COVERED_SHARE = 0.9
"""Of the recording; the rest may be missing around a restart of the recorder."""
HOLE_PERIODS = 25
"""A silence of so many nominal periods (0.5 s at 50 Hz) is a hole. One over which nothing moved, the item
already in the bin, misses nothing (`services.oracle.rest`)."""


def _cleaning(case: Case) -> list[tuple[Topic, str]]:
    robot, namespace, item = case.robot.name, case.robot.namespace, case.item.id
    return [
        (ODOM, ODOM.name(ns=namespace)),
        (JOINT_STATES, JOINT_STATES.name(ns=namespace)),
        (MOCAP_POSE, MOCAP_POSE.name(body=robot)),
        (MOCAP_POSE, MOCAP_POSE.name(body=item)),
    ]


def _charging(case: Case) -> list[tuple[Topic, str]]:
    return [
        (DOCK_OUTPUT, DOCK_OUTPUT.name(dock=case.site.dock.name)),
        (BATTERY_STATE, BATTERY_STATE.name(ns=case.robot.namespace)),
    ]


def cleaning_topics(case: Case) -> Finding:
    """Odometry, joints and motion capture at their nominal rates."""
    return _slowest(case, _cleaning(case))


def item_outside_bin(case: Case) -> Finding:
    """There was something to do: the item was not in the bin when the recording began."""
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
    return _least_covered(case, _cleaning(case), *span, Rest(case))


def charging_topics(case: Case) -> Finding:
    """The dock's meter and the battery at their nominal rates."""
    return _slowest(case, _charging(case))


def charging_gaps(case: Case) -> Finding:
    """Few holes in them while current flows."""
    output = case.table(DOCK_OUTPUT, dock=case.site.dock.name)
    flowing = increasing(output)[output["current"] > 0]
    if len(flowing) < 2:
        raise CaseError("the meter never saw a current", topic=output.topic)
    return _least_covered(case, _charging(case), flowing[0], flowing[-1])


def messages_missed(case: Case) -> Finding:
    """Share of the publishers' sequence numbers that are not in the recording, holes at rest not counted."""
    missed, published = 0, 0
    rest = Rest(case)
    for topic, name in _cleaning(case):
        steps = np.diff(np.frombuffer(case.proof.topics["/" + name].sequence, np.uint32).astype(np.int64))
        # A publisher that restarts counts from the beginning again.
        steps = np.where((steps < 1) | _at_rest(_times(case, topic, name), topic, rest), 1, steps)
        published += int(steps.sum()) + 1
        missed += int((steps - 1).sum())
    return at_most(
        missed / published,
        1 - COVERED_SHARE,
        "",
        source="sequence numbers on the bus",
        detail=f"{missed} of {published} messages are missing",
    )


def _times(case: Case, topic: Topic, name: str) -> np.ndarray:
    if case.proof.count("/" + name) < 2:
        raise CaseError("the topic is not in the recording", topic="/" + name)
    return increasing(case.proof.table("/" + name, topic.type))


def _slowest(case: Case, topics: list[tuple[Topic, str]]) -> Finding:
    """Lowest median rate as a share of nominal."""
    share, name = min(
        (1 / (float(np.median(np.diff(_times(case, topic, name)))) * (topic.rate_hz or 1)), name)
        for topic, name in topics
    )
    return at_least(
        share, RATE_SHARE, "", source="nominal rates of the key table", detail=f"slowest: /{name}"
    )


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
