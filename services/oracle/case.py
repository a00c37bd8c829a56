"""Everything that the checks of one proof may look at."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from rodeo import topics
from rodeo.config import Site
from rodeo.dao import CHARGING, CLEANING
from rodeo.evidence import Attestation, EvidenceError, Proof, verify_attestation
from rodeo.evidence.errors import BadAttestation
from rodeo.evidence.recorder import ATTESTATION_CHANNEL
from rodeo.evidence.series import Array, Table
from rodeo.lab.config import ItemConfig, RobotConfig
from rodeo.messages import Task
from rodeo.metering import MeterStatement
from rodeo.mocap import payload_digest
from services.oracle.witness import signed

if TYPE_CHECKING:
    from services.oracle.kinematics import Kinematics
    from services.oracle.replay import Replay, Vote


class Device(BaseModel):
    """A registered device key, as the chain's index tells it."""

    model_config = ConfigDict(extra="ignore")

    address: str
    role: str
    """robot, bin, meter or mocap"""
    owner: str
    """Address of the participant that it works for."""
    name: str
    """Which device of its role it is on its site."""
    registered: float | None = None
    """When it was registered, s of block time."""
    revoked: float | None = None
    """When it was revoked, s of block time."""
    revoked_because: Literal["superseded", "compromised"] | None = None


class Ledger(BaseModel):
    """What the chain says about a submitted proof."""

    chain_id: int
    task_manager: str
    task: Task
    devices: list[Device]

    def signers(self, role: str | None) -> set[str]:
        """Lower-case addresses that may sign as `role` (None: as anything) now."""
        return {d.address.lower() for d in self.devices if role in (None, d.role) and d.revoked is None}


NO_MOCAP = "not applicable: the site has no motion capture"


class CaseError(EvidenceError):
    """The recording does not say what a check needs to know."""


@dataclass(frozen=True)
class Pose:
    """A body's recorded motion in frame `map`."""

    time_s: Array
    """(n,) strictly increasing, from the messages' headers"""
    position_m: Array
    """(n, 3)"""
    quaternion: Array
    """(n, 4) w, x, y, z, signs continuous"""

    @property
    def yaw_rad(self) -> Array:
        """(n,) heading, unwrapped."""
        w, x, y, z = self.quaternion.T
        return np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


@dataclass(frozen=True)
class Statement:
    """What another device signed, and when it was recorded."""

    payload: dict[str, Any]
    log_s: float


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
        self._witnessed: dict[str, Array] = {}
        self._poses: dict[str, Pose] = {}

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
            item_id = str(self.ledger.task.params.get("item_id"))
            if item_id not in items:
                raise CaseError("the site has no such item", item_id=item_id)
            return items[item_id]
        if not self.mocap:
            taken = [e.get("item") for e in self.events if e.get("event") == "releasing"]
            if not taken or taken[-1] not in items:
                raise CaseError("the recording does not say which item of this site it is about")
            return items[taken[-1]]
        recorded = [i for i in items if self.proof.count("/" + topics.MOCAP_POSE.name(body=i))]
        if not recorded:
            raise CaseError("no item of this site is in the recording", items=list(items))
        return items[max(recorded, key=lambda i: float(np.ptp(self.pose(i).position_m, axis=0).max()))]

    def table(self, topic: topics.Topic, **names: str) -> Table:
        """The messages of a topic of the key table. Raises LayoutChanged."""
        return self.proof.table("/" + topic.name(**names), topic.type)

    @cached_property
    def joints(self) -> Table:
        return self.table(topics.JOINT_STATES, ns=self.robot.namespace)

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
        """Motion capture of a body. Raises LayoutChanged, CaseError when stamps or numbers are absurd."""
        if body not in self._poses:
            self._poses[body] = _pose(self.table(topics.MOCAP_POSE, body=body))
        return self._poses[body]

    @cached_property
    def base(self) -> Pose:
        """The base's motion by motion capture, or by its own localisation without. Raises like `pose`."""
        if self.mocap:
            return self.pose(self.robot.name)
        return _pose(self.table(topics.POSE, ns=self.robot.namespace))

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
        """Statements by other devices, signatures not yet checked. Raises BadAttestation."""
        return self.proof.attestations()

    def signers(self, role: str | None) -> set[str] | None:
        """Lower-case addresses of the devices in this role (None: in any); without a chain None: anybody."""
        return self.ledger.signers(role) if self.ledger else None

    def stated(self, role: str | None, *keys: str) -> list[Statement]:
        """What a device in this role (None: in any) signed that has `keys`, in order.

        What it did not sign is left out: anybody on the bus may have put it there. Raises BadAttestation for
        what is no statement at all.
        """
        signers = self.signers(role)
        statements = []
        for index, one in enumerate(self._attestations):
            known = signers is None or one.signer.lower() in signers
            if known and all(key in one.payload for key in keys) and self._is_genuine(index):
                log_ns = self.proof.topics[ATTESTATION_CHANNEL].log_ns[index]
                statements.append(Statement(one.payload, log_ns * 1e-9))
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
    def meter_statements(self) -> list[MeterStatement]:
        """What a meter of this site signed, in order. Raises CaseError when there is nothing."""
        statements = [
            MeterStatement.model_validate(statement.payload)
            for statement in self.stated("meter", "type", "meter", "energy_wh")
            if statement.payload["type"] == "meter"
        ]
        if not statements:
            raise CaseError(
                "nothing signed by a meter is in the recording", meters=sorted(self.signers("meter") or ())
            )
        return statements

    def witnessed(self, body: str) -> Array:
        """(n,) whether the lab's motion capture signed each recorded pose of `body`. Raises CaseError."""
        topic = "/" + topics.MOCAP_POSE.name(body=body)
        if topic not in self.proof.topics:
            raise CaseError("the topic is not in the recording", topic=topic)
        if body not in self._witnessed:
            poses = self.proof.topics[topic]
            self._witnessed[body] = (
                signed(poses, body, self._attestations, self.signers("mocap"))
                if self.proof.sealed
                else np.ones(len(poses), bool)  # a bag is believed in everything or in nothing
            )
        return self._witnessed[body]

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
