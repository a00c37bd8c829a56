"""Everything that the checks of one proof may look at, and what differs by kind of work.

A case is data. What several checks compute of it is cached elsewhere (`rodeo.checks.results`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ValidationError

from rodeo.bus.messages import Device, Root, Task
from rodeo.checks.report import Finding
from rodeo.errors import wrong_fields
from rodeo.evidence.errors import EvidenceError
from rodeo.evidence.proof import Proof
from rodeo.host.stamps import FASTEST_CLOCK
from rodeo.lab.config import BinConfig, ItemConfig, RobotConfig
from rodeo.site.config import Site

MOTION_CAPTURE = "mocap"
"""Name of a site's motion capture."""
THE_MOTION_CAPTURE = "the site's motion capture"
THE_CREATOR = "the task's creator"
"""As those who failed."""
NO_MOCAP = "not applicable: the site has no motion capture"
NO_MARKERS = "not applicable: what was carried has no markers"
LATE_WALL_S = 5.0
"""What a busy recorder or bridge may be late, of wall time: more of site time where the clock is faster."""

Params = TypeVar("Params", bound=BaseModel)


class ChainRecord(BaseModel):
    """What the chain says about a submitted proof."""

    chain_id: int
    task_manager: str
    organization: str
    task: Task
    devices: list[Device]
    roots: list[Root] = []
    """Roots of the days of the assignment."""

    def signers(self, role: str | None) -> set[str]:
        """Lower-case addresses that may sign as `role` (None: as anything) now."""
        return {d.address.lower() for d in self.devices if role in (None, d.role) and d.revoked is None}


class CaseError(EvidenceError):
    """The recording does not say what a check needs to know."""


class OthersFailed(EvidenceError):
    """A witness signed nonsense, or the task's creator posted it: not the executor's failure, so a check that
    meets it is undecided."""

    def __init__(self, message: str, fault: str, **details: Any) -> None:
        """`fault` names who failed."""
        super().__init__(message, **details)
        self.fault = fault


@dataclass(frozen=True, eq=False)
class Case:
    """A proof, the site, what the chain says (None when asked away from the chain), and by which kind's
    checks it is judged."""

    proof: Proof
    site: Site
    chain_record: ChainRecord | None
    kind: str | None
    """The task's kind; without a chain, the one that the recording looks like, if any."""
    checks: Checks

    @property
    def robot(self) -> RobotConfig:
        """The robot that the chain names: the executor, or the one that is served. Without a chain, or
        when it names none of this site, the one that the recording is of. Raises CaseError."""
        named = self.checks.robot(self.chain_record.task) if self.chain_record else None
        for robot in self.site.robots:
            if robot.name == named:
                return robot
        for robot in self.site.robots:
            if any(topic.startswith(f"/{robot.namespace}/") for topic in self.proof.topics):
                return robot
        raise CaseError(
            "no robot of this site is in the recording", robots=[r.name for r in self.site.robots]
        )

    @property
    def item(self) -> ItemConfig:
        """The item that the work is about. Raises CaseError."""
        if self.checks.item is None:
            raise CaseError("this kind of work involves no item", kind=self.kind)
        return self.checks.item(self)

    @property
    def bin(self) -> BinConfig:
        """The bin that the work is done at. Raises CaseError."""
        if self.checks.bin is None:
            raise CaseError("this kind of work is done at no bin", kind=self.kind)
        return self.checks.bin(self)

    @property
    def speed(self) -> float:
        """How many times faster than the wall's time the site's goes."""
        clock = self.site.clock
        if clock.source == "wall":
            return 1.0
        return max((clock.idle_speed if self.checks.at_idle_speed else clock.speed) or FASTEST_CLOCK, 1.0)

    @property
    def slack_s(self) -> float:
        """What a time may be off another clock's, s of site time."""
        return LATE_WALL_S * self.speed

    @property
    def mocap(self) -> bool:
        """Whether the site has motion capture."""
        return self.site.lab.mocap

    @property
    def unmarked(self) -> bool:
        """Whether motion capture signs where the gripper is, and not what it carries."""
        return self.mocap and not self.checks.marked(self)

    @property
    def tracked(self) -> bool:
        """Whether motion capture signs where the item is."""
        return self.mocap and not self.unmarked

    @property
    def base_source(self) -> str:
        """The source of where the base is."""
        return "motion capture" if self.mocap else "the robot's own localisation"

    @property
    def item_pose_source(self) -> Literal["motion capture", "perception"]:
        """The source of where the item lay: the lab, or the robot itself, which is weaker."""
        return "motion capture" if self.tracked else "perception"

    @property
    def executor(self) -> str:
        """Lower-case address; empty without a chain."""
        return ((self.chain_record and self.chain_record.task.executor) or "").lower()

    @property
    def submitted_s(self) -> float:
        """When the proof stood on chain, s of block time; infinite before."""
        at_s = self.chain_record.task.proof_submitted if self.chain_record else None
        return math.inf if at_s is None else at_s

    @property
    def assignment_s(self) -> tuple[float, float]:
        """Between which times what others sign is about this assignment."""
        task = self.chain_record.task if self.chain_record else None
        if task is None or task.assigned is None:
            return -math.inf, math.inf
        end_s = math.inf if task.proof_submitted is None else task.proof_submitted
        return task.assigned - self.slack_s, end_s + self.slack_s


CheckFunction = Callable[[Case], Finding]
Stage = tuple[CheckFunction, ...]


@dataclass(frozen=True)
class Checks:
    """How proofs of one kind of work are checked. A kind's checks module exports one as `CHECKS`."""

    stages: tuple[Stage, ...]
    """In the order in which their failures name a verdict's reason."""
    recognizes: Callable[[Proof, Site], bool]
    """Whether a recording that no chain knows looks like work of this kind."""
    acts: Callable[[Case], list[str]] = lambda case: []
    """What a proof claims to have done, so that it is paid once (`rodeo.checks.acts`). Raises what the case's
    computations raise where it cannot be told."""
    amount_iec: Callable[[Case], Decimal | None] = lambda case: None
    """What an accepted proof is paid; None is the task's full price."""
    params: type[BaseModel] | None = None
    """A task's parameters."""
    undoable: Callable[[Case, Mapping[str, Any]], Finding | None] = lambda case, failure: None
    """What is found where the executor gives up, as its event `failure` says, and nobody could have done the
    task, or it cannot be told. None where the failure is the executor's. Only with a chain_record."""
    sealed_by: str = "robot"
    """Role of the device that seals the recording."""
    robot: Callable[[Task], Any] = lambda task: task.executor_name
    """Name of the robot that a proof is about."""
    item: Callable[[Case], ItemConfig] | None = None
    """What is carried, where the checks of the carry are among the stages. Raises CaseError."""
    bin: Callable[[Case], BinConfig] | None = None
    """At which bin, where one of the checks or of what they compute asks for it. Raises CaseError."""
    marked: Callable[[Case], bool] = lambda case: True
    """Whether the item has markers, by which motion capture sees it."""
    both_sides_sign: bool = False
    """Whether seller and buyer testify against each other, so that their own devices' word is evidence.
    Otherwise a witness that the executor owns counts for nothing, and no robot vouches for others: it works
    for the same pay, or for who it helps."""
    work_from_s: Callable[[Case], float] = lambda case: -math.inf
    """From when on a witness that is silent misses the work, s. Raises what the case's computations raise."""
    may_have_come: Callable[[Case], bool] = lambda case: True
    """Whether who gives up may have come to its work while a witness was silent. Raises what the case's
    computations raise."""
    at_idle_speed: bool = False
    """Whether a simulated clock goes at the site's `idle_speed` while the work is done."""
    model_sha256: Callable[[], str] | None = None
    """Hash of the network that the checks ask, where they ask one. Raises RodeoError."""


def ordered(case: Case, model: type[Params]) -> Params:
    """The task's parameters, which its creator may have filled with anything.

    Raises OthersFailed when they order nothing that could be done. Only for a case with a chain_record.
    """
    assert case.chain_record is not None
    try:
        return model.model_validate(case.chain_record.task.params)
    except ValidationError as error:
        wrong = ", ".join(f"{field}: {why}" for field, why in wrong_fields(error).items())
        raise OthersFailed("the task cannot be executed as posted", THE_CREATOR, wrong=wrong) from error
