"""Honest recordings: the lab's physics, driven by a scripted operator and filmed.

A `Take` is what happened: messages of the robot, and what motion capture and the bin felt, which is not
signed yet. `seal` lets it happen again: the robot records, the witnesses hear the recording's heads and sign.
Tests change the take before (then the witnesses helped), or what was signed after (`Witnesses.edit`).
"""

from __future__ import annotations

import hashlib
import json
import math
from array import array
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
from eth_account.signers.local import LocalAccount
from rosbags.rosbag2 import StoragePlugin, Writer

from rodeo.evidence.attestation import Attestation
from rodeo.evidence.proof import Proof, TopicMessages
from rodeo.evidence.recorder import SealedProof, _Entry, _SealedFile
from rodeo.evidence.seal import QUIET_SEAL_PERIOD_NS, Binding, SealChain
from rodeo.evidence.writer import McapWriter, message_record
from rodeo.host.stamps import set_stamp, stamp_ns
from rodeo.lab.body import Body, Twist2, joint_names
from rodeo.lab.config import Pose2, gripper_body
from rodeo.lab.geometry import quaternion_of, wrap
from rodeo.lab.world import world_spec
from rodeo.ros2.types import STORE, msg, new, serialize, time_message
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import ATTESTATION_CHANNEL
from rodeo.witness import motion
from rodeo.witness.chain import Inputs, WitnessChain
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import (
    Claimant,
    Classification,
    Drop,
    Head,
    Header,
    MeterRecord,
    Motion,
    Presentation,
    Receipt,
    Removal,
    Scope,
    Watch,
    digest,
)
from rodeo_testing.assignments import BIN, BINDING, METER, MOCAP, ROBOT
from rodeo_testing.operator import Operator

RENDERINGS = Path(__file__).with_name("renderings")
"""Pictures of the lab's items: `paper_1.jpg` and so on."""
START_NS = 1_900_000_000 * 10**9
ODOMETRY, JOINTS_TYPE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
CONTROLLER_FRAMES = 5
POSE, BATTERY = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/BatteryState"
_Header, _PoseStamped = msg("std_msgs/msg/Header"), msg(POSE)
_Point, _Quaternion, _Pose = (msg(f"geometry_msgs/msg/{name}") for name in ("Point", "Quaternion", "Pose"))


@dataclass(frozen=True)
class Sample:
    """One message: `message` is a ROS message object, or a dict on a JSON channel."""

    topic: str
    ros_type: str
    message: Any
    time_ns: int
    sequence: int = 0

    @cached_property
    def cdr(self) -> bytes:
        """The ROS message as it goes over the bus. An edited sample is another one, so what many proofs have
        in common is serialized once."""
        return serialize(self.message)

    @cached_property
    def pose(self) -> motion.Sample:
        """The pose as motion capture signs it, at the time of its stamp."""
        at, turn = self.message.pose.position, self.message.pose.orientation
        return motion.Sample(
            stamped_ns(self.message) // 1000, (at.x, at.y, at.z), (turn.w, turn.x, turn.y, turn.z)
        )


@dataclass(frozen=True, eq=False)
class Take:
    """Everything that was on the bus while one task was done, in order."""

    samples: list[Sample] = field(default_factory=list, repr=False)

    def of(self, topic: str) -> list[Sample]:
        return [sample for sample in self.samples if sample.topic == topic]

    def without(self, topic: str) -> Take:
        return Take([sample for sample in self.samples if sample.topic != topic])

    def edited(self, topic: str, edit: Callable[[Sample], Sample | None]) -> Take:
        """`topic`'s samples as `edit` returns them; None drops one."""
        changed = (edit(sample) if sample.topic == topic else sample for sample in self.samples)
        return Take([sample for sample in changed if sample is not None])

    def standing(self, seconds: float) -> Take:
        """Seconds for which the last frames are repeated at its end."""
        period_ns, every = 20_000_000, CONTROLLER_FRAMES
        last_ns = self.samples[-1].time_ns
        loop = [
            s for s in self.samples[-50 * every :] if s.time_ns > last_ns - every * period_ns and s.ros_type
        ]
        step_ns, steps = every * period_ns, math.ceil(seconds / (every * period_ns * 1e-9))
        samples = list(self.samples)
        for step in range(1, steps + 1):
            for sample in loop:
                frames = step * (1 if sample.ros_type == CONTROLLER_STATE else every)
                again = shifted_by(sample, step * step_ns)
                samples.append(replace(again, sequence=sample.sequence + frames))
        return Take(samples)

    @property
    def start_s(self) -> float:
        return self.samples[0].time_ns * 1e-9

    @property
    def end_s(self) -> float:
        return self.samples[-1].time_ns * 1e-9


class TakeClock:
    """Tells the time of the sample that is being written."""

    def __init__(self, now_ns: int) -> None:
        self.time_ns = now_ns

    def now_ns(self) -> int:
        return self.time_ns

    def now_s(self) -> float:
        return self.time_ns * 1e-9

    def wait_until(self, time_s: float, stop: object = None) -> bool:
        raise NotImplementedError("nobody waits while a take is written")


SIGNED: dict[str, type[Header]] = {
    "bin/classification": Classification,
    "bin/drop": Drop,
    "bin/removal": Removal,
    "bin/watch": Watch,
    "robot/presentation": Presentation,
}
"""Topic -> model of what a device signs; such a sample's message is the statement without its header."""
_NOTHING, _TWIN = "0x" + "00" * 32, "0x" + "22" * 32
_KEEP: Callable[[Attestation], Attestation | None] = lambda attestation: attestation  # noqa: E731


METER_RECORD, ROBOT_RECEIPT = "meter/record", "robot/receipt"
"""Topics of what meter and robot sign of a charge: such a sample's message is the statement without its
header."""
CHARGE_SIGNED: dict[str, type[Header]] = {METER_RECORD: MeterRecord, ROBOT_RECEIPT: Receipt}
REGISTER_WH = 12_345.0
"""Register of a meter that delivered before."""


@dataclass(frozen=True)
class Sides:
    """The signers of what happened while a charge is recorded.

    `fields` may change what one of them signs: it gets the model and the fields, and returns them or None.
    `keep` is what the recorder makes of each statement.
    """

    meter: LocalAccount = METER
    robot: LocalAccount = ROBOT
    meter_name: str = "dock1"
    robot_name: str = "panther1"
    inputs: Inputs = "closed_bus"
    recording: str | None = None
    """Digest of the recording that they were about, if another than this one."""
    hears: bool = True
    """Whether the robot hears the recording's heads."""
    fields: Callable[[type[Header], dict[str, Any]], dict[str, Any] | None] = lambda _model, fields: fields
    keep: Callable[[Attestation], Attestation | None] = lambda attestation: attestation


@dataclass(frozen=True)
class Witnesses:
    """The signers of what was felt while a take is recorded."""

    mocap: LocalAccount = MOCAP
    bin: LocalAccount = BIN
    robot: LocalAccount = ROBOT
    """Presents itself to the bin."""
    mocap_inputs: Inputs = "sensor"
    bin_inputs: Inputs = "sensor"
    scope: Scope | None = None
    """If another than that of the recording."""
    hears: Callable[[float], bool] = lambda time_s: True
    """Whether the witnesses hear the recorder at this time."""
    edit: Callable[[Attestation], Attestation | None] = _KEEP
    """An edit of each statement that is recorded; None leaves it out."""
    asked_for: Sequence[Attestation] = field(default=(), hash=False)
    """Statements from the witnesses' journals, asked for before it ends; `edit` may add to them."""
    recording: str | None = None
    """Digest of the recording whose heads the witnesses heard, if another than this one."""
    forks: Callable[[float], bool] = lambda time_s: False
    """Whether what they hear at this time are heads of another version of it."""
    twin: Callable[[float], bool] = lambda time_s: False
    """Whether witnesses also hear a head of a second recording of the same device at this time."""
    twin_ends: int | None = None
    """The last seal of the second recording, if it ends before the first."""
    mocap_clock_s: float = 0.0
    """By how much the clock of the motion capture is ahead."""
    mocap_says: Callable[[dict[str, Any]], dict[str, Any]] = lambda fields: fields
    """An edit of the fields of a statement before motion capture signs them."""
    lay: tuple[str, int] = ("", 0)
    """A body, and for how many statements of the motion capture it had been at rest before."""
    mocap_off_s: tuple[float, float] = (math.inf, math.inf)
    """Between which times the process of the motion capture did not run."""
    mocap_stalls_s: tuple[tuple[float, float], ...] = ()
    """The interval in which it reports that its simulated lab stood still."""
    mocap_forgets: bool = False
    """Whether it lost its journal by that, so that its chain begins anew."""
    ago_s: float = 0.0
    """By how much the witnesses' times are earlier than those of the recording: it is of then."""
    charge: Sides = field(default_factory=Sides)
    """Meter and robot of a charge."""


class _Memory:
    """A journal that nobody asks, with this number of earlier statements."""

    def __init__(self, seq: int) -> None:
        self.seq = seq
        self.previous: str | None = _NOTHING if seq else None

    def add(self, attestation: Attestation) -> None:
        self.seq, self.previous = self.seq + 1, digest(attestation)


class _Scene:
    """The witnesses of one take."""

    def __init__(self, take: Take, binding: Binding, witnesses: Witnesses, site_bin: str) -> None:
        self._binding, self._witnesses = binding, witnesses
        scope = witnesses.scope or Scope(
            chain_id=binding.chain_id,
            task_manager=binding.task_manager,
            organization=binding.organization,
        )
        # A device continues its count from film to film: later films have higher numbers.
        self.before = before = max(0, take.samples[0].time_ns - START_NS) // 10**8 + witnesses.lay[1]
        self._chains = {
            role: WitnessChain(name, account, scope, inputs, cast(Journal, _Memory(before)), HeadBook())
            for role, name, account, inputs in (
                ("mocap", "mocap", witnesses.mocap, witnesses.mocap_inputs),
                ("bin", site_bin, witnesses.bin, witnesses.bin_inputs),
                ("robot", binding.device, witnesses.robot, "sensor"),
            )
        }
        names = {sample.topic for sample in take.samples}
        self.bodies = {
            name: found["body"] for name in names if (found := topics.MOCAP_POSE.parts(name)) is not None
        }
        """By the topic of its poses."""
        seen = set(self.bodies.values())
        self._mocap_ns = round((witnesses.mocap_clock_s - witnesses.ago_s) * 1e9)
        start_us = (take.samples[0].time_ns + self._mocap_ns) // 1000 - 20_000
        self._motion = motion.MotionLog(sorted(seen), start_us) if seen else None
        self._seen, self._runs = sorted(seen), True
        self._is_off_once = math.isfinite(witnesses.mocap_off_s[0])
        self._stalls_s = list(witnesses.mocap_stalls_s)
        self._claimants: tuple[Claimant, ...] = ()
        self.recording = _NOTHING
        self.charge: tuple[WitnessChain, ...] = ()
        """Chains of those that hear the heads of a charge's recording."""

    def hear_seal(self, data: bytes, address: str) -> None:
        """The recorder publishes its newest head."""
        seal = json.loads(data)["payload"]
        own = "0x" + hashlib.sha256(data).hexdigest()
        if seal["recording"] is None:
            self.recording = own
        time_s = int(seal["time_ns"]) * 1e-9
        head = Head(
            device=seal["device"],
            address=address,
            chain=self._witnesses.recording or self.recording,
            index=seal["index"],
            digest=own if not self._witnesses.forks(time_s) else _NOTHING,
        )
        heads = [head]
        if self._witnesses.twin(time_s):
            last = head.index if self._witnesses.twin_ends is None else self._witnesses.twin_ends
            twin = {"chain": _TWIN, "digest": _NOTHING, "index": min(head.index, last)}
            heads.append(head.model_copy(update=twin))
        for chain in (self._chains["mocap"], self._chains["bin"], *self.charge):
            off = chain is self._chains["mocap"] and self._off(time_s)
            if self._witnesses.hears(time_s) and not off:
                for one in heads:
                    chain.heads.hear(one)

    def _off(self, time_s: float) -> bool:
        """Whether motion capture does not run then."""
        start_s, end_s = self._witnesses.mocap_off_s
        return start_s <= time_s < end_s

    def _begin_again(self, time_us: int) -> None:
        """The process of the motion capture is started again."""
        old = self._chains["mocap"]
        journal = _Memory(0) if self._witnesses.mocap_forgets else old._journal
        account, scope, inputs = self._witnesses.mocap, old.scope, self._witnesses.mocap_inputs
        self._chains["mocap"] = WitnessChain(
            old.device, account, scope, inputs, cast(Journal, journal), HeadBook()
        )
        self._motion = motion.MotionLog(self._seen, time_us)

    def see(self, sample: Sample, body: str) -> None:
        runs = not (self._is_off_once and self._off(sample.time_ns * 1e-9))
        if runs and not self._runs:
            self._begin_again((sample.time_ns + self._mocap_ns) // 1000)
        self._runs = runs
        if self._motion is not None and runs:
            pose = sample.pose
            if self._mocap_ns:
                pose = pose._replace(time_us=(stamped_ns(sample.message) + self._mocap_ns) // 1000)
            while self._stalls_s and pose.time_us * 1e-6 > self._stalls_s[0][1]:
                from_s, to_s = self._stalls_s.pop(0)
                self._motion.stall(round(from_s * 1e6), round(to_s * 1e6))
            self._motion.add(body, pose)

    def tick(self, time_ns: int, last: bool = False) -> Attestation | None:
        """The statement of the motion capture that is due."""
        chain, log = self._chains["mocap"], self._motion
        time_ns += self._mocap_ns
        if log is None or not self._runs or not (last or log.due(time_ns // 1000, bool(chain.heads))):
            return None
        signed = chain.sign_next(
            Motion, time_ns * 1e-9, lambda seq: self._says(log.take(time_ns // 1000, seq)._asdict(), seq)
        )
        return self._distribute(chain, signed)

    def _says(self, fields: dict[str, Any], seq: int) -> dict[str, Any]:
        body, statements = self._witnesses.lay
        first = self.before + 1
        if fields["resting"].get(body) == first or (seq == first and body in fields["tracks"]):
            fields["resting"] = fields["resting"] | {body: first - statements}
        return self._witnesses.mocap_says(fields)

    def sign(self, sample: Sample) -> Attestation | None:
        """A device's statement about what it felt."""
        model, ago_s = SIGNED[sample.topic], self._witnesses.ago_s
        fields = {name: one - ago_s if name in TIMES else one for name, one in sample.message.items()}
        counted = {name: fields[name] for name in ("number", "classification") if fields.get(name)}
        fields |= {name: number + self.before for name, number in counted.items()}
        time_s = fields.pop("time_s", sample.time_ns * 1e-9 - ago_s)
        chain = self._chains[sample.topic.partition("/")[0]]
        if model is Presentation:
            fields = {
                "recording": self.recording,
                "task_id": self._binding.task_id,
                "attempt": self._binding.attempt,
            } | fields
            claimant = {name: fields[name] for name in ("recording", "task_id", "attempt")}
            newest = Claimant(device=chain.device, address=chain.address, **claimant)
            self._claimants = (newest, *(one for one in self._claimants if one != newest))
        elif model in (Classification, Drop):
            fields = {"claimants": self._claimants} | fields
            if model is Drop and fields.get("classification"):  # what was not shown is nobody's
                self._claimants = ()
        return self._distribute(chain, chain.sign(model, time_s, **fields))

    def _distribute(self, chain: WitnessChain, attestation: Attestation) -> Attestation | None:
        head = Head(
            device=chain.device,
            address=chain.address,
            chain=None,
            index=attestation.payload["seq"],
            digest=digest(attestation),
        )
        for other in self._chains.values():
            if other is not chain:
                other.heads.hear(head)
        return self._witnesses.edit(attestation)


class _ChargeScene:
    """Meter and robot of one recorded charge, with the number of statements that each signed before."""

    def __init__(self, sides: Sides, binding: Binding, before: int) -> None:
        self._sides, self._binding = sides, binding
        scope = Scope(
            chain_id=binding.chain_id, task_manager=binding.task_manager, organization=binding.organization
        )
        self._chains: dict[type[Header], WitnessChain] = {
            model: WitnessChain(
                name, account, scope, sides.inputs, cast(Journal, _Memory(before)), HeadBook()
            )
            for model, name, account in (
                (MeterRecord, sides.meter_name, sides.meter),
                (Receipt, sides.robot_name, sides.robot),
            )
        }
        self._record: Attestation | None = None
        self.listeners = (self._chains[Receipt],) if sides.hears else ()
        """Chains that hear the heads of the recording."""

    def sign(self, sample: Sample, recording: str) -> Attestation | None:
        """The recorded statement, if it is recorded."""
        model, binding = CHARGE_SIGNED[sample.topic], self._binding
        fields: dict[str, Any] = {
            "task_id": binding.task_id,
            "attempt": binding.attempt,
            "recording": self._sides.recording or recording,
            "time_s": sample.time_ns * 1e-9,
        }
        if model is Receipt:
            if self._record is None:
                return None
            record = self._record.payload
            fields |= {name: record[name] for name in ("task_id", "attempt", "recording", *_COUNTED)} | {
                "meter": record["device"],
                "meter_address": self._record.signer,
                "record": digest(self._record),
            }
        changed = self._sides.fields(model, fields | sample.message)
        if changed is None:
            return None
        chain = self._chains[model]
        signed = chain.sign(model, **changed)
        if model is MeterRecord:
            self._record = signed
        other = self._chains[Receipt if model is MeterRecord else MeterRecord]
        other.heads.hear(
            Head(
                device=chain.device,
                address=chain.address,
                chain=None,
                index=int(signed.payload["seq"]),
                digest=digest(signed),
            )
        )
        return self._sides.keep(signed)


_COUNTED = ("begin_wh", "register_wh")


def recorded(
    take: Take, binding: Binding, witnesses: Witnesses, address: str, site_bin: str
) -> Generator[Sample, bytes | None, None]:
    """The input of a recorder, in order. It is sent each seal's bytes, the opening one first."""
    scene = _Scene(take, binding, witnesses, site_bin)
    charge = _ChargeScene(witnesses.charge, binding, scene.before)
    scene.charge = charge.listeners

    def out(sample: Sample) -> Generator[Sample, bytes | None, None]:
        data = yield sample
        while data is not None:
            scene.hear_seal(data, address)
            data = yield sample

    def say(attestation: Attestation | None, time_ns: int) -> Generator[Sample, bytes | None, None]:
        if attestation is not None:
            yield from out(Sample(ATTESTATION_CHANNEL, "", attestation.model_dump(), time_ns))

    yield from out(Sample("", "", None, take.samples[0].time_ns))
    now_ns = take.samples[0].time_ns
    bodies = scene.bodies
    for sample in take.samples:
        if sample.time_ns > now_ns:
            yield from say(scene.tick(now_ns), now_ns)
            now_ns = sample.time_ns
        if body := bodies.get(sample.topic):
            scene.see(sample, body)
        elif sample.topic in SIGNED:
            yield from say(scene.sign(sample), sample.time_ns)
        elif sample.topic in CHARGE_SIGNED:
            yield from say(charge.sign(sample, scene.recording), sample.time_ns)
        elif (data := (yield sample)) is not None:
            scene.hear_seal(data, address)
            yield from out(sample)
    yield from say(scene.tick(now_ns, last=True), now_ns)
    for attestation in witnesses.asked_for:
        yield from say(attestation, now_ns)


def seal(
    take: Take,
    path: Path,
    binding: Binding,
    account: LocalAccount,
    witnesses: Witnesses | None = None,
    site_bin: str = "itrash",
) -> SealedProof:
    """Write `take` as the executor's device would have, while `witnesses` sign what they see of it.

    Not through `Recorder`, which writes in a thread of its own: here every head is heard before the next
    message is written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _, file = _record(take, path, binding, account, witnesses or Witnesses(), site_bin)
    with path.open("rb") as written:
        sha256 = "0x" + hashlib.file_digest(written, "sha256").hexdigest()
    return SealedProof(path, sha256, file.running.messages)


def open_sealed(
    take: Take, path: Path, binding: Binding, account: LocalAccount, witnesses: Witnesses | None = None
) -> Proof:
    """The proof that `open_proof` reads from `seal`'s file, but for hash and size. `path` stays empty."""
    columns = _Columns()
    seals, _ = _record(take, path, binding, account, witnesses or Witnesses(), "itrash", columns)
    digests = tuple("0x" + hashlib.sha256(data).hexdigest() for data in seals)
    return Proof(
        path,
        digests[-1],
        0,
        binding,
        account.address,
        len(columns.by_number[0]),
        columns.longest_unsealed_ns,
        digests,
        {column.topic: column for column in columns.by_number},
        columns.order,
    )


class _Columns:
    """Takes messages as `McapWriter` does, and keeps them as `Proof` does."""

    def __init__(self) -> None:
        self.by_number: list[TopicMessages] = []
        """The first is that of the seals."""
        self.order = array("H")
        self.longest_unsealed_ns = 0
        self._schemas = [""]
        self._unsealed_ns: list[int] = []
        """Times at which the messages since the last seal were written."""

    def register_schema(self, name: str, _encoding: str, _data: bytes) -> int:
        self._schemas.append(name)
        return len(self._schemas) - 1

    def register_channel(self, topic: str, _encoding: str, schema_id: int) -> int:
        self.by_number.append(TopicMessages(topic, self._schemas[schema_id]))
        return len(self.by_number)

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> bytes:
        column = self.by_number[channel_id - 1]
        column.log_ns.append(log_ns)
        column.publish_ns.append(publish_ns)
        column.sequence.append(sequence)
        column.data.append(data)
        self.order.append(channel_id - 1)
        if channel_id > 1:
            self._unsealed_ns.append(log_ns)
        elif self._unsealed_ns:
            unsealed_ns = self._unsealed_ns[-1] - self._unsealed_ns[0]
            self.longest_unsealed_ns = max(self.longest_unsealed_ns, unsealed_ns)
            self._unsealed_ns.clear()
        return message_record(channel_id, sequence, log_ns, publish_ns, data)

    def flush(self) -> None:
        """Nothing is written."""

    finish = flush


def _record(
    take: Take,
    path: Path,
    binding: Binding,
    account: LocalAccount,
    witnesses: Witnesses,
    site_bin: str,
    columns: _Columns | None = None,
) -> tuple[list[bytes], _SealedFile]:
    """The seals but for the final one, and the file."""
    seals: list[bytes] = []
    of_charge = METER_RECORD in {sample.topic for sample in take.samples}
    period_ns = QUIET_SEAL_PERIOD_NS if of_charge else None
    file = _SealedFile(path, SealChain(binding, account), seals.append, period_ns)
    if columns is not None:
        file._writer = cast(McapWriter, columns)
    file.open_chain(take.samples[0].time_ns)
    scene = recorded(take, binding, witnesses, account.address, site_bin)
    sequences: Counter[str] = Counter()
    next(scene)
    heard = 0
    try:
        while True:
            while heard < len(seals):
                heard += 1
                scene.send(seals[heard - 1])
            sample = next(scene)
            ns = sample.time_ns
            if sample.ros_type:
                topic = sample.topic if sample.topic.startswith("/") else "/" + sample.topic
                file.add(_Entry(topic, sample.ros_type, sample.sequence & 0xFFFFFFFF, ns, ns, sample.cdr))
            else:
                payload = sample.message.get("payload", {}) if isinstance(sample.message, dict) else {}
                urgent = payload.get("type") != "mocap.motion"
                data = json.dumps(sample.message, separators=(",", ":")).encode()
                file.add(_Entry(sample.topic, "", sequences[sample.topic], ns, ns, data, urgent))
                sequences[sample.topic] += 1
    except StopIteration:
        pass
    file.finish(final=True)
    return seals, file


def stamped_ns(message: Any) -> int:
    """A ROS message's own time."""
    return stamp_ns(message.header.stamp)


def write_bag(
    take: Take,
    path: Path,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    binding: Binding = BINDING,
    witnesses: Witnesses | None = None,
) -> Path:
    """`take` as a ROS 2 bag of another tool: nothing is sealed, JSON goes as text."""
    text = "std_msgs/msg/String"
    store = STORE
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for sample in recorded(take, binding, witnesses or Witnesses(), binding.executor, "itrash"):
            if not sample.topic:
                continue
            topic, kind = "/" + sample.topic, sample.ros_type or text
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            cdr = sample.cdr if sample.ros_type else serialize(new(text, data=json.dumps(sample.message)))
            writer.write(connections[topic], sample.time_ns, cdr)
    return path


def shifted_by(sample: Sample, shift_ns: int) -> Sample:
    """The same message, published and stamped later by this time."""
    stamp = time_message(stamped_ns(sample.message) + shift_ns)
    message = replace(sample.message, header=replace(sample.message.header, stamp=stamp))
    return replace(sample, message=message, time_ns=sample.time_ns + shift_ns)


def stamp(message: Any, time_ns: int) -> Any:
    set_stamp(message, time_ns)
    return message


Reality = Callable[[mujoco.MjSpec], None]
"""Changes what the world is like beside the site file."""


class Camera:
    """Films one robot and its lab at 50 Hz."""

    def __init__(self, site: Site, reality: Reality = lambda _spec: None) -> None:
        self.site = site
        spec = world_spec(site)
        reality(spec)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.robot = site.robots[0]
        self.body = Body(self.model, self.data, self.robot.name, self.robot.limits)
        self.samples: list[Sample] = []
        self._sequence = 0
        self._odom = np.zeros(3)
        name = self.robot.name
        frames = {name: f"{name}/base_link", gripper_body(name): f"{name}/{self.body.arm_model.hand}"}
        frames |= {item.id: item.id for item in site.items}
        self._tracked = [(body, self.model.body(frame).id) for body, frame in frames.items()]

    @property
    def now_ns(self) -> int:
        return START_NS + round(self.data.time * 1e3) * 10**6

    def put_robot(self, pose: Pose2) -> None:
        """Pose of the robot when the film begins."""
        qpos = self.model.joint(f"{self.robot.name}/base").qposadr[0]
        self.data.qpos[qpos : qpos + 2] = pose.x_m, pose.y_m
        self.data.qpos[qpos + 3 : qpos + 7] = quaternion_of(pose.yaw_rad)
        mujoco.mj_forward(self.model, self.data)

    def film(self, arm_rad: np.ndarray, gripper_m: float) -> None:
        """One 50 Hz frame of everything; the controllers want arm and gripper there."""
        ns, body = self.robot.name, self.body
        if self._sequence % CONTROLLER_FRAMES == 0:
            fingers_m = gripper_m * np.array([1.0, -1.0])
            self._control("arm", body.arm_model.joints, arm_rad, body.arm)
            self._control("gripper", body.arm_model.fingers, fingers_m, body.positions[body.finger_columns])
        twist = body.wheel_twist
        self._odom[2] += twist.angular_rad_s * 0.02
        self._odom[:2] += (
            twist.linear_m_s * 0.02 * np.array([math.cos(self._odom[2]), math.sin(self._odom[2])])
        )
        odometry = new(ODOMETRY, child_frame_id=f"{ns}/base_link")
        odometry.header.frame_id = f"{ns}/odom"
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = map(float, self._odom[:2])
        turn = odometry.pose.pose.orientation
        turn.w, turn.x, turn.y, turn.z = quaternion_of(self._odom[2])
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = twist.linear_m_s, twist.angular_rad_s
        self._add(topics.ODOM.name(ns=ns), ODOMETRY, odometry)
        joints = new(
            JOINTS_TYPE,
            name=list(joint_names(body.arm_model)),
            position=np.array(body.positions),
            velocity=np.array(body.velocities),
            effort=np.array(body.efforts),
        )
        self._add(topics.JOINT_STATES.name(ns=ns), JOINTS_TYPE, joints)
        for name, body_id in self._tracked:
            (x, y, z), (w, *turn) = self.data.xpos[body_id].tolist(), self.data.xquat[body_id].tolist()
            pose = _Pose(position=_Point(x, y, z), orientation=_Quaternion(*turn, w))
            header = _Header(stamp=time_message(self.now_ns), frame_id="map")
            self._add(topics.MOCAP_POSE.name(body=name), POSE, _PoseStamped(header=header, pose=pose))
        self._sequence += 1

    def _control(
        self, part: str, joints: tuple[str, ...], reference: np.ndarray, measured: np.ndarray
    ) -> None:
        point = "trajectory_msgs/msg/JointTrajectoryPoint"
        state = new(
            CONTROLLER_STATE,
            joint_names=list(joints),
            reference=new(point, positions=reference.copy()),
            feedback=new(point, positions=measured.copy()),
            error=new(point, positions=reference - measured),
        )
        topic = f"{self.robot.name}/{part}_controller/controller_state"
        number = self._sequence // CONTROLLER_FRAMES
        self.samples.append(Sample(topic, CONTROLLER_STATE, stamp(state, self.now_ns), self.now_ns, number))

    def say(self, topic: str, **fields: Any) -> None:
        """Record what a device is about to sign."""
        self.samples.append(Sample(topic, "", fields, self.now_ns))

    def still(self, seconds: float) -> None:
        """Repeat the last frames for this time: nothing moves, and nothing is computed."""
        self.samples = Take(self.samples).standing(seconds).samples

    def photograph(self, bin_name: str, picture: bytes) -> None:
        """Record a picture as the bin's camera encodes it."""
        image = new("sensor_msgs/msg/CompressedImage", format="jpeg", data=np.frombuffer(picture, np.uint8))
        self._add(topics.BIN_IMAGE.name(bin=bin_name), topics.BIN_IMAGE.type, image)

    def _add(self, topic: str, ros_type: str, message: Any) -> None:
        ns = self.now_ns
        self.samples.append(Sample(topic, ros_type, stamp(message, ns), ns, self._sequence))


SWAY_HZ = 0.25
SWAY_RAMP_S = 2.0
"""Seconds in which the arm begins to sway, and in which it comes to rest again."""


class FilmedOperator(Operator):
    def __init__(self, camera: Camera) -> None:
        super().__init__(camera.model, camera.data, camera.body, camera.robot)
        self.camera = camera
        self._sway_rad = self._most_rad = self._swayed_s = 0.0
        self._swaying = False

    def tick(self) -> None:
        still = self.setpoint
        if self._swaying or self._sway_rad:
            self.setpoint = still + self._sway()
        super().tick()
        self.camera.film(self.setpoint, self.grip[0])
        self.setpoint = still

    def sway(self, most_rad: float) -> None:
        """Let all joints of the arm sway so far about where they are wanted, one after the other."""
        self._swaying, self._most_rad, self._swayed_s = True, most_rad, 0.0

    def sway_no_more(self) -> None:
        """Wait until the arm hangs still."""
        self._swaying = False
        while self._sway_rad:
            self.tick()

    def _sway(self) -> np.ndarray:
        step_rad = self._most_rad * 0.02 / SWAY_RAMP_S
        change_rad = step_rad if self._swaying else -step_rad
        self._sway_rad = float(np.clip(self._sway_rad + change_rad, 0.0, self._most_rad))
        self._swayed_s += 0.02
        joints = len(self.body.arm_model.joints)
        turn = 2 * math.pi * (SWAY_HZ * self._swayed_s + np.arange(joints) / joints)
        return np.asarray(self._sway_rad * np.sin(turn))

    def turn_to(self, yaw_rad: float) -> None:
        """Turn to within 0.02 rad: sticking tyres need half a minute for the rest."""
        while abs(error := wrap(yaw_rad - self.body.pose.yaw_rad)) > 0.02:
            self.body.drive(Twist2(0.0, math.copysign(min(0.8, 0.25 + 2 * abs(error)), error)))
            self.tick()
        self.body.drive(Twist2())
        self.wait(0.3)


def film_drive(
    site: Site, places: Sequence[tuple[Pose2, float]], *, start: Pose2, reality: Reality = lambda _spec: None
) -> Take:
    """A robot that is at `start` drives to each place, with nothing in the way, and stays there for so many
    seconds. The film begins half a second before."""
    camera = Camera(site, reality)
    operator = FilmedOperator(camera)
    camera.put_robot(start)
    operator.wait(0.5)
    for number, (place, stay_s) in enumerate(places, start=1):
        operator.drive_to(place)
        if number == len(places):
            camera.still(stay_s)
        else:
            operator.wait(stay_s)
    return Take(camera.samples)


TIMES = ("after_s", "grasped_s", "settled_s", "shown_s", "time_s")
"""Fields of statements that are site times in seconds."""


def later(take: Take, seconds: int, after_s: float = 0.0, lost: bool = True) -> Take:
    """The same film, shot later by this time.

    Only what is later than `after_s` is moved, if given: then there is a hole of so many seconds, in which
    messages were lost, or none were sent.
    """

    def shifted(sample: Sample) -> Sample:
        if sample.time_ns <= after_s * 1e9:
            return sample
        if sample.ros_type:
            frames = seconds * (10 if sample.ros_type == CONTROLLER_STATE else 50) * lost
            return replace(shifted_by(sample, seconds * 10**9), sequence=sample.sequence + frames)
        times = {key: sample.message[key] + seconds for key in TIMES if key in sample.message}
        return replace(sample, message=sample.message | times, time_ns=sample.time_ns + seconds * 10**9)

    return Take([shifted(sample) for sample in take.samples])


def moved(sample: Sample, **changes: float) -> Sample:
    """A copy of a pose sample with coordinates of its position replaced."""
    position = replace(sample.message.pose.position, **changes)
    return replace(
        sample, message=replace(sample.message, pose=replace(sample.message.pose, position=position))
    )
