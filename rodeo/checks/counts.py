"""What a proof may hold: counts that every judge finds the same, asked before anything else of a proof.

They bound what a verification costs (`bench.hostile` measures it at the limits), so that a proof which costs
too much is rejected by a number that anybody can count again, and not by the speed of somebody's machine.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from rodeo.checks.case import Case, ChainRecord
from rodeo.checks.report import Finding, at_most
from rodeo.checks.results import once_per_case
from rodeo.checks.signed.statements import recorded
from rodeo.evidence.container import Limits
from rodeo.evidence.proof import TopicMessages
from rodeo.evidence.seal import SEAL_PERIOD_NS
from rodeo.kinds import Kind, kinds_of
from rodeo.lab.rates import TALKATIVE, RatesConfig
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.rates import declared_hz
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL

BURST_S = 60.0
"""What a device may have signed while the recorder was away, and the recorder asked it for later."""
SIGNED_HZ = 1e9 / SEAL_PERIOD_NS
"""Seals of a recorder, and statements of motion capture; the other devices sign less."""


@dataclass(frozen=True)
class Counts:
    """The most of each in any proof. `counts_of` is what a task allows, which may be less."""

    messages: int = 600_000
    """All topics together; an hour of a cleaning. Counted while the file is read."""
    uncompressed_bytes: int = 192 * 1024**2
    """Counted while the file is read; 40 minutes of a cleaning. They lie in memory until there is a
    verdict."""
    seals: int = 20_000
    """Counted while the file is read; each seal is parsed and compared."""
    recorded_s: float = 24 * 3600.0
    """From the first log time to the last."""
    message_bytes: int = 2 * 1024
    """On average over each ROS topic, pictures apart: the largest honest message has 740."""
    events: int = 5_000
    """On `rodeo/event`."""
    event_bytes: int = 512 * 1024
    """Most bytes of all events: they are held as objects, which take many times as much."""
    statements: int = 20_000
    """On `rodeo/attestation`, whoever made them."""
    json_bytes: int = 16 * 1024**2
    """Most bytes of both together; an hour of a cleaning."""
    statements_per_s: float = 10.0
    """Rate of one registered signer, over the recording and `BURST_S`: motion capture makes one for each
    body, the others fewer."""
    signer_bytes: int = 2 * 1024**2
    signer_bytes_per_s: float = 2_000.0
    """Most bytes that one registered signer stated, beside motion capture: as objects they take many times as
    much, too. The recorder lets in half of it."""
    sightings: int = 1_000
    """Places where the robot says that it saw the item; it looks a few times."""
    carried_s: float = 600.0
    """From the grasp to the item's rest; no plausible carry is longer. Checked before the replay."""
    replayed_s: float = 1_200.0
    """Stepped through physics in all replays together. Counted while they run."""

    def limits(self, file_bytes: int) -> Limits:
        """The limits that apply while a file of at most `file_bytes` is read."""
        # A chunk ends with a seal, or where it is larger than one MiB.
        chunks = self.seals + self.uncompressed_bytes // 1024**2
        return Limits(
            file_bytes=file_bytes,
            uncompressed_bytes=self.uncompressed_bytes,
            messages=self.messages,
            seals=self.seals,
            chunks=chunks,
        )


COUNTS = Counts()


def counts_of(site: Site, chain_record: ChainRecord | None) -> Counts:
    """What a proof of the task may hold: what a talkative robot records while the assignment lasts, and never
    more than `COUNTS`."""
    kind = None if chain_record is None else kinds_of(site).get(chain_record.task.kind)
    if chain_record is None or kind is None or not kind.checks:
        return COUNTS
    window_s = chain_record.task.execution_window_s + chain_record.task.grace_s + BURST_S
    signed = round(TALKATIVE * SIGNED_HZ * window_s)
    messages = round(TALKATIVE * _rate_hz(kind, site) * window_s) + 2 * signed + COUNTS.events
    return replace(
        COUNTS,
        messages=min(COUNTS.messages, messages),
        uncompressed_bytes=min(COUNTS.uncompressed_bytes, messages * COUNTS.message_bytes),
        seals=min(COUNTS.seals, signed),
        recorded_s=min(COUNTS.recorded_s, window_s),
        statements=min(COUNTS.statements, signed),
    )


def _rate_hz(kind: Kind, site: Site) -> float:
    """Messages per second of all topics that a recording of this kind holds at this site, as declared."""
    robots = [one.rates for one in site.robots] or [RatesConfig()]
    return sum(
        max(declared_hz(rates, one.topic) for rates in robots) * _places(one.topic.key, site)
        for one in kind.recorded
    )


def _places(key: str, site: Site) -> int:
    """For how many bins, compartments or docks of the site there is a topic with this key."""
    if "{compartment}" in key:
        return sum(len(one.compartments) for one in site.bins)
    return len(site.bins) if "{bin}" in key else len(site.docks) if "{dock}" in key else 1


@once_per_case
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
    proof, most = case.proof, counts_of(case.site, case.chain_record)
    recorded_s = (proof.end_ns - proof.start_ns) * 1e-9
    yield "recorded seconds", recorded_s, most.recorded_s, "s"
    yield (
        "bytes per message",
        max(_average_bytes(proof.topics.values()), default=0.0),
        most.message_bytes,
        "bytes",
    )
    yield "events", proof.count(EVENT_CHANNEL), most.events, ""
    yield "bytes of events", _bytes(case, EVENT_CHANNEL), most.event_bytes, "bytes"
    statements, size = proof.count(ATTESTATION_CHANNEL), _bytes(case, EVENT_CHANNEL, ATTESTATION_CHANNEL)
    yield "statements", statements, most.statements, ""
    yield "bytes of events and statements", size, most.json_bytes, "bytes"
    seen = (proof.count("/" + topics.ITEM_POSE.name(ns=robot.namespace)) for robot in case.site.robots)
    yield "sightings", max(seen, default=0), most.sightings, ""
    if statements <= most.statements and size <= most.json_bytes:
        known = () if case.chain_record is None else case.chain_record.devices
        roles = {one.address.lower(): one.role for one in known}
        by = defaultdict[str, list[int]](list)
        for one in recorded(proof, None if case.chain_record is None else roles.keys()):
            by[one.attestation.signer.lower()].append(len(one.data))
        rate = max(map(len, by.values()), default=0) / (recorded_s + BURST_S)
        yield "statements per second and signer", rate, most.statements_per_s, "1/s"
        sizes = (sum(of) for signer, of in by.items() if roles.get(signer) not in (None, "mocap"))
        allowed = most.signer_bytes + most.signer_bytes_per_s * recorded_s
        yield "bytes of one signer's statements", max(sizes, default=0), allowed, "bytes"


def _average_bytes(columns: Iterable[TopicMessages]) -> Iterator[float]:
    return (
        column.data.size_bytes / len(column)
        for column in columns
        if column.ros_type not in ("", topics.BIN_IMAGE.type)
    )


def _bytes(case: Case, *channels: str) -> int:
    found = (case.proof.topics.get(name) for name in channels)
    return sum(column.data.size_bytes for column in found if column is not None)
