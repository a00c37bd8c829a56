"""What the worst proofs cost the oracle: CPU time of the process that verifies them.

`hostile_proof_cpu_s` is the most of these; `oracle.cpu_limit_s` is a fuse at four times as much.

- statements: 0.7 million with well-formed signatures of keys that nobody registered, and as many as a proof
  may hold of the same, and of a registered key;
- motion: a robot that sways with the item for about as long as a carry may take;
- tiny messages: as many as a proof may hold, and millions;
- sightings: 10,000, and as many as a proof may hold, at a site without motion capture.

Files are not signed message by message: one signature that is well-formed serves all statements.
"""

from __future__ import annotations

import json
import multiprocessing
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

from eth_account import Account
from eth_account.signers.local import LocalAccount
from rich.console import Console

from rodeo.config import Site
from rodeo.evidence import attest
from rodeo.evidence.recorder import ATTESTATION_CHANNEL, _Entry, _SealedFile
from rodeo.evidence.seal import SealChain
from rodeo.ros2.types import new, serialize
from services.oracle.case import Ledger
from services.oracle.counts import COUNTS
from services.oracle.verify import verify_file
from tests.support.assignments import BIN, BINDING, MOCAP, ROBOT, cleaning_ledger
from tests.support.recordings import Sample, Take, film_cleaning, seal, signed_poses, stamp, without_mocap

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"

STRANGERS = 700_000
MILLIONS = 2_000_000
SIGHTINGS = 10_000
SWAY_S = 10
"""Of the carry's end, which is done there and back again."""
SWAYS = int(0.9 * COUNTS.carried_s / SWAY_S)
STRANGER = Account.create()


def hostile_proof_cpu_s() -> dict[str, float]:
    """CPU time of each, s, and the worst."""
    site = Site.load(SITE)
    film = film_cleaning(site, "item1", BIN)
    figures = {}
    for make in (
        strangers,
        strangers_within_counts,
        a_devices_statements,
        swaying,
        millions_of_messages,
        tiny_messages,
        many_sightings,
        sightings_within_counts,
    ):
        with tempfile.TemporaryDirectory() as folder:
            at, ledger, path = make(site, film, Path(folder))
            cpu_s, reason = _cost(at, ledger, path)
        Console().print(f"{make.__name__}: {cpu_s:.1f} s: {reason}", markup=False)
        figures[f"hostile_{make.__name__}_cpu_s"] = cpu_s
    return {"hostile_proof_cpu_s": max(figures.values())} | figures


Hostile = tuple[Site, Ledger, Path]


def strangers(site: Site, film: Take, folder: Path) -> Hostile:
    return site, cleaning_ledger(film), _flooded(film, folder, _statements(STRANGER, STRANGERS))


def strangers_within_counts(site: Site, film: Take, folder: Path) -> Hostile:
    count = COUNTS.statements - 1_000
    return site, cleaning_ledger(film), _flooded(film, folder, _statements(STRANGER, count))


def a_devices_statements(site: Site, film: Take, folder: Path) -> Hostile:
    """As many as one registered key may have signed: the robot's own."""
    count = int(COUNTS.statements_per_s * (film.end_s - film.start_s + 50))
    return site, cleaning_ledger(film), _flooded(film, folder, _statements(ROBOT, count))


def millions_of_messages(site: Site, film: Take, folder: Path) -> Hostile:
    return site, cleaning_ledger(film), _flooded(film, folder, _tiny(MILLIONS))


def tiny_messages(site: Site, film: Take, folder: Path) -> Hostile:
    count = COUNTS.messages - 2 * len(film.samples)
    return site, cleaning_ledger(film), _flooded(film, folder, _tiny(count))


def many_sightings(site: Site, film: Take, folder: Path) -> Hostile:
    return _sighted(site, film, folder, SIGHTINGS)


def sightings_within_counts(site: Site, film: Take, folder: Path) -> Hostile:
    return _sighted(site, film, folder, COUNTS.sightings - 1)


def swaying(site: Site, film: Take, folder: Path) -> Hostile:
    """What was filmed while the item was carried, there and back again."""
    cut_ns = film.of("rodeo/attestation")[0].time_ns - 10**9  # before the item is shown
    there = [s for s in film.samples if s.ros_type and cut_ns - SWAY_S * 10**9 < s.time_ns <= cut_ns]
    cut_ns = there[-1].time_ns
    length_ns = there[-1].time_ns - there[0].time_ns
    samples = [s for s in film.samples if s.time_ns <= cut_ns]
    for turn in range(1, SWAYS + 1):
        for sample in reversed(there) if turn % 2 else there:
            since_ns = cut_ns - sample.time_ns if turn % 2 else sample.time_ns - there[0].time_ns
            if since_ns > 0:  # the turn before ended with it
                samples.append(_at(sample, cut_ns + (turn - 1) * length_ns + since_ns + 1))
    rest_ns = SWAYS * length_ns + 1
    samples += [_at(s, s.time_ns + rest_ns) for s in film.samples if s.time_ns > cut_ns]
    take = _numbered(samples)
    return (
        site,
        cleaning_ledger(take),
        seal(signed_poses(take, MOCAP), folder / "p.mcap", BINDING, ROBOT).path,
    )


def _at(sample: Sample, time_ns: int) -> Sample:
    if not sample.ros_type:  # what the bin says of its classification and of the drop
        later_s, payload = (time_ns - sample.time_ns) * 1e-9, sample.message["payload"]
        times = {key: payload[key] + later_s for key in ("after_s", "time_s") if key in payload}
        return replace(sample, message=attest(payload | times, BIN).model_dump(), time_ns=time_ns)
    header = replace(sample.message.header, stamp=new("builtin_interfaces/msg/Time"))
    return replace(sample, message=stamp(replace(sample.message, header=header), time_ns), time_ns=time_ns)


def _numbered(samples: list[Sample]) -> Take:
    """With sequence numbers without gaps."""
    counts: dict[str, int] = {}
    numbered = []
    for sample in samples:
        counts[sample.topic] = counts.get(sample.topic, 0) + 1
        numbered.append(replace(sample, sequence=counts[sample.topic]))
    return Take(numbered)


def _sighted(site: Site, film: Take, folder: Path, count: int) -> Hostile:
    blind = without_mocap(film, "item1")
    seen = next(sample for sample in blind.samples if sample.topic.endswith("item_pose"))
    more = [replace(seen, sequence=number) for number in range(count)]
    lab = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
    take = Take([*blind.samples[:1], *more, *blind.samples[1:]])
    return lab, cleaning_ledger(film), seal(take, folder / "p.mcap", BINDING, ROBOT).path


def _statements(account: LocalAccount, count: int) -> Iterator[tuple[str, bytes]]:
    signed = attest({"type": "mocap.motion", "number": 0, "time_s": 1.0}, account).model_dump()
    before, after = json.dumps(signed).split('"number": 0')
    for number in range(count):
        yield ATTESTATION_CHANNEL, f'{before}"number": {number}{after}'.encode()


def _tiny(count: int) -> Iterator[tuple[str, bytes]]:
    for _ in range(count):
        yield "/x", b"\x00\x01\x00\x00\x01\x00\x00\x00\x00"


def _flooded(film: Take, folder: Path, more: Iterator[tuple[str, bytes]]) -> Path:
    """The film, and these messages while it began, sealed by the executor's device."""

    path = folder / "p.mcap"
    file = _SealedFile(path, SealChain(BINDING, ROBOT), None)
    file.open_chain(film.samples[0].time_ns)
    first_ns = film.samples[0].time_ns
    for number, (topic, data) in enumerate(more):
        kind = "std_msgs/msg/String" if topic.startswith("/") else ""
        file.add(_Entry(topic, kind, number, first_ns, first_ns, data))
    for sample in signed_poses(film, MOCAP).samples:
        topic = "/" + sample.topic if sample.ros_type else sample.topic
        data = serialize(sample.message) if sample.ros_type else json.dumps(sample.message).encode()
        file.add(_Entry(topic, sample.ros_type, sample.sequence, sample.time_ns, sample.time_ns, data))
    file.finish(final=True)
    return path


def _cost(site: Site, ledger: Ledger, path: Path) -> tuple[float, str]:
    """CPU time of a fresh process that verifies, s, and the verdict's reason."""
    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("spawn").Process(target=_measure, args=(site, ledger, path, sender))
    child.start()
    cost: tuple[float, str] = receiver.recv()
    child.join()
    return cost


def _measure(site: Site, ledger: Ledger, path: Path, sender: Connection) -> None:
    started_s = time.process_time()
    report = verify_file(path, site, ledger)
    sender.send((time.process_time() - started_s, report.reason))


if __name__ == "__main__":
    print(hostile_proof_cpu_s())
