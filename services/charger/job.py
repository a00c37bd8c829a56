"""The assignment that is being worked on: what the charger must remember of it across a restart."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rodeo import topics
from rodeo.errors import RodeoError
from rodeo.evidence.errors import ContainerError
from rodeo.evidence.reader import SealedReader
from rodeo.evidence.recorder import ATTESTATION_CHANNEL, EVENT_CHANNEL
from rodeo.files import replace_file
from rodeo.messages import Task
from rodeo.metering import MeterSample, MeterStatement
from rodeo.ros2.types import deserialize
from services.charger.meter import Meter, Register
from services.charger.session import SessionState

log = logging.getLogger(__name__)


def stamp_s(message: Any) -> float:
    """A message's header stamp in s of site time."""
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


class JobBroken(RodeoError):
    """The file is there and is not a job; starting anew could meter the same session twice."""


class ChargingParams(BaseModel):
    """What a charging task asks for."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    robot: str
    dock: str
    soc_from: float = Field(ge=0, le=1)
    soc_target: float = Field(gt=0, le=1)


class Job(BaseModel):
    """One attempt at one charging task. What was metered and heard is not here: the recording has it."""

    task: Task
    session: SessionState

    @property
    def name(self) -> str:
        return f"task-{self.task.id}-{self.task.attempt}"

    @classmethod
    def load(cls, path: Path) -> Job | None:
        """The job at `path`, None when there is none. Raises JobBroken."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValidationError) as error:
            raise JobBroken("cannot read the charger's job", path=str(path), reason=str(error)) from error

    def save(self, path: Path) -> None:
        """Replace the file at `path` as a whole."""
        replace_file(path, self.model_dump_json())


@dataclass(frozen=True)
class Recorded:
    """Where a recording stands. It is the only place where this is kept, so nothing can disagree with it."""

    register: Register
    """Of the meter: the last signed statement, and the readings after it."""
    events_seq: int
    """Sequence number of the last contract event."""


def recover(path: Path, output_topic: str) -> Recorded:
    """Where the unfinished recording at `path` stands; `output_topic` carries the meter's readings."""
    register = Register()
    events_seq = 0
    unsaid: list[bytes] = []
    try:
        for topic, _, message in SealedReader(path):
            if topic == output_topic:
                unsaid.append(message.data)
            elif topic == ATTESTATION_CHANNEL:
                said = MeterStatement.model_validate(json.loads(message.data)["payload"])
                last = MeterSample.model_validate(said.model_dump(include=set(MeterSample.model_fields)))
                register = Register(energy_wh=said.energy_wh, last=last, seq=said.seq, previous=said.digest())
                unsaid.clear()
            elif topic == EVENT_CHANNEL:
                events_seq = max(events_seq, json.loads(message.data).get("seq", 0))
    except ContainerError as error:
        log.info("the recording ends here: %s", error)  # cut off, which is what being killed looks like
    meter = Meter("", 0, 0, register, readings_per_statement=len(unsaid) + 1)  # it only counts
    for cdr in unsaid:
        output = deserialize(cdr, topics.DOCK_OUTPUT.type)
        meter.reading(stamp_s(output), float(output.voltage), float(output.current))
    return Recorded(register, events_seq)
