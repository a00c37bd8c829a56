"""The assignment that is being worked on: what the charger must remember of it across a restart."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

from pydantic import BaseModel

from rodeo.bus.messages import Task
from rodeo.charging.metering import Reading
from rodeo.charging.orders import SOC_USED, ChargingParams, dock_of, most_due_iec, order_wh
from rodeo.dao import Assignment
from rodeo.errors import ConfigError, RodeoError
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.errors import ContainerError
from rodeo.evidence.reader import SealedReader
from rodeo.host.files import read_model, replace_file, set_aside
from rodeo.kinds import providing_energy
from rodeo.lab.config import DockConfig
from rodeo.ros2.plain import deserialize
from rodeo.ros2.readings import power
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL, SEAL_CHANNEL
from rodeo.text.strict_json import read_json
from services.charger.session import SessionState

log = logging.getLogger(__name__)


class BadTask(RodeoError):
    """A delivery for this task might not be paid."""


def is_for(task: Task, dock: str, site: Site) -> bool:
    """Whether the charger of `dock` has to do the task. Somebody must refuse a task that names none of the
    site's docks: the first does."""
    try:
        return dock_of(site, task.params.get("dock")).name == dock
    except ConfigError:
        return dock == site.docks[0].name


def require_payable(task: Task, params: ChargingParams, site: Site, dock: str) -> None:
    """Called before anything is delivered. Raises BadTask when the task is for another dock, and when an
    honest proof may not be judged within its verdict window."""
    if params.dock not in (None, dock):
        raise BadTask("this charger serves another dock", serves=dock, dock=params.dock)
    if task.verdict_window_s < site.min_verdict_window_s:
        raise BadTask(
            "the task's verdict window is too short",
            verdict_window_s=task.verdict_window_s,
            needs_s=site.min_verdict_window_s,
        )


FOREIGN = "of-another-assignment"
"""In the name of a file that was set aside."""


class JobBroken(RodeoError):
    """The file is there and is not a job; starting anew could meter the same session twice."""

    restart_cures = False


class Job(BaseModel):
    """One attempt at one charging task. The recording, not this, has what was metered and received."""

    task: Task
    session: SessionState
    assignment: Assignment | None = None
    """The assignment; None in a file from before this was noted."""

    @property
    def name(self) -> str:
        return f"task-{self.task.id}-{self.task.attempt}"

    @classmethod
    def load(cls, path: Path) -> Job | None:
        """The job at `path`, None when there is none. Raises JobBroken."""
        words = (
            "the charger's job file is damaged: restore it, or move it away; then the charger "
            "is not paid for the interrupted session"
        )
        return read_model(cls, path, JobBroken, words)

    def set_aside(self, path: Path, recording: Path) -> None:
        """Put the job at `path`, which is of another chain or another assignment, and its recording away."""
        kept = [set_aside(one, FOREIGN) for one in (path, recording) if one.exists()]
        log.warning(
            "the job %s belongs to another chain or assignment (%s); kept in %s",
            self.name,
            self.assignment or "it does not say which",
            ", ".join(map(str, kept)),
        )

    def save(self, path: Path) -> None:
        """Replace the file at `path` as a whole."""
        replace_file(path, self.model_dump_json())


class Jobs:
    """The job of one dock in its folder, beside the recordings."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._path = folder / "job.json"

    def own(self, belongs: Callable[[Job], bool | None], open_contactor: Callable[[], object]) -> Job | None:
        """The job on disk, if it `belongs` to an assignment on this chain; None if that is not known.

        A foreign job is set aside: the robot on the contacts does not pay for it.
        """
        job = Job.load(self._path)
        owns = None if job is None else belongs(job)
        if job is None or owns:
            return job
        if owns is not None:
            open_contactor()
            job.set_aside(self._path, self.recording(job))
        return None

    def save(self, job: Job) -> None:
        job.save(self._path)

    def recording(self, job: Job) -> Path:
        return self._folder / f"{job.name}.mcap"

    def kept(self, sha256: str) -> Path:
        """Path of the dock's own copy of a proof."""
        return self._folder / "proofs" / f"{sha256.removeprefix('0x')}.mcap"

    def done(self, recording: Path, sha256: str) -> None:
        """Forget the job, and keep its recording: the store may lose it, then this copy is stored again."""
        self._path.unlink()
        kept = self.kept(sha256)
        kept.parent.mkdir(exist_ok=True)
        recording.replace(kept)


@dataclass
class Recorded:
    """Where a recording stands, as far as it shows."""

    records: list[Attestation] = field(default_factory=list)
    """Records of the meter, in order."""
    receipts: list[Attestation] = field(default_factory=list)
    """Receipts of the robot."""
    seals: set[str] = field(default_factory=set)
    """Their digests."""
    unsaid: list[Reading] = field(default_factory=list)
    """Readings after the last record, and the one before them."""
    events_seq: int = 0
    """Sequence number of the last contract event."""


def recover(path: Path, output_topic: str) -> Recorded:
    """Where the unfinished recording at `path` stands; `output_topic` carries the meter's readings."""
    found = Recorded()
    try:
        for topic, _, message in SealedReader(path):
            if topic == output_topic:
                found.unsaid.append(Reading(*power(deserialize(message.data, topics.DOCK_OUTPUT.type))))
            elif topic == SEAL_CHANNEL:
                found.seals.add("0x" + sha256(message.data).hexdigest())
            elif topic == ATTESTATION_CHANNEL:
                attestation = Attestation.model_validate_json(message.data)
                if attestation.payload.get("type") == "meter.record":
                    found.records.append(attestation)
                    del found.unsaid[:-1]
                else:
                    found.receipts.append(attestation)
            elif topic == EVENT_CHANNEL:
                found.events_seq = max(found.events_seq, read_json(message.data).get("seq", 0))
    except ContainerError as error:
        log.info("the recording ends here: %s", error)  # cut off, which is what being killed looks like
    return found


_MORE_SHARE = 1.1
"""Factor on what a robot's own estimate orders."""


def unsold(site: Site, dock: DockConfig, least_wh: float) -> list[str]:
    """Why the dock sells some of the site's robots nothing, where it takes no order below `least_wh`."""
    most_wh = {robot.name: order_wh(robot.battery, dock, 0.0, 1.0) for robot in site.robots}
    return [
        f"{robot} orders {wh:g} Wh at most, and the register of the meter of {dock.name} moves in such steps "
        f"that it confirms no order below {least_wh:.0f} Wh"
        for robot, wh in most_wh.items()
        if wh < least_wh
    ]


def wrong_order(
    task: Task, params: ChargingParams, site: Site, dock: DockConfig, least_wh: float
) -> str | None:
    """Why the dock would not be paid for what it delivers, or should not be, if so; to be checked before it
    delivers anything. Its meter confirms orders from `least_wh` on.

    Without rates a session is paid by the share of its order, so a buyer that orders a thousand times what a
    battery takes would pay next to nothing for a full one. A session that costs more than the tariff is not
    paid at all.
    """
    energy = providing_energy(site)
    price_iec, tariff_iec = task.price_iec, energy.price_iec
    if price_iec is not None and price_iec > tariff_iec:
        return f"it pays {price_iec} IEC, but a session here costs {tariff_iec} IEC"
    most_iec = most_due_iec(energy.rates, params.energy_wh)
    if price_iec is not None and price_iec < most_iec:
        return f"it pays at most {price_iec} IEC, but may cost {most_iec.normalize():f} IEC by the rates"
    soc_from = max(params.soc_from - SOC_USED, 0.0)
    most_wh = _MORE_SHARE * order_wh(site.robot(params.robot).battery, dock, soc_from, params.soc_target)
    if params.energy_wh > most_wh:
        return f"it orders {params.energy_wh:g} Wh, but its battery takes {most_wh:.0f} Wh at most"
    if params.energy_wh < least_wh:
        return f"it orders {params.energy_wh:g} Wh, but the meter confirms orders from {least_wh:.0f} Wh on"
    return None
