"""A forger's tools: honest recordings, a store to submit to, and the executor's own device key."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import file_digest
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Self

import numpy as np
from eth_account import Account
from eth_account.signers.local import LocalAccount
from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from rodeo.bus.messages import DaoEvent, Device, Task
from rodeo.checks.acts import ConsumedActs, Wait, acts_unspent
from rodeo.checks.case import ChainRecord, Checks
from rodeo.checks.report import Report
from rodeo.checks.verify import verify_file, verify_submission
from rodeo.evidence.attestation import Attestation, attest
from rodeo.evidence.seal import Binding
from rodeo.evidence.store import Store
from rodeo.evidence.tally import RESUMED
from rodeo.lab.body import joint_names
from rodeo.lab.world import arm_model
from rodeo.ros2.types import new
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.sections import KindConfig
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.noise import HEAVY, losses, noisy
from rodeo_testing.recordings import SIGNED, Sample, Take, Witnesses, seal, stamp

JOINT_STATES, ODOM, STATED = "panther1/joint_states", "panther1/odom", "rodeo/attestation"
ARM_STATE, GRIPPER_STATE = (f"panther1/{part}_controller/controller_state" for part in ("arm", "gripper"))
ROBOT_POSE, GRIPPER_POSE = "mocap/panther1/pose", "mocap/panther1/gripper/pose"
JOINTS = joint_names(arm_model())
FINGERS = [JOINTS.index(name) for name in arm_model().fingers]
WAIST = 0
WIDE = np.array([0.057, -0.057])
"""Fingers wide open, m."""
STRANGER = Account.create()
MODERATE = HEAVY.times(1 / 3)


Edit = Callable[[Attestation], Attestation | None]
Registered = Callable[[Device], Device]
"""An edit of each device of the registry."""


class McapMessage(NamedTuple):
    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True)
class Submission:
    """The chain's record of a proof. Without a URI, the file at `path` is put into the store first."""

    chain_record: ChainRecord
    path: Path | None = None
    site: Site | None = None
    """The site that it claims to be from, if not the workshop's."""
    uri: str | None = None
    sha256: str | None = None
    spent: tuple[str, ...] = ()
    """Acts that an earlier task's accepted verdict paid for."""


class Workshop(ABC):
    """Filmed once; every forgery gets files of its own in `folder`. A kind declares the film and its
    task."""

    kind: str
    """Kind of its task; the site is one that uses it."""
    binding: Binding = BINDING
    device: LocalAccount = ROBOT
    """The key that seals an honest proof."""

    def __init__(self, site: Site, folder: Path) -> None:
        # Not simulated: a simulated clock, faster than real time, needs wider limits.
        clock = site.clock.model_copy(update={"source": "wall"})
        kinds = site.kinds
        if self.kind not in [one.name for one in kinds]:
            kinds = [*kinds, KindConfig(name=self.kind)]
        self.site = site.model_copy(update={"data_dir": folder / "data", "clock": clock, "kinds": kinds})
        self.store = Store(self.site)
        self.folder = folder
        self._numbers = count()
        self._losses: Callable[[], Witnesses] | None = None
        self._noisy: dict[int, Self] = {}

    @abstractmethod
    def film(self) -> Take:
        """Honest work."""

    @abstractmethod
    def chain_record(self, **task: Any) -> ChainRecord:
        """The chain's record of the task; `task` replaces fields of it."""

    @cached_property
    def take(self) -> Take:
        """The honest work that forgeries are made of."""
        return self.film()

    def under_noise(self, seed: int) -> Self:
        """This workshop at a moderately noisy site, drawn by this seed, where every recording is made."""
        if seed not in self._noisy:
            shop = copy(self)
            shop.take, seen = noisy(self.take, MODERATE, np.random.default_rng(seed))
            clock_s = seen.mocap_clock_s
            # The same for every recording of this workshop.
            shop._losses = lambda: losses(MODERATE, np.random.default_rng(seed), clock_s)
            self._noisy[seed] = shop
        return self._noisy[seed]

    # -- submitting ------------------------------------------------------------------------------------

    def sealed(
        self,
        take: Take,
        binding: Binding | None = None,
        device: LocalAccount | None = None,
        witnesses: Witnesses | None = None,
    ) -> Path:
        witnesses = witnesses or Witnesses()
        if self._losses is not None:
            witnesses = lossy(witnesses, self._losses())
        path = self.new_path().with_suffix(".mcap")
        return seal(take, path, binding or self.binding, device or self.device, witnesses).path

    def submitted(
        self,
        take: Take,
        *,
        binding: Binding | None = None,
        device: LocalAccount | None = None,
        witnesses: Witnesses | None = None,
        devices: Registered = lambda device: device,
        **task: Any,
    ) -> Submission:
        """`take` as proof of the task, sealed with the executor's key. What witnesses sign is what the take
        holds: whatever a forger changes there, they helped. `devices` may change the registry."""
        chain_record = with_devices(self.chain_record(**task), devices)
        return Submission(chain_record, self.sealed(take, binding, device, witnesses))

    def restated(self, take: Take, edit: Edit, **task: Any) -> Submission:
        """`take` with the witnesses' signed statements as `edit` returns them."""
        return self.submitted(take, witnesses=Witnesses(edit=edit), **task)

    def judged(
        self, submission: Submission, checks_of: Callable[[Checks], Checks] = lambda checks: checks
    ) -> Report:
        """The report of an oracle that fetches the proof by its URI; with `checks_of` it uses other
        checks."""
        uri, sha256 = submission.uri, submission.sha256
        if submission.path is not None:
            with submission.path.open("rb") as file:
                sha256 = sha256 or "0x" + file_digest(file, "sha256").hexdigest()
            uri = uri or self.deposit(submission.path)
        chain_record = submission.chain_record
        task = chain_record.task.model_copy(update={"proof_uri": uri, "proof_sha256": sha256})
        site = submission.site or self.site
        with TemporaryDirectory(dir=self.folder) as folder:
            record = chain_record.model_copy(update={"task": task})
            report = verify_submission(site, record, Path(folder), checks_of=checks_of)
        if not (report.accepted and submission.spent):
            return report
        found = _paid_before(submission.spent, task).spent(task.id, task.attempt, report.acts)
        assert not isinstance(found, Wait)
        return report.with_checks(acts_unspent(report.acts, found))

    def deposit(self, path: Path) -> str:
        """Put a file into the store's folder, past the store's own limits; its URI."""
        with path.open("rb") as file:
            digest = file_digest(file, "sha256").hexdigest()
        target = self.site.data_dir / "store" / f"{digest}.mcap"
        target.parent.mkdir(parents=True, exist_ok=True)
        path.replace(target)
        return f"{self.site.store_url}/{digest}.mcap"

    def empty(self) -> None:
        """Forget what was stored: a thousand proofs are gigabytes."""
        for folder in (self.site.data_dir / "store", self.folder):
            for path in folder.glob("*"):
                if path.is_file():
                    path.unlink()

    # -- files -----------------------------------------------------------------------------------------

    def new_path(self) -> Path:
        """The path of a file or folder that is not there yet, without an ending."""
        return self.folder / str(next(self._numbers))

    def honest_file(self) -> Path:
        return self.sealed(self.take)

    def read(self, path: Path) -> list[McapMessage]:
        """The messages of a recording in file order, seals included."""
        with path.open("rb") as file:
            read = make_reader(file).iter_messages(log_time_order=False)
            return [
                McapMessage(
                    channel.topic, message.log_time, message.publish_time, message.sequence, message.data
                )
                for _, channel, message in read
            ]

    def rewritten(
        self, edit: Callable[[list[McapMessage]], list[McapMessage]], source: Path | None = None
    ) -> Path:
        """A file, the honest one by default, with its messages as `edit` returns them, seals included,
        well-formed."""
        source = source or self.honest_file()
        with source.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        kinds = {channel.topic: channel for channel in summary.channels.values()}
        path = self.new_path().with_suffix(".mcap")
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2", library="rodeo")
            channels: dict[str, int] = {}
            for topic, log_ns, publish_ns, sequence, data in edit(self.read(source)):
                if topic not in channels:
                    schema = summary.schemas.get(kinds[topic].schema_id)
                    number = writer.register_schema(schema.name, "ros2msg", schema.data) if schema else 0
                    channels[topic] = writer.register_channel(topic, kinds[topic].message_encoding, number)
                writer.add_message(channels[topic], log_ns, data, publish_ns, sequence)
            writer.finish()
        return path


def with_devices(chain_record: ChainRecord, change: Registered) -> ChainRecord:
    return chain_record.model_copy(update={"devices": [change(device) for device in chain_record.devices]})


def lossy(witnesses: Witnesses, lost: Witnesses) -> Witnesses:
    """What a forger has the witnesses do; `lost` names the parts that are lost."""

    def edit(one: Attestation) -> Attestation | None:
        kept = witnesses.edit(one)
        return None if kept is None else lost.edit(kept)

    def keep(one: Attestation) -> Attestation | None:
        kept = witnesses.charge.keep(one)
        return None if kept is None else lost.charge.keep(kept)

    return replace(
        witnesses,
        edit=edit,
        asked_for=lost.asked_for,
        hears=lambda time_s: witnesses.hears(time_s) and lost.hears(time_s),
        mocap_clock_s=witnesses.mocap_clock_s + lost.mocap_clock_s,
        charge=replace(witnesses.charge, keep=keep),
    )


def _paid_before(acts: tuple[str, ...], task: Task) -> ConsumedActs:
    """The oracle's record when `task` is submitted and a task before was paid for these acts."""
    known, before, report = ConsumedActs(), task.id + 1, "0x" + "00" * 32
    told: list[tuple[str, int, dict[str, Any]]] = [
        ("TaskRegistered", before, {"kind": task.kind}),
        ("ProofSubmitted", before, {"attempt": 1, "executor": task.executor}),
        ("Reported", before, {"report_uri": "", "reason": ""}),
        ("Ruled", before, {"attempt": 1, "ruling": "accepted", "report": report}),
        ("TaskSettled", before, {}),
        ("TaskRegistered", task.id, {"kind": task.kind}),
        ("ProofSubmitted", task.id, {"attempt": task.attempt, "executor": task.executor}),
    ]
    for seq, (name, task_id, args) in enumerate(told, start=1):
        event = DaoEvent(
            seq=seq, name=name, block=seq, log_index=0, tx_hash="0x", time_s=0.0, task_id=task_id, args=args
        )
        known.on_event(event)
    known.read(report, acts)
    return known


# -- tools ---------------------------------------------------------------------------------------------


def middle_s(take: Take, share: float = 0.5) -> float:
    return take.start_s + share * (take.end_s - take.start_s)


def with_joints(sample: Sample, **columns: Any) -> Sample:
    return replace(sample, message=replace(sample.message, **columns))


def with_fields(sample: Sample, **fields: Any) -> Sample:
    return replace(sample, message=replace(sample.message, **fields))


def opened(sample: Sample) -> Sample:
    """With the fingers wide open."""
    position, effort = sample.message.position.copy(), sample.message.effort.copy()
    position[FINGERS], effort[FINGERS] = WIDE, 0.0
    return with_joints(sample, position=position, effort=effort)


def commanded(sample: Sample, reference: np.ndarray) -> Sample:
    """A controller's state with another reference."""
    return with_fields(sample, reference=replace(sample.message.reference, positions=reference))


def displaced(sample: Sample, x: float = 0.0, y: float = 0.0) -> Sample:
    """A pose or odometry sample, moved."""
    if hasattr(sample.message.pose, "pose"):
        inner = sample.message.pose.pose
        at = replace(inner.position, x=inner.position.x + x, y=inner.position.y + y)
        pose = replace(sample.message.pose, pose=replace(inner, position=at))
    else:
        at = sample.message.pose.position
        pose = replace(sample.message.pose, position=replace(at, x=at.x + x, y=at.y + y))
    return with_fields(sample, pose=pose)


def turned(sample: Sample, yaw_rad: float) -> Sample:
    """A pose sample, turned about the vertical."""
    at = sample.message.pose.orientation
    x, y, z, w = (Rotation.from_euler("z", yaw_rad) * Rotation.from_quat((at.x, at.y, at.z, at.w))).as_quat()
    return with_fields(sample, pose=replace(sample.message.pose, orientation=replace(at, x=x, y=y, z=z, w=w)))


def middle_pose(samples: list[Sample]) -> Any:
    """Position of the pose in the middle."""
    return samples[len(samples) // 2].message.pose.position


def timed(sample: Sample, time_ns: int, *, stamps: bool = True) -> Sample:
    """The same message at another time."""
    if not sample.ros_type or not stamps:
        return replace(sample, time_ns=time_ns)
    header = replace(sample.message.header, stamp=new("builtin_interfaces/msg/Time"))
    return replace(sample, message=stamp(replace(sample.message, header=header), time_ns), time_ns=time_ns)


def edited_between(
    take: Take, topic: str, begin_s: float, end_s: float, edit: Callable[[Sample], Sample | None]
) -> Take:
    """`topic`'s samples of this time as `edit` returns them."""
    return take.edited(topic, lambda s: edit(s) if begin_s < s.time_ns * 1e-9 < end_s else s)


def robots_at_pace(take: Take, factor: float, *, stamps: bool = True) -> Take:
    """The robot's messages played faster, beside the witnesses' at the real pace."""
    robots = at_pace(Take([s for s in take.samples if is_robots(s)]), factor, stamps=stamps)
    others = [s for s in take.samples if not is_robots(s)]
    return Take(sorted([*robots.samples, *others], key=lambda s: s.time_ns))


def waist_turned(sample: Sample, turn_rad: float) -> Sample:
    """Joint states with the waist elsewhere."""
    position = sample.message.position.copy()
    position[WAIST] += turn_rad
    return with_joints(sample, position=position)


def resting(take: Take, topic: str, index: int) -> Take:
    """A body that stays where its pose of this index has it."""
    lies = take.of(topic)[index].message.pose
    return take.edited(topic, lambda s: with_fields(s, pose=lies))


def without_wheels(take: Take, begin_s: float = 0.0) -> Take:
    """Odometry that stays what it was in the beginning, from `begin_s` on."""
    first = take.of(ODOM)[0].message
    still = partial(with_fields, pose=first.pose, twist=first.twist)
    return edited_between(take, ODOM, begin_s, math.inf, still)


def registered(role: str, **changes: Any) -> Registered:
    """A registry where the device of this role is another's, of another name, or revoked."""
    return lambda device: device.model_copy(update=changes) if device.role == role else device


def at_pace(take: Take, factor: float, *, stamps: bool = True) -> Take:
    """Played `factor` times faster."""
    start_ns = take.samples[0].time_ns
    return Take([
        timed(s, start_ns + round((s.time_ns - start_ns) / factor), stamps=stamps) for s in take.samples
    ])  # fmt: skip


def is_robots(sample: Sample) -> bool:
    """Whether the robot sent it, rather than a witness."""
    return sample.topic not in SIGNED and topics.MOCAP_POSE.parts(sample.topic) is None


def told(take: Take, topic: str, **changes: Any) -> Take:
    """The take with other fields in what a device signs on `topic`."""
    return take.edited(topic, lambda s: replace(s, message=s.message | changes))


def cut(take: Take, *shares: float) -> Take:
    """With a note, at these shares of its time, that the recorder continues after a cut."""
    noted = [
        Sample("rodeo/event", "", {"event": RESUMED}, round(middle_s(take, share) * 1e9)) for share in shares
    ]
    return Take(sorted([*take.samples, *noted], key=lambda sample: sample.time_ns))


def restated(take: Take, account: LocalAccount, having: str, **changes: Any) -> Take:
    """Statements whose payload has the key `having`, changed and signed by `account`."""

    def sign(sample: Sample) -> Sample:
        payload = sample.message["payload"]
        if having not in payload:
            return sample
        return replace(sample, message=attest(payload | changes, account).model_dump())

    return take.edited(STATED, sign)


def numbered(take: Take, topic: str) -> Take:
    """With sequence numbers that show no gap."""
    numbers: Iterator[int] = count()
    return take.edited(topic, lambda s: replace(s, sequence=next(numbers)))


def said(take: Take, *more: Sample) -> Take:
    """With messages that somebody else put in."""
    return Take(sorted([*take.samples, *more], key=lambda sample: sample.time_ns))


def stated(take: Take, attestation: Attestation, share: float = 0.5) -> Sample:
    return Sample(STATED, "", attestation.model_dump(), round(middle_s(take, share) * 1e9))


def noted(take: Take, share: float = 0.5, **event: Any) -> Sample:
    return Sample("rodeo/event", "", event, round(middle_s(take, share) * 1e9))


def with_more_devices(chain_record: ChainRecord, *more: Device) -> ChainRecord:
    return chain_record.model_copy(update={"devices": [*chain_record.devices, *more]})


def acts_of(submission: Submission, shop: Workshop) -> list[str]:
    """The acts that the oracle finds it claims; the file stays where it is."""
    assert submission.path is not None
    return verify_file(submission.path, shop.site, submission.chain_record).acts


def claimed_before(submission: Submission, shop: Workshop, kind: str) -> Submission:
    spent = tuple(act for act in acts_of(submission, shop) if act.startswith(kind))
    assert spent
    return replace(submission, spent=spent)


def signed_twice(
    kind: str, number: int, account: LocalAccount, **changes: Any
) -> Callable[[Attestation], Any]:
    """The recorder keeps, in place of what comes after it, a second statement with the same number."""
    extra: list[Attestation] = []
    count = 0

    def edit(one: Attestation) -> Attestation:
        nonlocal count
        if extra:
            return extra.pop()
        if one.payload["type"] == kind:
            count += 1
            if count == number:
                extra.append(attest(one.payload | changes, account))
        return one

    return edit
