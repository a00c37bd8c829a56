"""Does the recording hold what the other checks need, without holes?"""

import math
from collections.abc import Iterator

import numpy as np

from rodeo.checks.case import Case, CaseError
from rodeo.checks.motion.poses import moved_s
from rodeo.checks.report import Finding, at_least, at_most, equal, skipped
from rodeo.checks.tables import events_of, increasing, named_tables
from rodeo.evidence.series import Table
from rodeo.evidence.tally import CLOSED, Tally
from rodeo.lab.rates import RATE_SHARE
from rodeo.site.topics import ARM_STATE, GRIPPER_STATE, Topic
from rodeo.text.foreign_text import quoted

COVERED_SHARE = 0.85
"""Share of the recording; the rest may be missing around a restart of the recorder."""
MISSED_SHARE = 0.18
"""Share of the messages on one topic that may be missing. Where 5 % are lost one by one and 2 % in runs,
it is 7 % on average, and a few long runs make it 15 % of half a minute at 50 Hz."""
COMMANDS_SHARE = 0.5
"""Share of the controllers' states that may be in holes, or missing: at 10 Hz one run of a hundred lost
messages, five times the mean, is a third of half a minute."""
HOLE_PERIODS = 25
"""A silence of this many nominal periods (0.5 s at 50 Hz) is a hole."""
_NO_NUMBERS = "a bag does not hold the publishers' sequence numbers"


def in_order(case: Case) -> Finding:
    """No topic's messages were recorded out of their order in time."""
    backwards = {
        topic: int((np.diff(np.frombuffer(column.log_ns, np.uint64).astype(np.int64)) < 0).sum())
        for topic, column in case.proof.topics.items()
        if column.ros_type
    }
    worst = max(backwards, key=lambda topic: backwards[topic], default="")
    return at_most(
        backwards.get(worst, 0),
        0,
        "",
        source="log times of the recording",
        detail=f"steps back in {quoted(worst)}",
    )


def tallied(case: Case) -> Finding:
    """The recorder's own count of what it saw and what was published, at its end, fits what is there."""
    if not case.proof.sealed:
        return skipped(_NO_NUMBERS)
    counts = next((e.get("topics") for e in reversed(events_of(case)) if e.get("event") == CLOSED), None)
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
        detail=f"topics that differ: {', '.join(map(quoted, sorted(wrong)))}",
    )


def missed(
    case: Case,
    topics: list[tuple[Topic, str]],
    start_s: float = -math.inf,
    end_s: float = math.inf,
) -> Finding:
    if not case.proof.sealed:
        return skipped(_NO_NUMBERS)
    shares = []
    for topic, name, table in _tables(case, topics):
        numbers = np.frombuffer(case.proof.topics["/" + name].sequence, np.uint32)[table.kept]
        # A publisher that restarts counts from the beginning again.
        steps = np.maximum(np.diff(numbers.astype(np.int64)), 1)
        time_s = increasing(table)
        steps = steps[(time_s[:-1] >= start_s) & (time_s[1:] <= end_s)]
        missed = float((steps - 1).sum()) / (float(steps.sum()) + 1)
        limit = COMMANDS_SHARE if _of_commands(topic) else MISSED_SHARE
        shares.append((missed - limit, missed, limit, name))
    _, share, limit, name = max(shares)
    return at_most(
        share,
        limit,
        "",
        source="sequence numbers on the bus",
        detail=f"published but not recorded: /{name}",
    )


def _tables(case: Case, topics: list[tuple[Topic, str]]) -> Iterator[tuple[Topic, str, Table]]:
    """Each topic with its messages that count as evidence, one table for each publisher."""
    for topic, name in topics:
        if case.proof.count("/" + name) < 2:
            raise CaseError("the topic is not in the recording", topic="/" + name)
        yield from ((topic, name, table) for table in named_tables(case, topic, name))


def rates(case: Case, topics: list[tuple[Topic, str]]) -> Finding:
    """The median rate that is lowest, as a share of the least. How much more often a robot speaks is its own
    affair: whether its work was played faster than it was done, the witnesses' times tell."""
    shares = [
        (1 / (float(np.median(np.diff(increasing(table)))) * (topic.rate_hz or 1)), name)
        for topic, name, table in _tables(case, topics)
    ]
    slowest, name = min(shares)
    return at_least(slowest, RATE_SHARE, "", "least rates of the key table", f"slowest: /{name}")


def least_covered(case: Case, topics: list[tuple[Topic, str]], start_s: float, end_s: float) -> Finding:
    """Lowest share of the time from `start_s` to `end_s` that is free of holes. Where the lab stood still
    there was nothing to record."""
    shares = []
    start_s, end_s = moved_s(case, np.array([start_s, end_s])).tolist()
    for topic, name, table in _tables(case, topics):
        times_s = moved_s(case, increasing(table))
        steps_s = np.diff(np.clip(times_s, start_s, end_s))
        missed = holes(times_s, topic)
        share = float(steps_s[~missed].sum()) / (end_s - start_s)
        least = 1 - COMMANDS_SHARE if _of_commands(topic) else COVERED_SHARE
        shares.append((share - least, share, least, name))
    _, share, limit, name = min(shares)
    return at_least(share, limit, "", source="the recording's own span", detail=f"lowest coverage: /{name}")


def _of_commands(topic: Topic) -> bool:
    return topic in (ARM_STATE, GRIPPER_STATE)


def holes(times_s: np.ndarray, topic: Topic) -> np.ndarray:
    """(n - 1,) whether the step from each sample to the next is a hole."""
    return np.asarray(np.diff(times_s) > HOLE_PERIODS / (topic.rate_hz or 1))
