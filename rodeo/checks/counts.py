"""What a proof may hold: counts that every judge finds the same, asked before anything else of a proof.

They bound what a verification costs (`bench.hostile` measures it at the limits), so that a proof which costs
too much is rejected by a number that anybody can count again, and not by the speed of somebody's machine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from rodeo import topics
from rodeo.checks.case import Case
from rodeo.checks.report import Finding, at_most
from rodeo.checks.statements import recorded
from rodeo.evidence.proof import TopicMessages
from rodeo.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL

BURST_S = 60.0
"""What a device may have signed while the recorder was away, and the recorder asked it for later."""


@dataclass(frozen=True)
class Counts:
    """The most of each. The numbers are many times what the longest honest work of each kind holds."""

    messages: int = 600_000
    """All topics together; 45 minutes of a cleaning. Counted while the file is read."""
    recorded_s: float = 24 * 3600.0
    """From the first log time to the last."""
    message_bytes: int = 2 * 1024
    """On average over each ROS topic, pictures apart: the largest honest message has 740. All topics together
    hold at most `Limits.uncompressed_bytes`, counted while the file is read."""
    events: int = 10_000
    """On `rodeo/event`."""
    event_bytes: int = 8 * 1024**2
    """Of all events: they are held as objects, which take many times as much."""
    statements: int = 50_000
    """On `rodeo/attestation`, whoever made them."""
    json_bytes: int = 64 * 1024**2
    """Of both together."""
    statements_per_s: float = 10.0
    """Of one registered signer, over the recording and `BURST_S`: motion capture makes one for each body, the
    others fewer."""
    sightings: int = 1_000
    """Places where the robot says that it saw the item; it looks a few times."""
    carried_s: float = 600.0
    """From the grasp to the item's rest; no plausible carry is longer. Checked before the replay."""
    replayed_s: float = 1_200.0
    """Stepped through physics in all replays together. Counted while they run."""


COUNTS = Counts()


def within_counts(case: Case) -> Finding:
    """The proof holds no more of anything than a proof may."""
    found = list(_counted(case))
    name, value, limit, unit = max(found, key=lambda one: one[1] / one[2])
    return at_most(
        value,
        limit,
        unit,
        source="rodeo.checks.counts",
        detail=f"more {name} than a proof may hold" if value > limit else f"nearest to its limit: {name}",
    )


def _counted(case: Case) -> Iterator[tuple[str, float, float, str]]:
    """(count, value, limit, unit); what costs to count comes after what bounds that cost."""
    proof = case.proof
    recorded_s = (proof.end_ns - proof.start_ns) * 1e-9
    yield "recorded seconds", recorded_s, COUNTS.recorded_s, "s"
    yield (
        "bytes per message",
        max(_average_bytes(proof.topics.values()), default=0.0),
        COUNTS.message_bytes,
        "bytes",
    )
    yield "events", proof.count(EVENT_CHANNEL), COUNTS.events, ""
    yield "bytes of events", _bytes(case, EVENT_CHANNEL), COUNTS.event_bytes, "bytes"
    statements, size = proof.count(ATTESTATION_CHANNEL), _bytes(case, EVENT_CHANNEL, ATTESTATION_CHANNEL)
    yield "statements", statements, COUNTS.statements, ""
    yield "bytes of events and statements", size, COUNTS.json_bytes, "bytes"
    seen = (proof.count("/" + topics.ITEM_POSE.name(ns=robot.namespace)) for robot in case.site.robots)
    yield "sightings", max(seen, default=0), COUNTS.sightings, ""
    if statements <= COUNTS.statements and size <= COUNTS.json_bytes:
        signers = (
            None if case.chain_record is None else {one.address.lower() for one in case.chain_record.devices}
        )
        by = Counter(one.attestation.signer.lower() for one in recorded(proof, signers))
        most = max(by.values(), default=0)
        rate = most / (recorded_s + BURST_S)
        yield "statements per second and signer", rate, COUNTS.statements_per_s, "1/s"


def _average_bytes(columns: Iterable[TopicMessages]) -> Iterator[float]:
    return (
        column.data.size_bytes / len(column)
        for column in columns
        if column.ros_type not in ("", topics.BIN_IMAGE.type)
    )


def _bytes(case: Case, *channels: str) -> int:
    found = (case.proof.topics.get(name) for name in channels)
    return sum(column.data.size_bytes for column in found if column is not None)
