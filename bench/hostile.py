"""What the worst proofs cost the oracle, as CPU time and memory of the process that verifies them.

`hostile_proof_cpu_share`: CPU time of the worst, in honest verifications of the same run;
`hostile_proof_cpu_s` the same in seconds, of which `oracle.cpu_limit_s` is four times as much;
`hostile_proof_rss_mb` the largest resident memory of any. Each fills what `rodeo.checks.counts` allows, or
one thing that it bounds:

- `layouts`: joints with names in four layouts, as many bytes as a proof may hold;
- `names`, `chunks`, `seals`, `tiny_messages`, `pictures`, `events`, `late_difference`, `summary`: what makes
  a file dear to read;
- `strangers`, `devices_statements`, `odd_fields`, `odd_numbers`, `bodies`, `heads`: statements as many as a
  proof may hold, of keys that nobody registered, in motion capture's name and of the executor's own;
- `swaying`: a robot that sways with the item for about as long as a carry may take;
- `turning`: odometry that turns for as long as a recording may take;
- `swaying_charge`: hours on a dock whose current sways, with as many records and receipts as a proof may
  hold;
- `sightings`: as many as a proof may hold, at a site without motion capture;
- `everything`: the swaying robot, and the rest of every count beside it.

`python -m bench.hostile NAME ...` measures some. Files are not signed message by message: one signature that
is well-formed serves all statements of strangers.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from eth_account import Account
from eth_account.signers.local import LocalAccount
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex, DataEnd, Footer, Header, McapRecord
from mcap.writer import MCAP0_MAGIC
from rich.console import Console

from bench.verifying import cost_of
from rodeo.charging.meter import Meter
from rodeo.charging.metering import Reading
from rodeo.checks.case import ChainRecord
from rodeo.checks.counts import BURST_S, COUNTS, Counts, counts_of
from rodeo.evidence import writer
from rodeo.evidence.attestation import attest
from rodeo.evidence.container import Limits
from rodeo.ros2.types import new
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL
from rodeo.witness.statement import MAX_CLASSES, MAX_HEADS, payload_digest
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning, without_mocap
from rodeo_testing.assignments import BINDING, CHARGE_BINDING, METER, MOCAP, ROBOT
from rodeo_testing.recordings import (
    BATTERY,
    JOINTS_TYPE,
    METER_RECORD,
    ODOMETRY,
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

SWAY_S = 10
"""Length of the end of the carry that is done there and back again."""
SWAYS = int(0.85 * COUNTS.carried_s / SWAY_S / 2)
CHARGE_S = 4 * 3600
STRANGER = Account.create()
DIGEST = "0x" + "ab" * 32
PICTURE_BYTES = 1 << 20
LAYOUT_NAMES = 220
"""Joints without a name, so that a message has nearly as many bytes as it may have on average."""
TURN_EVERY_S = 30
"""Half a turn is the most that lies between two messages."""


Hostile = tuple[Site, ChainRecord, Path]
Make = Callable[[Site, Take, Path], Hostile]


def hostile_proof_costs(makes: Sequence[Make] | None = None) -> dict[str, float]:
    """What each costs, and the worst."""
    makes = makes or HOSTILE
    site = Site.load(SITE)
    film = film_cleaning(site, "item1")
    figures, honest_s, rss_mb = {}, [], 0.0
    for make in (honest, *makes[: len(makes) // 2], honest, *makes[len(makes) // 2 :], honest):
        with tempfile.TemporaryDirectory() as folder:
            at, chain_record, path = make(site, film, Path(folder))
            cpu_s, peak, reason = cost_of(at, chain_record, path)
        Console().print(f"{make.__name__}: {cpu_s:.1f} s, {peak:.0f} MB: {reason}", markup=False)
        rss_mb = max(rss_mb, peak)
        if make is honest:
            honest_s.append(cpu_s)
        else:
            figures[make.__name__] = cpu_s
    honest_s.sort()
    worst_s, one_s = max(figures.values()), honest_s[len(honest_s) // 2]
    return {
        "hostile_proof_cpu_share": worst_s / one_s,
        "hostile_proof_cpu_s": worst_s,
        "hostile_proof_rss_mb": rss_mb,
        "hostile_honest_cpu_s": one_s,
    } | {f"hostile_{name}_cpu_share": cpu_s / one_s for name, cpu_s in figures.items()}


def honest(site: Site, film: Take, folder: Path) -> Hostile:
    """What the others are compared with."""
    return _sealed(site, film, folder, [])


def layouts(site: Site, film: Take, folder: Path) -> Hostile:
    """Instead of the robot's joints: each message is well-formed, and most differ from most others."""
    name = topics.JOINT_STATES.name(ns=site.robots[0].namespace)
    size_bytes = len(_joints(0, film.samples[0].time_ns).cdr)
    count = min(
        (COUNTS.uncompressed_bytes - (32 << 20)) // (size_bytes + 31),
        COUNTS.messages - 2 * len(film.samples),
    )
    start_ns, length_ns = film.samples[0].time_ns, film.samples[-1].time_ns - film.samples[0].time_ns
    four = [_joints(number, start_ns) for number in range(4)]
    joints = []
    for number in range(count):
        time_ns = start_ns + length_ns * number // count
        one = replace(four[number % 4], topic=name, time_ns=time_ns, sequence=number + 1)
        one.__dict__["cdr"] = four[number % 4].cdr  # else each is serialized anew
        joints.append(one)
    rest = [sample for sample in film.samples if sample.topic != name]
    return _sealed(site, Take(sorted([*rest, *joints], key=lambda one: one.time_ns)), folder, [])


def names(site: Site, film: Take, folder: Path) -> Hostile:
    """As many channels as a file may have, whose names differ at their ends."""
    wide = "x" * (Limits().topic_bytes - 3)
    flood = [
        Sample(f"{wide}{number:03d}", "", {}, film.samples[0].time_ns)
        for number in range(Limits().channels - 20)
    ]
    return _sealed(site, film, folder, flood)


def chunks(site: Site, film: Take, folder: Path) -> Hostile:
    """A chunk for each message."""
    with _chunks_of(0):
        return _sealed(site, film, folder, [_tiny(film)] * (COUNTS.seals - 2 * len(film.samples)))


def seals(site: Site, film: Take, folder: Path) -> Hostile:
    """A seal for each message."""
    return _sealed(site, film, folder, [_note(film, {})] * (_allowed(site, film).seals - 200))


def tiny_messages(site: Site, film: Take, folder: Path) -> Hostile:
    return _sealed(site, film, folder, [_tiny(film)] * (COUNTS.messages - 2 * len(film.samples)))


def pictures(site: Site, film: Take, folder: Path) -> Hostile:
    """Pictures of zeros, which compress well."""
    picture = new(topics.BIN_IMAGE.type, format="jpeg", data=np.zeros(PICTURE_BYTES, np.uint8))
    sample = Sample("y", topics.BIN_IMAGE.type, picture, film.samples[0].time_ns)
    return _sealed(site, film, folder, [sample] * (COUNTS.uncompressed_bytes // PICTURE_BYTES - 10))


def events(site: Site, film: Take, folder: Path) -> Hostile:
    """Events that hold empty lists, which take the most memory for their bytes."""
    return _sealed(site, film, folder, [_empty_lists(film)])


def late_difference(site: Site, film: Take, folder: Path) -> Hostile:
    """The last byte of the summary is another."""
    found = chunks(site, film, folder)
    data = bytearray(found[-1].read_bytes())
    data[-9] ^= 1
    found[-1].write_bytes(data)
    return found


def summary(site: Site, film: Take, folder: Path) -> Hostile:
    """No recording of ours, with a long summary and nothing else."""
    site, chain_record, path = honest(site, film, folder)
    index = ChunkIndex(
        chunk_length=1,
        chunk_start_offset=1,
        compression="",
        compressed_size=1,
        message_end_time=1,
        message_index_length=1,
        message_index_offsets={},
        message_start_time=1,
        uncompressed_size=1,
    )
    count = 16 * (1 << 20) // len(_written(index))
    with path.open("wb") as file:
        file.write(MCAP0_MAGIC + _written(Header("ros2", "")) + _written(DataEnd(0)))
        start = file.tell()
        file.write(_written(index) * count)
        file.write(_written(Footer(start, 0, 0)) + MCAP0_MAGIC)
    return site, chain_record, path


def _written(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def strangers(site: Site, film: Take, folder: Path) -> Hostile:
    count = _allowed(site, film).statements - 1_000
    return _sealed(site, film, folder, [_statement(STRANGER, film)] * count)


def devices_statements(site: Site, film: Take, folder: Path) -> Hostile:
    """As many as one registered key may have signed: the robot's own, with signatures that are not its."""
    return _sealed(site, film, folder, [_statement(ROBOT, film, one) for one in range(_most_signed(film))])


def odd_fields(site: Site, film: Take, folder: Path) -> Hostile:
    """Fields that no statement has, each of which is an error of its own."""
    return _sealed(site, film, folder, _own(film, {f"{number}": 1 for number in range(2_600)}))


def odd_numbers(site: Site, film: Take, folder: Path) -> Hostile:
    """Numbers that Python writes otherwise than RFC 8785."""
    return _sealed(site, film, folder, _odd_numbers(film))


def bodies(site: Site, film: Take, folder: Path) -> Hostile:
    """Statements in motion capture's name, each of which says that thousands of bodies rest."""
    return _sealed(site, film, folder, _said_for_motion_capture(film))


def heads(site: Site, film: Take, folder: Path) -> Hostile:
    head = {"device": "d", "address": BINDING.executor, "chain": DIGEST, "index": 1, "digest": DIGEST}
    said = {"type": "robot.presentation", "bin": "itrash", "recording": DIGEST, "task_id": 7, "attempt": 1}
    return _sealed(site, film, folder, _own(film, said | {"heads": [head] * MAX_HEADS}))


def turning(site: Site, film: Take, folder: Path) -> Hostile:
    """After the work, half a turn every half minute."""
    last = film.of(topics.ODOM.name(ns=site.robots[0].namespace))[-1]
    pose, end_ns = last.message.pose.pose, film.samples[-1].time_ns
    count = int((_allowed(site, film).recorded_s - (film.end_s - film.start_s)) / TURN_EVERY_S) - 1
    more = []
    for number in range(1, count):
        half_rad = 0.45 * math.pi * number
        turned = replace(pose.orientation, z=math.sin(half_rad), w=math.cos(half_rad))
        pose_with = replace(last.message.pose, pose=replace(pose, orientation=turned))
        time_ns = end_ns + number * TURN_EVERY_S * 10**9
        header = replace(last.message.header, stamp=new("builtin_interfaces/msg/Time"))
        message = stamp(replace(last.message, pose=pose_with, header=header), time_ns)
        more.append(Sample(last.topic, ODOMETRY, message, time_ns, last.sequence + number))
    take = Take([*film.samples, *more])
    chain_record = cleaning_chain_record(film)
    task = chain_record.task.model_copy(update={"proof_submitted": take.end_s + 3})
    path = seal(take, folder / "proof.mcap", BINDING, ROBOT).path
    return site, chain_record.model_copy(update={"task": task}), path


def swaying(site: Site, film: Take, folder: Path) -> Hostile:
    return _sealed(site, _swaying(film), folder, [])


def everything(site: Site, film: Take, folder: Path) -> Hostile:
    """What none of the others leaves room for."""
    take, most = _swaying(film), _allowed(site, film)
    notes = [_note(film, {})] * (most.seals - 4 * SWAYS * SWAY_S - 2_000)
    floods = [*_odd_numbers(take), *_said_for_motion_capture(take), *notes, _empty_lists(film)]
    left_bytes = most.uncompressed_bytes - (48 << 20) - COUNTS.json_bytes - 1100 * most.seals
    count = most.messages - len(take.samples) - 2 * len(floods)
    numbers = np.zeros((left_bytes // count - 31 - 60) // 8)
    wide = Sample("y", JOINTS_TYPE, new(JOINTS_TYPE, position=numbers), film.samples[0].time_ns)
    return _sealed(site, take, folder, [*floods, *[wide] * count])


def _swaying(film: Take) -> Take:
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
    return _numbered(samples)


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
        if second % 3 != 1:
            record("step" if second else "opening", now_ns + 2, soc)
    record("close", now_ns + 2, soc)
    take = Take(samples)
    path = seal(take, folder / "proof.mcap", CHARGE_BINDING, METER).path
    return site, charging_chain_record(take, {"soc_from": 0.9}, execution_window_s=CHARGE_S), path


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


def sightings(site: Site, film: Take, folder: Path) -> Hostile:
    blind, count = without_mocap(film, "item1"), COUNTS.sightings - 1
    seen = next(sample for sample in blind.samples if sample.topic.endswith("item_pose"))
    lab = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
    return _sealed(lab, blind, folder, [shifted_by(seen, number - count) for number in range(count)])


HOSTILE = (
    layouts,
    names,
    chunks,
    seals,
    tiny_messages,
    pictures,
    events,
    late_difference,
    summary,
    strangers,
    devices_statements,
    odd_fields,
    odd_numbers,
    bodies,
    heads,
    turning,
    swaying,
    swaying_charge,
    sightings,
    everything,
)


def _allowed(site: Site, film: Take) -> Counts:
    return counts_of(site, cleaning_chain_record(film))


def _most_signed(film: Take) -> int:
    return int(COUNTS.statements_per_s * (film.end_s - film.start_s + BURST_S)) - 100


def _odd_numbers(film: Take) -> list[Sample]:
    said = {
        "type": "bin.classification",
        "number": 1,
        "class": "x",
        "probabilities": {str(number): 1e-7 * number for number in range(MAX_CLASSES)},
        "compartment": "blue",
        "full": False,
        "image_sha256": DIGEST,
        "model_sha256": DIGEST,
        "thresholds_sha256": DIGEST,
        "claimants": [],
        "shown_s": 0.0,
    }
    return _own(film, said)


def _own(film: Take, said: dict[str, Any]) -> list[Sample]:
    """A chain of the executor's own robot, of as many of these statements as a proof may hold."""
    previous: str | None = None
    most_bytes = COUNTS.signer_bytes + COUNTS.signer_bytes_per_s * (film.end_s - film.start_s) - 20_000
    found: list[Sample] = []
    size_bytes = 0
    while len(found) < _most_signed(film):
        header = _header(film, BINDING.device) | {"seq": len(found) + 1, "previous": previous}
        signed = attest(header | said, ROBOT)
        size_bytes += len(signed.model_dump_json())
        if size_bytes > most_bytes:
            break
        previous = payload_digest(signed.payload)
        found.append(_note(film, signed.model_dump(), ATTESTATION_CHANNEL))
    return found


def _said_for_motion_capture(film: Take) -> list[Sample]:
    """As many bytes as a proof may hold beside the rest, under a signature that is not of them."""
    one = _statement(MOCAP, film).message
    header = _header(film, "mocap") | {"type": "mocap.motion", "tracks": {}, "start_us": 1, "end_us": 2}
    said = header | {"resting": {f"{number}": 1 for number in range(2_000)}}
    size_bytes = len(json.dumps(one | {"payload": said}))
    count = (COUNTS.json_bytes - COUNTS.event_bytes - (6 << 20)) // size_bytes
    return [
        _note(film, one | {"payload": said | {"seq": seq}}, ATTESTATION_CHANNEL) for seq in range(1, count)
    ]


def _header(film: Take, device: str) -> dict[str, Any]:
    return {
        "chain_id": BINDING.chain_id,
        "task_manager": BINDING.task_manager,
        "organization": BINDING.organization,
        "version": 1,
        "device": device,
        "previous": None,
        "time_s": film.start_s,
        "heads": [],
        "inputs": "sensor",
    }


def _empty_lists(film: Take) -> Sample:
    return _note(film, {"event": [[]] * (COUNTS.event_bytes // 4 - 1_000)}, EVENT_CHANNEL)


def _joints(number: int, time_ns: int) -> Sample:
    named = [str(number % 4), *[""] * (LAYOUT_NAMES - 1)]
    return Sample("", JOINTS_TYPE, stamp(new(JOINTS_TYPE, name=named), time_ns), time_ns)


def _note(film: Take, message: dict[str, Any], topic: str = "x") -> Sample:
    return Sample(topic, "", message, film.samples[0].time_ns)


@contextmanager
def _chunks_of(size_bytes: int) -> Iterator[None]:
    """The recorder closes chunks that are larger."""
    before = writer._CHUNK_BYTES
    writer._CHUNK_BYTES = size_bytes
    try:
        yield
    finally:
        writer._CHUNK_BYTES = before


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


if __name__ == "__main__":
    print(hostile_proof_costs([make for make in HOSTILE if make.__name__ in sys.argv[1:]]))
