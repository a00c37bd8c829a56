"""What the worst proofs cost the oracle: CPU time of the process that verifies them.

`hostile_proof_cpu_s` is the most of these; `oracle.cpu_limit_s` is a fuse at four times as much.

- statements: 0.7 million with well-formed signatures of keys that nobody registered, and as many as a proof
  may hold of the same, and of a registered key;
- motion: a robot that sways with the item for about as long as a carry may take;
- charge: hours on a dock whose current sways, with a record and a receipt every other second;
- tiny messages: as many as a proof may hold, and millions;
- sightings: 10,000, and as many as a proof may hold, at a site without motion capture.

Files are not signed message by message: one signature that is well-formed serves all statements.
"""

from __future__ import annotations

import math
import multiprocessing
import tempfile
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

from eth_account import Account
from eth_account.signers.local import LocalAccount
from rich.console import Console

from rodeo import topics
from rodeo.checks.case import ChainRecord
from rodeo.checks.counts import BURST_S, COUNTS
from rodeo.checks.verify import verify_file
from rodeo.config import Site
from rodeo.evidence.attestation import attest
from rodeo.meter import Meter
from rodeo.metering import Reading
from rodeo.ros2.types import new
from rodeo.topics import ATTESTATION_CHANNEL
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning, without_mocap
from rodeo_testing.assignments import BINDING, CHARGE_BINDING, METER, ROBOT
from rodeo_testing.recordings import (
    BATTERY,
    METER_RECORD,
    REGISTER_WH,
    ROBOT_RECEIPT,
    START_NS,
    TIMES,
    Sample,
    Take,
    seal,
    shifted_by,
    stamp,
)

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"

STRANGERS = 700_000
MANY = 1_000_000
SIGHTINGS = 10_000
SWAY_S = 10
"""Of the carry's end, which is done there and back again."""
SWAYS = int(0.85 * COUNTS.carried_s / SWAY_S / 2)
CHARGE_S = 4 * 3600
RECORD_S = 2
"""Between two records of a charge, a tenth of what an honest meter takes."""
STRANGER = Account.create()


def hostile_proof_cpu_s() -> dict[str, float]:
    """CPU time of each, s, and the worst."""
    site = Site.load(SITE)
    film = film_cleaning(site, "item1")
    figures = {}
    for make in (
        strangers,
        strangers_within_counts,
        a_devices_statements,
        swaying,
        swaying_charge,
        millions_of_messages,
        tiny_messages,
        many_sightings,
        sightings_within_counts,
    ):
        with tempfile.TemporaryDirectory() as folder:
            at, chain_record, path = make(site, film, Path(folder))
            cpu_s, reason = _cost(at, chain_record, path)
        Console().print(f"{make.__name__}: {cpu_s:.1f} s: {reason}", markup=False)
        figures[f"hostile_{make.__name__}_cpu_s"] = cpu_s
    return {"hostile_proof_cpu_s": max(figures.values())} | figures


Hostile = tuple[Site, ChainRecord, Path]


def strangers(site: Site, film: Take, folder: Path) -> Hostile:
    return _sealed(site, film, folder, [_statement(STRANGER, film)] * STRANGERS)


def strangers_within_counts(site: Site, film: Take, folder: Path) -> Hostile:
    return _sealed(site, film, folder, [_statement(STRANGER, film)] * (COUNTS.statements - 1_000))


def a_devices_statements(site: Site, film: Take, folder: Path) -> Hostile:
    """As many as one registered key may have signed: the robot's own, with signatures that are not its."""
    count = int(COUNTS.statements_per_s * (film.end_s - film.start_s + BURST_S)) - 100
    return _sealed(site, film, folder, [_statement(ROBOT, film, number) for number in range(count)])


def millions_of_messages(site: Site, film: Take, folder: Path) -> Hostile:
    return _sealed(site, film, folder, [_tiny(film)] * MANY)


def tiny_messages(site: Site, film: Take, folder: Path) -> Hostile:
    return _sealed(site, film, folder, [_tiny(film)] * (COUNTS.messages - 2 * len(film.samples)))


def many_sightings(site: Site, film: Take, folder: Path) -> Hostile:
    return _sighted(site, film, folder, SIGHTINGS)


def sightings_within_counts(site: Site, film: Take, folder: Path) -> Hostile:
    return _sighted(site, film, folder, COUNTS.sightings - 1)


def swaying(site: Site, film: Take, folder: Path) -> Hostile:
    """What was filmed before the item was shown to the bin, there and back again."""
    shown_ns = film.of("bin/classification")[0].time_ns - 2 * 10**9
    there = [s for s in film.samples if s.ros_type and shown_ns - SWAY_S * 10**9 < s.time_ns <= shown_ns]
    first_ns, cut_ns = there[0].time_ns, there[-1].time_ns
    length_ns = cut_ns - first_ns
    samples = [sample for sample in film.samples if sample.time_ns <= cut_ns]
    for turn in range(2 * SWAYS):
        for sample in there if turn % 2 else reversed(there):
            since_ns = sample.time_ns - first_ns if turn % 2 else cut_ns - sample.time_ns
            if since_ns > 0:  # the turn before ended with it
                samples.append(_at(sample, cut_ns + turn * length_ns + since_ns))
    rest = (sample for sample in film.samples if sample.time_ns > cut_ns)
    samples += [_at(sample, sample.time_ns + 2 * SWAYS * length_ns) for sample in rest]
    return _sealed(site, _numbered(samples), folder, [])


def swaying_charge(site: Site, _film: Take, folder: Path) -> Hostile:
    """Hours on the dock, with a record and a receipt every other second; both sides agree on all of them."""
    dock, robot, meter = site.docks[0], site.robots[0], Meter(REGISTER_WH)
    samples: list[Sample] = []

    def record(reason: str, now_ns: int, soc: float) -> None:
        fields = meter.record() | {"reason": reason, "contactor": "closed", "soc": soc, "robot": robot.name}
        samples.append(Sample(METER_RECORD, "", fields, now_ns))
        samples.append(Sample(ROBOT_RECEIPT, "", {"soc": soc, "reason": reason}, now_ns))

    for second in range(CHARGE_S):
        now_ns = START_NS + second * 10**9
        soc = 0.9 + 0.04 * math.sin(second / 3600)
        current_a = dock.current_a * (0.5 + 0.5 * math.sin(second / 7)) if second else 0.0
        battery = new(BATTERY, voltage=dock.voltage_v, current=current_a, present=True, percentage=soc)
        for number, topic in enumerate(
            (topics.DOCK_OUTPUT.name(dock=dock.name), topics.BATTERY_STATE.name(ns=robot.name))
        ):
            message = replace(
                battery, header=replace(battery.header, stamp=new("builtin_interfaces/msg/Time"))
            )
            samples.append(Sample(topic, BATTERY, stamp(message, now_ns + number), now_ns + number, second))
        meter.reading(Reading(now_ns * 1e-9, dock.voltage_v, current_a))
        if second % RECORD_S == 0:
            record("step" if second else "opening", now_ns + 2, soc)
    record("close", now_ns + 2, soc)
    take = Take(samples)
    path = seal(take, folder / "proof.mcap", CHARGE_BINDING, METER).path
    return site, charging_chain_record(take, {"soc_from": 0.9}), path


def _at(sample: Sample, time_ns: int) -> Sample:
    """The same, said at another time."""
    if sample.ros_type:
        return shifted_by(sample, time_ns - sample.time_ns)
    later_s = (time_ns - sample.time_ns) * 1e-9
    times = {key: sample.message[key] + later_s for key in TIMES if key in sample.message}
    return replace(sample, message=sample.message | times, time_ns=time_ns)


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
    lab = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
    return _sealed(lab, blind, folder, [shifted_by(seen, number - count) for number in range(count)])


def _statement(account: LocalAccount, film: Take, number: int = 0) -> Sample:
    """Its signature is well-formed, but of the statement with number 0."""
    signed = attest({"type": "mocap.motion", "seq": 0}, account).model_dump()
    payload = {"type": "mocap.motion", "seq": number}
    return Sample(ATTESTATION_CHANNEL, "", signed | {"payload": payload}, film.samples[0].time_ns)


def _tiny(film: Take) -> Sample:
    return Sample("x", "std_msgs/msg/Empty", new("std_msgs/msg/Empty"), film.samples[0].time_ns)


def _sealed(site: Site, film: Take, folder: Path, flood: list[Sample]) -> Hostile:
    """The film with this at its beginning, sealed by the executor's device."""
    take = Take([film.samples[0], *flood, *film.samples[1:]])
    return site, cleaning_chain_record(film), seal(take, folder / "proof.mcap", BINDING, ROBOT).path


def _cost(site: Site, chain_record: ChainRecord, path: Path) -> tuple[float, str]:
    """CPU time of a fresh process that verifies, s, and the verdict's reason."""
    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("spawn").Process(
        target=_measure, args=(site, chain_record, path, sender)
    )
    child.start()
    cost: tuple[float, str] = receiver.recv()
    child.join()
    return cost


def _measure(site: Site, chain_record: ChainRecord, path: Path, sender: Connection) -> None:
    started_s = time.process_time()
    report = verify_file(path, site, chain_record)
    sender.send((time.process_time() - started_s, report.reason))


if __name__ == "__main__":
    print(hostile_proof_cpu_s())
