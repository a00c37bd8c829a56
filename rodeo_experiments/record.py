"""What is known of a run, as it is kept in `run.json`: times of the site and of the wall, amounts in IEC."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ValidationError

from rodeo.bus.messages import Task
from rodeo.bus.queries import Person, Transaction, Transfer
from rodeo.errors import unreadable
from rodeo.host.files import replace_file
from rodeo.lab.config import ItemConfig
from rodeo_experiments.errors import ExperimentFailed


class Heard(BaseModel):
    """An event of the chain as it arrived here."""

    name: str
    task_id: int | None
    tx_hash: str
    verdict: str
    """What a ruling says; empty otherwise."""
    block_s: float
    """The block's time."""
    wall_s: float
    """When it was heard, from the begin of the run."""


class Sent(BaseModel):
    """A command of this experiment to the bridge, in wall time from the begin of the run."""

    command: str
    task_id: int | None
    sent_s: float
    replied_s: float


class Reading(BaseModel):
    """One reading of a robot's gauge."""

    robot: str
    time_s: float
    soc: float
    power_w: float
    """Into the battery; negative while it is used."""


class Flow(BaseModel):
    """Power that a dock gave without a pause."""

    dock: str
    begin_s: float
    end_s: float
    energy_wh: float
    cost_eur: float = 0.0


class Fallen(BaseModel):
    """What the bin signed about the thing of a proof."""

    item_class: str
    weight_n: float
    time_s: float
    """When its weight had settled."""


class Arrival(BaseModel):
    """Something that was left on the floor, and the task that was posted for it."""

    number: int
    time_s: float
    item: str
    x_m: float
    y_m: float
    task_id: int | None = None
    """None while nobody has posted one."""
    found_by: str | None = None
    """The robot that found it; None if a person pointed at it."""
    fallen: Fallen | None = None
    """What the proof of a paid cleaning holds."""


class Run(BaseModel):
    """One run from begin to end."""

    seed: int
    days: int
    begin_s: float
    """Site time at which the first day's midnight was."""
    timezone: str
    robots: list[str]
    work: str
    """Kind of the work that is done for each arrival."""
    energy: str
    emptying: str
    machine: dict[str, str]
    parameters: dict[str, str]
    wall_s: float
    site_s: float
    waited_s: float
    """Wall time for which the clock stood still for somebody."""
    supply_start_iec: str
    supply_end_iec: str
    started_s: float
    """Site time from which balances count: the treasury is filled, and nobody has arrived."""
    tasks: list[Task]
    transfers: list[Transfer]
    transactions: list[Transaction]
    participants: list[Person]
    events: list[Heard]
    sent: list[Sent]
    battery: list[Reading]
    flows: list[Flow]
    things: list[ItemConfig] = []
    """What people leave and nobody listed; empty where all of it is listed."""
    arrivals: list[Arrival]
    notes: list[str]
    """What did not go as planned, in words."""

    def save(self, path: Path) -> None:
        replace_file(path, self.model_dump_json(indent=1) + "\n")

    @classmethod
    def load(cls, path: Path) -> Run:
        """Raises ExperimentFailed."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except ValidationError as error:
            raise ExperimentFailed(
                "this is no record of a run, or one of another version",
                path=str(path),
                reason=unreadable(error),
            ) from error

    def of(self, kind: str) -> list[Task]:
        """The tasks of a kind, in the order in which they were posted."""
        return sorted((task for task in self.tasks if task.kind == kind), key=lambda task: task.id)

    def day_of(self, time_s: float) -> int:
        """The experiment's day, from 0."""
        return int((time_s - self.begin_s) // 86_400)
