"""Everything that the checks of one proof may look at."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict

from rodeo import topics
from rodeo.config import Site
from rodeo.dao import CHARGING, CLEANING
from rodeo.evidence import Attestation, EvidenceError, Proof
from rodeo.evidence.series import Array, Table
from rodeo.lab.config import ItemConfig, RobotConfig
from rodeo.messages import Task
from rodeo.metering import MeterStatement

if TYPE_CHECKING:
    from services.oracle.replay import Replay


class Device(BaseModel):
    """A registered device key, as the chain's index tells it."""

    model_config = ConfigDict(extra="ignore")

    address: str
    role: str
    """robot, bin or meter"""
    owner: str
    """Address of the participant that it works for."""
    revoked: float | None = None
    """When it was revoked, s of block time."""


class Ledger(BaseModel):
    """What the chain says about a submitted proof."""

    chain_id: int
    task_manager: str
    task: Task
    devices: list[Device]
    first_use: str | None = None
    """"task/attempt" that submitted the same proof hash earlier, if any."""

    def signers(self, role: str) -> set[str]:
        """Lower-case addresses that may sign as `role` now."""
        return {d.address.lower() for d in self.devices if d.role == role and d.revoked is None}


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


class Case:
    """A proof, the site, and what the chain says (None when asked away from the chain)."""

    def __init__(self, proof: Proof, site: Site, ledger: Ledger | None) -> None:
        self.proof = proof
        self.site = site
        self.ledger = ledger

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
        """The robot that the recording is of. Raises CaseError."""
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

    def pose(self, body: str) -> Pose:
        """Motion capture of a body. Raises LayoutChanged, CaseError when stamps or numbers are absurd."""
        table = self.table(topics.MOCAP_POSE, body=body)
        position_m = table.vector("pose.position")
        quaternion = table.vector("pose.orientation", "wxyz")
        norm = np.linalg.norm(quaternion, axis=1)
        if not (np.isfinite(position_m).all() and np.isfinite(norm).all() and (abs(norm - 1) < 1e-3).all()):
            raise CaseError("a pose is not a pose", body=body)
        flips = np.cumprod(np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0))
        quaternion = quaternion * np.concatenate([[1.0], flips])[:, None] / norm[:, None]
        time_s = increasing(table)
        return Pose(time_s, position_m, quaternion)

    @cached_property
    def attestations(self) -> list[Attestation]:
        """Statements by other devices in the recording. Raises BadAttestation."""
        return self.proof.attestations()

    @cached_property
    def meter_statements(self) -> list[MeterStatement]:
        """What a meter of this site signed, in order. Raises CaseError when there is nothing."""
        signers = self.ledger.signers("meter") if self.ledger else None
        statements = [
            MeterStatement.model_validate(one.payload)
            for one in self.attestations
            if (signers is None or one.signer.lower() in signers) and one.payload.get("type") == "meter"
        ]
        if not statements:
            raise CaseError("nothing signed by a meter is in the recording", meters=sorted(signers or ()))
        return statements

    @cached_property
    def replay(self) -> Replay:
        """The recorded motion in physics; computed once. Raises CaseError."""
        from services.oracle.replay import replay

        return replay(self)


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
