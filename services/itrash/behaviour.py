"""The bin's behaviour: a state machine fed with stamped sensor readings. It reads no clock and does no I/O.

    idle -> item_seen -> classifying -> awaiting_drop -> confirmed | wrong_compartment | timed_out -> idle
                                     -> full -> idle

Its callers feed it and carry out the actions that it returns. Everything it must not forget is in `Memory`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from rodeo.lab.config import BinConfig, ItemClass
from services.itrash.classifier import UNKNOWN, Classification
from services.itrash.load import LOAD_LIMITS, Cell, LoadCell, LoadLimits, Step


class State(StrEnum):
    IDLE = "idle"
    ITEM_SEEN = "item_seen"
    """Something is in front of the sensor and not yet still."""
    CLASSIFYING = "classifying"
    """A photo was asked for."""
    AWAITING_DROP = "awaiting_drop"
    CONFIRMED = "confirmed"
    """It fell where it belongs; waiting for the view to clear."""
    WRONG_COMPARTMENT = "wrong_compartment"
    TIMED_OUT = "timed_out"
    """Nothing fell; a later drop counts as one that was never shown."""
    FULL = "full"
    """The compartment for what was shown takes no more; a drop now counts as one that was never shown."""


@dataclass(frozen=True)
class BinLimits:
    """Times in s of site time, lengths in m."""

    still_s: float = 0.4
    """An item is photographed once its distance has stayed within `still_m` for so long."""
    still_m: float = 0.015
    gone_s: float = 0.5
    """The view is clear once nothing was present for so long."""
    done_gone_s: float = 2.0
    """The same after a drop and counted from it: whoever dropped it has yet to draw back."""
    again_gone_s: float = 1.0
    """While a drop is awaited, an item is looked at again only after the view was clear for so long: the
    gripper passes the sensor on its way to the compartment."""
    another_gone_s: float = 60.0
    """What comes after the view was clear for so long is another item, whatever is still awaited."""
    looks: int = 3
    """Photos taken of an item before it is called unknown."""
    retry_s: float = 1.0
    """Pause after a photo that could not be taken."""
    drop_timeout_s: float = 180.0


_LIMITS = BinLimits()


class ClassificationRecord(BaseModel):
    """A classification as attested; field names are those on the bus."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    bin: str
    seq: int
    item_class: str = Field(alias="class")
    probabilities: dict[str, float]
    compartment: str
    full: bool
    """Whether that compartment takes no more: nothing may be dropped."""
    image_sha256: str
    time_s: float

    def payload(self) -> dict[str, Any]:
        return self.model_dump()


class DisposalRecord(BaseModel):
    """A drop as attested. What was never classified has no expected compartment and is not correct.

    It fell between `after_s` and `time_s`, when its weight had settled.
    """

    bin: str
    seq: int
    classification_seq: int | None
    compartment: str
    expected_compartment: str | None
    weight_n: float
    after_s: float
    time_s: float
    correct: bool

    def payload(self) -> dict[str, Any]:
        return self.model_dump()


@dataclass(frozen=True)
class TakePhoto:
    """Ask the camera for a frame taken at or after `after_s`, then call `photo` or `photo_failed`."""

    after_s: float


@dataclass(frozen=True)
class Attest:
    """Sign, keep and publish the record, and take it out of `Memory.unsigned`."""

    record: ClassificationRecord | DisposalRecord


Action = TakePhoto | Attest


class Memory(BaseModel):
    """What survives a restart."""

    state: State = State.IDLE
    since_s: float = 0.0
    """When `state` was entered."""
    classification_seq: int = 0
    disposal_seq: int = 0
    pending: ClassificationRecord | None = None
    """The classification whose drop is awaited."""
    unsigned: list[ClassificationRecord | DisposalRecord] = []
    """Decided and not yet attested, oldest first."""
    cells: dict[str, Cell] = {}


def compartment_of(config: BinConfig, label: str) -> str:
    """Where a class goes; what is unknown goes where trash goes."""
    return config.compartment_of(ItemClass.TRASH if label == UNKNOWN else ItemClass(label))


class Bin:
    """The state machine. Not thread-safe: one thread feeds it."""

    def __init__(
        self,
        config: BinConfig,
        memory: Memory,
        limits: BinLimits = _LIMITS,
        load_limits: LoadLimits = LOAD_LIMITS,
    ) -> None:
        self.memory = memory
        self._config = config
        self._limits = limits
        for name in config.compartments:
            memory.cells.setdefault(name, Cell())
        self._cells = {name: LoadCell(memory.cells[name], load_limits) for name in config.compartments}
        self._ranges: deque[tuple[float, float]] = deque()
        """(time, distance) since something is present."""
        self._absent_since_s: float | None = None
        self._look = 0
        self._another = False
        """Whether what is looked at cannot be what the pending classification is about."""
        self._retry_at_s = 0.0
        if memory.state in (State.ITEM_SEEN, State.CLASSIFYING):
            # Nothing was said about that item yet; it is seen again if it is still there.
            memory.state = State.AWAITING_DROP if memory.pending else State.IDLE

    @property
    def state(self) -> State:
        return self.memory.state

    @property
    def loads_n(self) -> dict[str, float | None]:
        """Last accounted weight of each compartment."""
        return {name: cell.settled_n for name, cell in self.memory.cells.items()}

    @property
    def fill(self) -> dict[str, float]:
        """How full each compartment is by weight: 0 empty, 1 and more full."""
        return {
            name: max(load_n or 0.0, 0.0) / self._config.full_at_n for name, load_n in self.loads_n.items()
        }

    # -- sensors ---------------------------------------------------------------------------------------

    def presence(self, range_m: float, time_s: float) -> list[Action]:
        """A distance from the presence sensor, stamped; +inf when nothing reflects (REP 117)."""
        present = range_m <= self._config.presence_range_m
        absent_s = 0.0 if self._absent_since_s is None else time_s - self._absent_since_s
        if present:
            self._absent_since_s = None
            self._ranges.append((time_s, range_m))
        else:
            self._ranges.clear()
            if self._absent_since_s is None:
                self._absent_since_s = time_s

        state, pending = self.memory.state, self.memory.pending
        if (
            state is State.AWAITING_DROP
            and pending is not None
            and time_s - pending.time_s > self._limits.drop_timeout_s
        ):
            self.memory.pending = None
            self._enter(State.TIMED_OUT, time_s)
        elif state in (State.CONFIRMED, State.WRONG_COMPARTMENT, State.TIMED_OUT, State.FULL):
            clear_s = min(absent_s, time_s - self.memory.since_s)
            if not present and clear_s >= self._limits.done_gone_s:
                self._enter(State.IDLE, time_s)
        elif state is State.ITEM_SEEN and not present:
            if absent_s >= self._limits.gone_s:
                self._enter(State.AWAITING_DROP if self.memory.pending else State.IDLE, time_s)
        elif present and (
            state is State.IDLE or (state is State.AWAITING_DROP and absent_s >= self._limits.again_gone_s)
        ):
            self._see_item(time_s)
            self._another = absent_s >= self._limits.another_gone_s
        if self.memory.state is State.ITEM_SEEN and self._still(time_s) and time_s >= self._retry_at_s:
            self._enter(State.CLASSIFYING, time_s)
            return [TakePhoto(after_s=time_s)]
        return []

    def photo(self, classification: Classification, image_sha256: str, time_s: float) -> list[Action]:
        """What the classifier says of the photo that was asked for."""
        if self.memory.state is not State.CLASSIFYING:
            return []
        self._look += 1
        unknown = classification.label == UNKNOWN
        if unknown and self._look < self._limits.looks:
            self._retry_at_s = time_s + self._limits.still_s
            self._enter(State.ITEM_SEEN, time_s)
            return []
        pending = self.memory.pending
        if unknown and pending is not None and pending.item_class != UNKNOWN and not self._another:
            # A worse view does not take back what a better one showed.
            self._enter(State.AWAITING_DROP, time_s)
            return []
        compartment = compartment_of(self._config, classification.label)
        self.memory.classification_seq += 1
        record = ClassificationRecord(
            bin=self._config.name,
            seq=self.memory.classification_seq,
            item_class=classification.label,
            probabilities={name: round(p, 4) for name, p in classification.probabilities.items()},
            compartment=compartment,
            full=self.fill[compartment] >= 1.0,
            image_sha256=image_sha256,
            time_s=time_s,
        )
        self.memory.pending = None if record.full else record
        self._enter(State.FULL if record.full else State.AWAITING_DROP, time_s)
        return [self._say(record)]

    def photo_failed(self, time_s: float) -> list[Action]:
        """The camera gave no usable photo; the item is looked at again after a pause."""
        if self.memory.state is State.CLASSIFYING:
            self._retry_at_s = time_s + self._limits.retry_s
            self._enter(State.ITEM_SEEN, time_s)
        return []

    def load(self, compartment: str, force_n: float, time_s: float) -> list[Action]:
        """A reading of a compartment's load cell in N, stamped.

        One item falls into one compartment: when several weights grew at once, the largest is the item and
        the others are what its fall shook.
        """
        cell = self._cells[compartment]
        step = cell.reading(force_n, time_s)
        if step is None or not step.ripe:
            return []
        if step.delta_n < 0:  # somebody emptied it
            cell.account()
            return []
        grown = {n: c.step for n, c in self._cells.items() if c.step is not None and c.step.delta_n > 0}
        compartment, step = max(grown.items(), key=lambda one: one[1].delta_n)
        if not step.ripe:
            return []
        for name in grown:
            self._cells[name].account()
        return [self._say(self._disposal(compartment, step))]

    # -- inside ----------------------------------------------------------------------------------------

    def _disposal(self, compartment: str, step: Step) -> DisposalRecord:
        pending, self.memory.pending = self.memory.pending, None
        expected = None if pending is None else pending.compartment
        self.memory.disposal_seq += 1
        record = DisposalRecord(
            bin=self._config.name,
            seq=self.memory.disposal_seq,
            classification_seq=None if pending is None else pending.seq,
            compartment=compartment,
            expected_compartment=expected,
            weight_n=round(step.delta_n, 3),
            after_s=step.after_s,
            time_s=step.time_s,
            correct=compartment == expected,
        )
        if pending is not None:
            self._enter(State.CONFIRMED if record.correct else State.WRONG_COMPARTMENT, step.time_s)
        return record

    def _say(self, record: ClassificationRecord | DisposalRecord) -> Attest:
        self.memory.unsigned.append(record)
        return Attest(record)

    def _enter(self, state: State, time_s: float) -> None:
        self.memory.state = state
        self.memory.since_s = time_s

    def _see_item(self, time_s: float) -> None:
        self._look = 0
        self._retry_at_s = time_s
        self._enter(State.ITEM_SEEN, time_s)

    def _still(self, time_s: float) -> bool:
        """Whether what is present has kept its distance for `still_s`."""
        start_s = time_s - self._limits.still_s
        while len(self._ranges) >= 2 and self._ranges[1][0] <= start_s:
            self._ranges.popleft()
        if not self._ranges or self._ranges[0][0] > start_s:
            return False
        distances_m = [distance_m for _, distance_m in self._ranges]
        return max(distances_m) - min(distances_m) <= self._limits.still_m
