"""Everything that the checks of one proof may look at."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from rodeo import topics
from rodeo.charging import ChargingParams
from rodeo.cleaning import CleaningParams
from rodeo.config import Site
from rodeo.dao import CHARGING, CLEANING
from rodeo.errors import wrong_fields
from rodeo.evidence import Attestation, EvidenceError, Proof, verify_attestation
from rodeo.evidence.errors import BadAttestation, BadStatement, LayoutChanged
from rodeo.evidence.recorder import ATTESTATION_CHANNEL
from rodeo.evidence.series import Array, Table
from rodeo.lab.config import ItemConfig, RobotConfig
from rodeo.messages import Device, Root, Task
from rodeo.witness import Motion, Statement, payload_digest
from rodeo.witness.motion import STEP_US, track
from services.oracle.keys import counts_until_s, taken
from services.oracle.statements import Said, Testimony, joined, recorded, testimonies

if TYPE_CHECKING:
    from services.oracle.charge import Charge
    from services.oracle.kinematics import Kinematics
    from services.oracle.phases import Phases
    from services.oracle.replay import Replay, Vote

MOTION_CAPTURE = "mocap"
"""Name of a site's motion capture."""


Params = TypeVar("Params", CleaningParams, ChargingParams)


class Ledger(BaseModel):
    """What the chain says about a submitted proof."""

    chain_id: int
    task_manager: str
    organization: str
    task: Task
    devices: list[Device]
    roots: list[Root] = []
    """Of the days of the assignment."""

    def signers(self, role: str | None) -> set[str]:
        """Lower-case addresses that may sign as `role` (None: as anything) now."""
        return {d.address.lower() for d in self.devices if role in (None, d.role) and d.revoked is None}


THE_MOTION_CAPTURE = "the site's motion capture"
THE_CREATOR = "the task's creator"
"""As those who failed."""
NO_MOCAP = "not applicable: the site has no motion capture"


class CaseError(EvidenceError):
    """The recording does not say what a check needs to know."""


class OthersFailed(EvidenceError):
    """A witness signed nonsense, or the task's creator posted it: not the executor's failure, so a check that
    meets it is undecided."""

    def __init__(self, message: str, fault: str, **details: Any) -> None:
        """`fault` names who failed."""
        super().__init__(message, **details)
        self.fault = fault


@dataclass(frozen=True)
class Pose:
    """A body's motion in frame `map`; where it rests there is a pose at either end of the rest."""

    time_s: Array
    """(n,) strictly increasing"""
    position_m: Array
    """(n, 3)"""
    quaternion: Array
    """(n, 4) w, x, y, z, signs continuous"""
    unseen_s: tuple[tuple[float, float], ...] = ()
    """Over which nothing is signed, after the first pose."""
    statement: Array | None = None
    """(n,) which statement says it, into `Case.motion`"""

    @property
    def yaw_rad(self) -> Array:
        """(n,) heading, unwrapped."""
        w, x, y, z = self.quaternion.T
        return np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


@dataclass(frozen=True)
class Payload:
    """What another device signed, and when it was recorded."""

    payload: dict[str, Any]
    log_s: float


LATE_WALL_S = 5.0
"""What a busy recorder or bridge may be late, of wall time: more of site time where the clock is faster."""
CLOCKS_S = 0.3
"""What motion capture's clock may be off the robot's: disciplined clocks of one site stay within 0.2 s."""
_TURN_S = 0.2
_TURN_RAD = 0.02
"""In `_TURN_S`, to tell when the base turned: ten times what motion capture repeats to."""
_TURNS = 20
FASTEST = 50.0
"""How many times faster than real time a simulated clock without a set speed goes."""


class Case:
    """A proof, the site, and what the chain says (None when asked away from the chain)."""

    def __init__(self, proof: Proof, site: Site, ledger: Ledger | None) -> None:
        self.proof = proof
        self.site = site
        self.ledger = ledger
        self.amount_iec: Decimal | None = None
        """What an accepted proof is paid, for a check to say; None is the task's full price."""
        self.acts: list[str] = []
        """What the proof claims to have done, for checks to say (`services.oracle.acts`)."""
        self._genuine: dict[int, bool] = {}
        self._poses: dict[str, Pose] = {}
        self._tracks: dict[str, Pose] = {}
        self._parts: dict[tuple[str, str], list[tuple[Device, Testimony]]] = {}
        self._tables: dict[str, Table] = {}

    @cached_property
    def kind(self) -> str:
        """The task's kind; without a chain, what the recording looks like."""
        if self.ledger is not None:
            return self.ledger.task.kind
        if any(event.get("event") == "statement" for event in self.proof.events()):
            return "statement"
        moved = any(
            self.proof.count("/" + topics.JOINT_STATES.name(ns=r.namespace)) for r in self.site.robots
        )
        return CLEANING if moved else CHARGING

    @cached_property
    def robot(self) -> RobotConfig:
        """The robot that the chain names: the executor, or the one to be charged. Without a chain, or when it
        names none of this site, the one that the recording is of. Raises CaseError."""
        task = self.ledger.task if self.ledger else None
        named = (task.params.get("robot") if task.kind == CHARGING else task.executor_name) if task else None
        for robot in self.site.robots:
            if robot.name == named:
                return robot
        for robot in self.site.robots:
            if any(topic.startswith(f"/{robot.namespace}/") for topic in self.proof.topics):
                return robot
        raise CaseError(
            "no robot of this site is in the recording", robots=[r.name for r in self.site.robots]
        )

    @cached_property
    def item(self) -> ItemConfig:
        """The item that the task names; without a chain, the one that moved farthest. Raises CaseError."""
        items = {item.id: item for item in self.site.items}
        if self.ledger is not None:
            item_id = self.ordered(CleaningParams).item_id
            if item_id not in items:
                raise CaseError("the site has no such item", item_id=item_id)
            return items[item_id]
        if not self.mocap:
            taken = [e.get("item") for e in self.events if e.get("event") == "releasing"]
            if not taken or taken[-1] not in items:
                raise CaseError("the recording does not say which item of this site it is about")
            return items[taken[-1]]
        seen = {body for motion in self._motions for body in motion.tracks}
        tracked = [i for i in items if i in seen]
        if not tracked:
            raise CaseError("motion capture signed no item of this site", items=list(items))
        return items[max(tracked, key=lambda i: float(np.ptp(self.pose(i).position_m, axis=0).max()))]

    def ordered(self, model: type[Params]) -> Params:
        """The task's parameters, which its creator may have filled with anything.

        Raises OthersFailed when they order nothing that could be done. Only for a case with a ledger.
        """
        assert self.ledger is not None
        try:
            return model.model_validate(self.ledger.task.params)
        except ValidationError as error:
            wrong = ", ".join(f"{field}: {why}" for field, why in wrong_fields(error).items())
            raise OthersFailed(f"the task cannot be done as it is posted: {wrong}", THE_CREATOR) from error

    @property
    def speed(self) -> float:
        """How many times faster than the wall's time the site's goes."""
        clock = self.site.clock
        if clock.source == "wall":
            return 1.0
        return max((clock.idle_speed if self.kind == CHARGING else clock.speed) or FASTEST, 1.0)

    @property
    def slack_s(self) -> float:
        """What a time may be off another clock's, s of site time."""
        return LATE_WALL_S * self.speed

    def table(self, topic: topics.Topic, **names: str) -> Table:
        """The messages of a topic of the key table that are evidence: recorded about when they were stamped,
        and later than the one before. Raises LayoutChanged, CaseError."""
        return self.named_table(topic, topic.name(**names))

    def named_table(self, topic: topics.Topic, name: str) -> Table:
        """The same by its name on the bus."""
        name = "/" + name
        if name not in self._tables:
            table = self.proof.table(name, topic.type)
            stamp_s = table.stamp_s
            table = table.only(np.abs(stamp_s - table.log_ns * 1e-9) <= self.slack_s)
            stamp_s = table.stamp_s
            newest_s = np.maximum.accumulate(stamp_s) if len(stamp_s) else stamp_s
            table = table.only(stamp_s > np.concatenate([[-np.inf], newest_s[:-1]]))
            if not len(table):
                raise CaseError("nothing was recorded when it was stamped", topic=name)
            self._tables[name] = table
        return self._tables[name]

    @cached_property
    def joints(self) -> Table:
        return self.table(topics.JOINT_STATES, ns=self.robot.namespace)

    @cached_property
    def gaps(self) -> tuple[Array, Array]:
        """(n,) stamps of the joints and (n,) half the gap between the fingers, m."""
        # Imported here: the oracle's own process has no use for MuJoCo.
        from rodeo.lab.world import FINGER_JOINTS

        fingers_m = self.joints.named("position", list(FINGER_JOINTS))
        return increasing(self.joints), (fingers_m[:, 0] - fingers_m[:, 1]) / 2

    @property
    def mocap(self) -> bool:
        """Whether the site has motion capture."""
        return self.site.lab.mocap

    @property
    def base_source(self) -> str:
        """Who says where the base is."""
        return "motion capture" if self.mocap else "the robot's own localisation"

    @property
    def item_pose_source(self) -> Literal["motion capture", "perception"]:
        """Who says where the item lay: the lab, or the robot itself, which is weaker."""
        return "motion capture" if self.mocap else "perception"

    def pose(self, body: str) -> Pose:
        """A body's motion as motion capture signed it. Raises CaseError when that is nothing, OthersFailed
        when it is nonsense."""
        if body not in self._poses:
            seen, ahead_s = self._seen(body), self.clock_ahead_s
            unseen_s = [(start_s - ahead_s, end_s - ahead_s) for start_s, end_s in seen.unseen_s]
            self._poses[body] = replace(
                seen,
                time_s=seen.time_s - ahead_s,
                # Over a stall nothing went anywhere, seen or not.
                unseen_s=tuple(span for span in unseen_s if self.moving_s(*span) > STEP_US * 1e-6),
            )
        return self._poses[body]

    def _seen(self, body: str) -> Pose:
        """The same by motion capture's own clock."""
        if body not in self._tracks:
            self._tracks[body] = self._track(body)
        return self._tracks[body]

    def _track(self, body: str) -> Pose:
        try:
            found = track(self._motions, body)
        except BadStatement as error:
            raise OthersFailed(error.message, THE_MOTION_CAPTURE, **error.details) from error
        if found is None or len(found.time_us) < 2:
            raise CaseError("motion capture signed no motion of it", body=body)
        return Pose(
            found.time_us * 1e-6,
            found.position_m,
            continuous(found.quaternion),
            tuple((start * 1e-6, end * 1e-6) for start, end in found.unseen_us),
            found.statement,
        )

    @cached_property
    def clock_ahead_s(self) -> float:
        """By how much motion capture's clock is ahead of the robot's, at most `CLOCKS_S`: where the turns of
        the base that it saw fit those of the odometry best. 0 if the base does not turn, or was not seen."""
        try:
            base, table = self._seen(self.robot.name), self.table(topics.ODOM, ns=self.robot.namespace)
        except (CaseError, LayoutChanged):
            return 0.0
        z, w = table["pose.pose.orientation.z"], table["pose.pose.orientation.w"]
        own_rad, time_s = np.unwrap(2 * np.arctan2(z, w)), increasing(table)
        at_s = np.arange(time_s[0] + 1.0, time_s[-1] - 1.0, _TURN_S / 4)
        own = np.interp(at_s + _TURN_S, time_s, own_rad) - np.interp(at_s, time_s, own_rad)
        turning = np.abs(own) > _TURN_RAD
        if not turning.sum() > _TURNS:
            return 0.0
        at_s, own, yaw_rad = at_s[turning], own[turning], base.yaw_rad

        def off_rad(ahead_s: float) -> float:
            ends, begins = (np.interp(at_s + one + ahead_s, base.time_s, yaw_rad) for one in (_TURN_S, 0.0))
            return float(np.mean(np.abs(ends - begins - own)))

        # The nearest to none, of those that fit equally well.
        found = min(
            np.arange(-30, 31) * (CLOCKS_S / 30), key=lambda ahead_s: (off_rad(ahead_s), abs(ahead_s))
        )
        return float(found) if off_rad(found) < 0.8 * off_rad(0.0) else 0.0

    @cached_property
    def base(self) -> Pose:
        """The base's motion by motion capture, or by its own localisation without. Raises like `pose`."""
        if self.mocap:
            return self.pose(self.robot.name)
        return _pose(self.table(topics.POSE, ns=self.robot.namespace))

    # -- what others signed ----------------------------------------------------------------------------

    @property
    def submitted_s(self) -> float:
        """When the proof stood on chain, s of block time; infinite before."""
        at_s = self.ledger.task.proof_submitted if self.ledger else None
        return math.inf if at_s is None else at_s

    def keys(self, role: str, name: str) -> list[Device]:
        """The keys that this device has or had, without those of the executor of a cleaning: a witness that
        the executor owns is the executor's own word."""
        if self.ledger is None:
            return []
        executor = (self.ledger.task.executor or "").lower() if self.kind == CLEANING else None
        return [
            device
            for device in self.ledger.devices
            if (device.role, device.name) == (role, name) and device.owner.lower() != executor
        ]

    def vouching(self, role: str, name: str) -> list[tuple[Device, Testimony]]:
        """What other witnesses than this device signed: none that the executor owns, and none whose key was
        taken. Of a cleaning no robot: it works for the same pay, or for who it helps."""
        if self.ledger is None:
            return []
        executor = (self.ledger.task.executor or "").lower()
        found = []
        for device in self.ledger.devices:
            testimony = self.by_signer.get(device.address.lower())
            same = (device.role, device.name) == (role, name)
            party = device.owner.lower() == executor or (self.kind == CLEANING and device.role == "robot")
            if testimony is None or same or party:
                continue
            if not taken(device, self.submitted_s):
                until_s = counts_until_s(device, self.submitted_s)
                found.append((device, self._counting(testimony, device.name, until_s)))
        return found

    @cached_property
    def by_signer(self) -> dict[str, Testimony]:
        """What registered devices signed, by lower-case address."""
        signers = None if self.ledger is None else {d.address.lower() for d in self.ledger.devices}
        return testimonies(recorded(self.proof, signers))

    def testimony(self, role: str, name: str) -> Testimony:
        """What this witness signed for this organization during the assignment.

        Anything else is no evidence, and passed over. Raises CaseError when nothing is left.
        """
        best = joined(part for _, part in self.parts(role, name))
        if self.ledger is None:
            found = [self._counting(one, name, math.inf) for one in self.by_signer.values()]
            best = max((one for one in found if one.said), key=lambda one: len(one.said), default=None)
        if best is None:
            raise CaseError(
                "nothing signed by this witness is in the recording",
                witness=name,
                role=role,
                registered=None if self.ledger is None else [one.address for one in self.keys(role, name)],
            )
        return best

    def parts(self, role: str, name: str) -> list[tuple[Device, Testimony]]:
        """The same by key: what each of them signed that counts (`services.oracle.keys`)."""
        if (role, name) not in self._parts:
            self._parts[role, name] = [
                (key, self._counting(testimony, name, counts_until_s(key, self.submitted_s)))
                for key in self.keys(role, name)
                if (testimony := self.by_signer.get(key.address.lower())) is not None
            ]
        return self._parts[role, name]

    def signed_by(self, roles: Collection[str]) -> list[tuple[Device, Testimony]]:
        """What all registered devices in these roles signed that counts, by key."""
        return [
            (key, self._counting(testimony, key.name, counts_until_s(key, self.submitted_s)))
            for key in (self.ledger.devices if self.ledger else ())
            if key.role in roles and (testimony := self.by_signer.get(key.address.lower())) is not None
        ]

    def _counting(self, testimony: Testimony, name: str, until_s: float) -> Testimony:
        earliest_s, latest_s = self.assignment_s
        latest_s, slack_s, scope = min(latest_s, until_s), self.slack_s, self._scope
        said = [
            one
            for one in testimony.said
            if one.statement.device == name
            and earliest_s <= one.statement.time_s <= latest_s
            and one.statement.time_s <= one.log_s + slack_s
            and (scope is None or _scope(one.statement) == scope)
        ]
        return replace(testimony, said=said)

    @property
    def assignment_s(self) -> tuple[float, float]:
        """Between which times what others sign is about this assignment."""
        task = self.ledger.task if self.ledger else None
        if task is None or task.assigned is None:
            return -math.inf, math.inf
        end_s = math.inf if task.proof_submitted is None else task.proof_submitted
        return task.assigned - self.slack_s, end_s + self.slack_s

    @cached_property
    def _scope(self) -> tuple[int, str, str] | None:
        said = self.ledger or self.proof.binding
        if said is None:
            return None
        return said.chain_id, said.task_manager.lower(), said.organization.lower()

    @cached_property
    def motion_capture(self) -> Testimony:
        """Raises CaseError when it signed nothing."""
        return self.testimony("mocap", MOTION_CAPTURE)

    @cached_property
    def motion(self) -> list[Said]:
        """`Motion` statements of the site's motion capture, in the order of its chain. Raises CaseError."""
        return [one for one in self.motion_capture.said if isinstance(one.statement, Motion)]

    @cached_property
    def bin_testimony(self) -> Testimony:
        """Raises CaseError when the site's bin signed nothing."""
        return self.testimony("bin", self.site.bin.name)

    @cached_property
    def bin_said(self) -> list[Said]:
        """What the site's bin signed, in the order of its chain; nothing if it signed nothing."""
        try:
            return self.bin_testimony.said
        except CaseError:
            return []

    @cached_property
    def own_said(self) -> list[Said]:
        """What the device that sealed the recording signed beside its seals, in the order of its chain."""
        own = self.by_signer.get((self.proof.signer or "").lower())
        return [] if own is None else own.said

    @cached_property
    def _motions(self) -> list[Motion]:
        """Raises CaseError, OthersFailed."""
        motions = [one.statement for one in self.motion if isinstance(one.statement, Motion)]
        before_us = -1
        for one in motions:
            off_s = abs(one.end_us * 1e-6 - one.time_s)
            if not (one.start_us <= one.end_us and before_us < one.end_us) or off_s > self.slack_s:
                raise OthersFailed(
                    "the times of a statement contradict themselves, or those of the one before",
                    THE_MOTION_CAPTURE,
                    seq=one.seq,
                )
            before_us = one.end_us
        return motions

    @cached_property
    def silences_s(self) -> list[tuple[float, float]]:
        """Over which motion capture itself was off, by the robot's clock: no statement of its chain is
        missing there, so nobody left one out. Raises CaseError, OthersFailed."""
        ahead_s = self.clock_ahead_s
        return [
            (before.end_us * 1e-6 - ahead_s, after.start_us * 1e-6 - ahead_s)
            for said, (before, after) in zip(self.motion[:-1], pairwise(self._motions), strict=True)
            if (before.seq + 1, said.digest) == (after.seq, after.previous) and after.start_us > before.end_us
        ]

    @cached_property
    def stalls_s(self) -> list[tuple[float, float]]:
        """Over which a simulated lab stood still, as its motion capture signed, by the robot's clock. Raises
        OthersFailed."""
        if self.site.clock.source == "wall":
            return []
        try:
            motions = self._motions
        except CaseError:
            return []
        ahead_s = self.clock_ahead_s
        return [
            (start_us * 1e-6 - ahead_s, end_us * 1e-6 - ahead_s)
            for one in motions
            for start_us, end_us in one.stalls_us
            if one.start_us <= start_us < end_us <= one.end_us
        ]

    def moved_s(self, time_s: Array) -> Array:
        """Times without the stalls before them: in them nothing moved."""
        stood_s = [np.clip(time_s, start_s, end_s) - start_s for start_s, end_s in self.stalls_s]
        return np.asarray(time_s - sum(stood_s, np.zeros_like(time_s)))

    def moving_s(self, from_s: float, to_s: float) -> float:
        """How long it is from one time to the other without the stalls in between; negative the other way
        round."""
        moved_s = self.moved_s(np.array([from_s, to_s]))
        return float(moved_s[1] - moved_s[0])

    @cached_property
    def phases(self) -> Phases:
        """When the item was gripped, lifted and left. Raises CaseError."""
        from services.oracle.phases import phases

        return phases(self)

    def sighting(self, before_s: float) -> tuple[Array, Array]:
        """Position (3,) and quaternion (4,) w, x, y, z of the item where the robot last saw it before then.

        Raises CaseError, LayoutChanged.
        """
        table = self.table(topics.ITEM_POSE, ns=self.robot.namespace)
        seen = np.flatnonzero(table.stamp_s <= before_s)
        if not len(seen):
            raise CaseError("the robot did not record where it saw the item", before_s=before_s)
        position_m, quaternion = _poses(table)
        return position_m[seen[-1]], quaternion[seen[-1]]

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """Contract events and the recorder's own, as recorded. Raises CorruptProof."""
        return self.proof.events()

    @cached_property
    def _attestations(self) -> list[Attestation]:
        """Statements by other devices, signatures not yet checked."""
        return self.proof.attestations()

    def signers(self, role: str | None) -> set[str] | None:
        """Lower-case addresses of the devices in this role (None: in any); without a chain None: anybody."""
        return self.ledger.signers(role) if self.ledger else None

    def stated(self, role: str | None, *keys: str) -> list[Payload]:
        """What a device in this role (None: in any) signed that has `keys`, in order.

        What it did not sign is left out: anybody on the bus may have put it there.
        """
        signers = self.signers(role)
        statements = []
        for index, one in enumerate(self._attestations):
            known = signers is None or one.signer.lower() in signers
            if known and all(key in one.payload for key in keys) and self._is_genuine(index):
                log_ns = self.proof.topics[ATTESTATION_CHANNEL].log_ns[index]
                statements.append(Payload(one.payload, log_ns * 1e-9))
        return statements

    def _is_genuine(self, index: int) -> bool:
        """Whether its signer signed it: it, or a later statement that names its digest as the one before."""
        chain = [index]
        while (last := chain[-1]) not in self._genuine:
            later = self._following(last)
            if later is None:
                self._genuine[last] = _genuine(self._attestations[last])
            else:
                chain.append(later)
        for one, later in pairwise(reversed(chain)):
            self._genuine[later] = self._genuine[one] or _genuine(self._attestations[later])
        return self._genuine[index]

    def _following(self, index: int) -> int | None:
        """The later statement of the same signer that names this one's digest."""
        one = self._attestations[index]
        try:
            later = self._naming.get((one.signer, payload_digest(one.payload)), 0)
        except BadAttestation:
            return None
        return later if later > index else None

    @cached_property
    def _naming(self) -> dict[tuple[str, str], int]:
        """Signer and digest of the statement before -> the statement that names it."""
        return {
            (one.signer, str(one.payload["previous"])): index
            for index, one in enumerate(self._attestations)
            if one.payload.get("previous") is not None
        }

    @cached_property
    def charge(self) -> Charge:
        """What both sides of a charge signed. Raises CaseError, OthersFailed."""
        from services.oracle.charge import charge_of

        return charge_of(self)

    @cached_property
    def kinematics(self) -> Kinematics:
        """Where the recorded links were; raises CaseError when base and joints do not tell."""
        from services.oracle.kinematics import Kinematics

        return Kinematics(self)

    @cached_property
    def replay(self) -> Replay:
        """The recorded motion in physics; computed once. Raises CaseError."""
        from services.oracle.replay import replay

        return replay(self)

    @cached_property
    def vote(self) -> Vote:
        """The same with small errors; computed once. Raises what `replay` raises."""
        from services.oracle.replay import vote

        return vote(self, self.replay)


def _scope(statement: Statement) -> tuple[int, str, str]:
    return statement.chain_id, statement.task_manager.lower(), statement.organization.lower()


def _genuine(attestation: Attestation) -> bool:
    try:
        verify_attestation(attestation)
    except BadAttestation:
        return False
    return True


def _poses(table: Table) -> tuple[Array, Array]:
    """(n, 3) positions and (n, 4) normed quaternions w, x, y, z. Raises CaseError."""
    position_m, quaternion = table.vector("pose.position"), table.vector("pose.orientation", "wxyz")
    norm = np.linalg.norm(quaternion, axis=1)
    if not (np.isfinite(position_m).all() and np.isfinite(norm).all() and (abs(norm - 1) < 1e-3).all()):
        raise CaseError("a pose is not a pose", topic=table.topic)
    return position_m, quaternion / norm[:, None]


def _pose(table: Table) -> Pose:
    position_m, quaternion = _poses(table)
    return Pose(increasing(table), position_m, continuous(quaternion))


def continuous(quaternion: Array) -> Array:
    """(n, 4) the same rotations, each quaternion closer to the one before than to its opposite."""
    flips = np.cumprod(np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    return np.asarray(quaternion * np.concatenate([[1.0], flips])[:, None])


def increasing(table: Table) -> Array:
    """(n,) header stamps in s. Raises CaseError unless they increase strictly."""
    time_s = table.stamp_s
    steps = np.diff(time_s)
    if len(time_s) < 2 or not (steps > 0).all():
        raise CaseError(
            "the header stamps do not increase",
            topic=table.topic,
            index=int(np.argmin(steps)) + 1 if len(steps) else 0,
        )
    return time_s
