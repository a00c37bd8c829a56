"""The bin's behaviour: a state machine fed with stamped sensor readings. It reads no clock and does no I/O.

    idle -> item_seen -> classifying -> awaiting_drop -> confirmed | wrong_compartment | timed_out -> idle
                                     -> full -> idle
    confirmed | wrong_compartment -> item_seen, when the next item is held in view

Its callers feed it and carry out the actions that it returns. Everything it must not forget is in `Memory`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field

from rodeo.lab.config import BinConfig
from rodeo.lab.drop import WATCHED_S
from rodeo.vision.classification import UNKNOWN, Classification, combined
from rodeo.witness.statement import MAX_CLAIMANTS, MAX_LOOKS, Claimant, Look
from services.itrash.load import LOAD_LIMITS, Cell, LoadCell, LoadLimits, Step
from services.itrash.presence import Presence


class State(StrEnum):
    IDLE = "idle"
    ITEM_SEEN = "item_seen"
    """An item is in front of the sensor and not yet still."""
    CLASSIFYING = "classifying"
    """A photo was asked for."""
    AWAITING_DROP = "awaiting_drop"
    CONFIRMED = "confirmed"
    """The item fell where it belongs; waiting for the view to clear."""
    WRONG_COMPARTMENT = "wrong_compartment"
    TIMED_OUT = "timed_out"
    """Nothing fell; a later drop counts as an item that was never shown. Waiting for the view to clear."""
    FULL = "full"
    """The compartment for the shown item is full; a drop now counts as an item that was never shown. Waiting
    for the view to clear."""


@dataclass(frozen=True)
class BinLimits:
    """Times in s of site time, lengths in m."""

    still_s: float = 0.4
    """An item is photographed once its distance has stayed within `still_m` for so long."""
    still_m: float = 0.015
    gone_s: float = 0.5
    """The view is clear once nothing was present for this time."""
    done_gone_s: float = 2.0
    """The same after a drop and counted from it: the hand that dropped it has yet to draw back."""
    held_s: float = 4.0
    """An object that came to rest after a drop and has rested for this time is the next item. A robot that
    draws back in steps pauses for less, and one that holds still over the bin came to rest before the drop
    settled."""
    again_gone_s: float = 1.0
    """While a drop is awaited, the bin looks at an item again only after the view was clear for this time:
    the gripper passes the sensor on its way to the compartment."""
    another_gone_s: float = 60.0
    """After the view was clear for this time, the next thing is another item, whatever is still awaited."""
    turned_s: float = 10.0
    """A person, who sends no presentation, turns an item within this time."""
    looks: int = 3
    """Photos taken of an item from one angle while the bin is not sure."""
    angles: int = 3
    """The bin looks at an item from at most this number of angles. For a robot that presents itself the
    number holds for everything that it shows with one grasp, even if others present themselves meanwhile."""
    grasps: int = 4
    """Grasps per recording for which the bin asks for other angles. A robot reports itself when it took hold
    of an item: without this bound it could get rid of pictures as often as it likes, and be asked for
    others."""
    sure_at: float = 0.7
    """Below this confidence the bin takes further photos, and then asks for another angle."""
    retry_s: float = 1.0
    """Pause after a photo that could not be taken."""
    drop_timeout_s: float = 180.0
    deaf_s: float = 5.0
    """Without a presence reading for this time the bin counts as down, because drops went unnoticed."""
    weigh_s: float = 5.0
    """How long the bin waits for load cells that have yet to report whether something fell. They need 1 s,
    and a bin that starts hears them one after another: at 20 times real time this is a quarter of a
    second."""
    presented_s: float = 120.0
    """A robot that presented itself shows an item within this time; it shows an unknown item again."""
    shaken_s: float = 3.0
    """A fall and its shaking change the weights within this time; slower changes happened while nobody
    looked."""


_LIMITS = BinLimits()
_RECORDINGS = 64
"""Recordings remembered to have been asked for other angles: more than there are while one of them runs."""


class ClassificationRecord(BaseModel):
    """A classification, to be signed as `rodeo.witness.Classification`."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    number: int
    item_class: str = Field(alias="class")
    probabilities: dict[str, float]
    compartment: str
    full: bool
    """Whether that compartment takes no more: nothing may be dropped."""
    image_sha256: str
    model_sha256: str = ""
    """Network that was loaded for the answer: another may be when this is signed."""
    thresholds_sha256: str = ""
    claimants: tuple[Claimant, ...] = ()
    shown_s: float
    earlier: tuple[Look, ...] = ()
    """The other pictures that were combined."""
    another_angle: bool = False


class DropRecord(BaseModel):
    """A drop, to be signed as `rodeo.witness.Drop`.

    An item that was never classified has no expected compartment and is not correct.

    It fell between `after_s` and `settled_s`.
    """

    number: int
    classification: int | None
    compartment: str
    expected_compartment: str | None
    weight_n: float
    after_s: float
    settled_s: float
    correct: bool
    claimants: tuple[Claimant, ...] = ()


class RemovalRecord(BaseModel):
    """Weight that left a compartment, to be signed as `rodeo.witness.Removal`."""

    compartment: str
    weight_n: float
    after_s: float
    settled_s: float


class WatchRecord(BaseModel):
    """Evidence that the bin ran for a while after a drop, to be signed as `rodeo.witness.Watch`."""

    drop: int
    compartment: str
    after_s: float
    until_s: float


Record = ClassificationRecord | DropRecord | RemovalRecord | WatchRecord


@dataclass(frozen=True)
class TakePhoto:
    """Ask the camera for a frame taken at or after `after_s`, then call `photo` or `photo_failed`."""

    after_s: float


@dataclass(frozen=True)
class Attest:
    """Sign, keep and publish the record, and take it out of `Memory.unsigned`."""

    record: Record


Action = TakePhoto | Attest


class Presented(BaseModel):
    """A robot that announced that it will show something."""

    claimant: Claimant
    at_s: float
    grasped_s: float = 0.0
    """When it took hold of it, by its own word."""

    @property
    def recording(self) -> str:
        """Whose, and which; each is of one attempt of one task."""
        return f"{self.claimant.address}/{self.claimant.recording}".lower()


class Memory(BaseModel):
    """What survives a restart."""

    state: State = State.IDLE
    since_s: float = 0.0
    """When `state` was entered."""
    classifications: int = 0
    """Number of classifications."""
    drops: int = 0
    pending: ClassificationRecord | None = None
    """The classification whose drop is awaited."""
    replaced: ClassificationRecord | None = None
    """The one before it, of what may have begun to fall before the pictures of `pending` were taken."""
    watched: list[WatchRecord] = []
    """What is to be stated at the end of each watch, the oldest first."""
    unsigned: list[Record] = []
    """Decided and not yet attested, oldest first."""
    presented: list[Presented] = []
    """Robots that announced that they will show something, the newest first."""
    asked: dict[str, list[float]] = {}
    """Recording -> when each item was grasped of which another angle was asked for, once for each time. The
    last recording that was asked is at the end."""
    cells: dict[str, Cell] = {}


@dataclass(frozen=True)
class _Seen:
    look: Look
    answer: Classification


class _Showing:
    """Robots that announced that they will show something, and the other angles that they were asked for."""

    def __init__(self, memory: Memory, limits: BinLimits) -> None:
        self._memory, self._limits = memory, limits

    def presented(self, claimant: Claimant, time_s: float, grasped_s: float = 0.0) -> None:
        """A robot announces that it will show something next, which it took hold of at `grasped_s`."""
        others = [one for one in self._memory.presented if one.claimant.address != claimant.address]
        newest = Presented(claimant=claimant, at_s=time_s, grasped_s=grasped_s)
        self._memory.presented = [newest, *others][:MAX_CLAIMANTS]

    def named(self, time_s: float) -> list[Presented]:
        """The robots that presented themselves a moment ago, the newest first."""
        since_s = time_s - self._limits.presented_s
        return [one for one in self._memory.presented if one.at_s >= since_s]

    def may_ask(self, named: Collection[Presented]) -> bool:
        """Whether none of them was asked for as many angles as there are. Any of them may show the item: if
        it had to be the newest, two could take turns."""
        angles = self._limits.angles - 1
        for one in named:
            asked = self._memory.asked.get(one.recording, [])
            if asked.count(one.grasped_s) >= angles or len(asked) >= angles * self._limits.grasps:
                return False
        return True

    def asks(self, named: Collection[Presented]) -> None:
        asked = self._memory.asked
        for one in named:
            asked[one.recording] = [*asked.pop(one.recording, []), one.grasped_s]
        self._memory.asked = dict(list(asked.items())[-_RECORDINGS:])


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
        self._config, self._limits = config, limits
        self.showing = _Showing(memory, limits)
        for name in config.compartments:
            memory.cells.setdefault(name, Cell())
        self._least_n = load_limits.step_n
        self._cells = {name: LoadCell(memory.cells[name], load_limits) for name in config.compartments}
        self._presence = Presence(config.presence_range_m, limits.still_s, limits.still_m, limits.deaf_s)
        self._look = 0
        """Photos taken from this angle."""
        self._angle = 0
        """Angles before this one."""
        self._seen: list[_Seen] = []
        """The pictures of the item that differ, from all angles."""
        self._shown_by: Presented | None = None
        """The robot that presented itself last before the last angle."""
        self._another = False
        """Whether the item in view cannot be that of the pending classification."""
        self._held_after: State | None = None
        """Outcome of the drop after which the item in view is held there, if it is."""
        self._retry_at_s = 0.0
        if memory.state in (State.ITEM_SEEN, State.CLASSIFYING):
            # The item has no answer yet; it is looked at again if it is still there.
            memory.state = State.ITEM_SEEN if memory.pending else State.IDLE

    @property
    def state(self) -> State:
        return self.memory.state

    @property
    def attentive(self) -> bool:
        """Whether something is shown, awaited or settling."""
        return self.memory.state is not State.IDLE or self.decides

    @property
    def decides(self) -> bool:
        """Whether the next reading may lead to an action although it equals the last. Nothing awaited follows
        from an empty view and weights at rest."""
        looks = self.memory.state in (State.ITEM_SEEN, State.CLASSIFYING)
        return looks or self._presence.is_there or any(cell.restless for cell in self._cells.values())

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
        over = [one for one in self.memory.watched if one.until_s <= time_s]
        self.memory.watched = [one for one in self.memory.watched if one not in over]
        return [*map(self._sign, over), *self._sense(range_m, time_s)]

    def _sense(self, range_m: float, time_s: float) -> list[Action]:
        self._presence.reading(range_m, time_s)
        if self.memory.state is State.AWAITING_DROP and self._timed_out(time_s):
            self.memory.pending = self.memory.replaced = None
            self._enter(State.TIMED_OUT, time_s)
        elif self._presence.is_there:
            self._sense_item(time_s)
        else:
            self._sense_nothing(time_s)
        if (
            self.memory.state is State.ITEM_SEEN
            and self._presence.still_since_s is not None
            and time_s >= self._retry_at_s
            # Drops before anybody looked belong to the item before this one.
            and self._weighed(self._presence.hearing_since_s, time_s)
        ):
            self._enter(State.CLASSIFYING, time_s)
            return [TakePhoto(after_s=time_s)]
        return []

    def _sense_item(self, time_s: float) -> None:
        state, since_s, limits = self.memory.state, self.memory.since_s, self._limits
        absent_s, still_since_s = self._presence.absent_s, self._presence.still_since_s
        if state in (State.TIMED_OUT, State.FULL):
            if absent_s >= limits.gone_s:
                self._enter(State.IDLE, time_s)
        elif state in (State.CONFIRMED, State.WRONG_COMPARTMENT):
            if still_since_s is not None and since_s <= still_since_s <= time_s - limits.held_s:
                self._see_item(time_s, absent_s, held_after=state)
        elif state is State.IDLE or (state is State.AWAITING_DROP and absent_s >= limits.again_gone_s):
            self._another = absent_s >= limits.another_gone_s or self._grasped_anew(time_s)
            self._see_item(time_s, absent_s)

    def _sense_nothing(self, time_s: float) -> None:
        absent_s, since_s = self._presence.absent_s, self.memory.since_s
        if self.memory.state in (State.TIMED_OUT, State.FULL):
            if absent_s >= self._limits.gone_s:
                self._enter(State.IDLE, time_s)
        elif self.memory.state in (State.CONFIRMED, State.WRONG_COMPARTMENT):
            if min(absent_s, time_s - since_s) >= self._limits.done_gone_s:
                self._enter(State.IDLE, time_s)
        elif self.memory.state is State.ITEM_SEEN and absent_s >= self._limits.gone_s:
            self._enter(State.AWAITING_DROP if self.memory.pending else State.IDLE, time_s)

    def photo(self, classification: Classification, image_sha256: str, time_s: float) -> list[Action]:
        """The classifier's answer for the requested photo."""
        if self.memory.state is not State.CLASSIFYING:
            return []
        self._look += 1
        self._combine(classification, Look(image_sha256=image_sha256, taken_s=time_s))
        found = combined([one.answer for one in self._seen])
        unknown = found.label == UNKNOWN
        unsure = unknown or found.confidence < self._limits.sure_at
        if unsure and self._look < self._limits.looks:
            self._retry_at_s = time_s + self._limits.still_s
            self._enter(State.ITEM_SEEN, time_s)
            return []
        if unknown and self._held_after is not None:
            # Ignore a gripper that paused while withdrawing.
            self._enter(self._held_after, time_s)
            return []
        if unknown and self._is_settled(self.memory.pending):
            # A worse view does not take back what a better one showed.
            self._enter(State.AWAITING_DROP, time_s)
            return []
        compartment = self._config.compartment_for(found.label, found.told)
        self.memory.classifications += 1
        named = self.showing.named(time_s)
        self._shown_by = named[0] if named else None
        *earlier, last = (one.look for one in self._seen)
        record = ClassificationRecord(
            number=self.memory.classifications,
            item_class=found.label,
            probabilities=found.told,
            compartment=compartment,
            full=self.fill[compartment] >= 1.0,
            image_sha256=last.image_sha256,
            model_sha256=found.model_sha256,
            thresholds_sha256=found.thresholds_sha256,
            claimants=tuple(one.claimant for one in named),
            shown_s=last.taken_s,
            earlier=tuple(earlier),
            another_angle=unsure and self._angle + 1 < self._limits.angles and self.showing.may_ask(named),
        )
        if record.another_angle:
            self.showing.asks(named)
        before = self.memory.pending
        self.memory.pending, self.memory.replaced = (None, None) if record.full else (record, before)
        self._enter(State.FULL if record.full else State.AWAITING_DROP, time_s)
        return [self._sign(record)]

    def photo_failed(self, time_s: float) -> list[Action]:
        """The camera gave no usable photo; the item is looked at again after a pause."""
        if self.memory.state is State.CLASSIFYING:
            self._retry_at_s = time_s + self._limits.retry_s
            self._enter(State.ITEM_SEEN, time_s)
        return []

    def load(self, compartment: str, force_n: float, time_s: float) -> list[Action]:
        """A reading of a compartment's load cell in N, stamped.

        One item falls into one compartment: when several weights grew at once, the largest is the item and
        the others are what its fall shook. What fell while nobody looked may be several items.
        """
        cell = self._cells[compartment]
        step = cell.reading(force_n, time_s)
        if step is None or not step.ripe:
            return []
        if step.delta_n <= 0:  # somebody emptied it, lifted it out or put it back
            # Weight that is missing when a container comes back left with it, and was reported then.
            removed = step.delta_n <= -self._least_n and not cell.lifted
            cell.account()
            return [self._removal(compartment, step)] if removed else []
        unseen = self._unseen(step)
        grown = {n: s for n, s in self._grown(time_s).items() if self._unseen(s) == unseen}
        if unseen:
            # If something fell where the shown item belongs, that is it, else the heaviest. It is reported
            # last: whoever dropped it takes the bin's last statement.
            pending = self.memory.pending
            expected = None if pending is None else pending.compartment
            fell = sorted(grown, key=lambda name: (name == expected, grown[name].delta_n))
            if not self._weighed(self._presence.hearing_since_s, time_s, but=fell):
                return []
        else:
            fell = [max(grown, key=lambda name: grown[name].delta_n)]
        if not all(grown[name].ripe for name in fell):
            return []
        for name in grown:
            self._cells[name].account()
        settled_s = max(grown[name].time_s for name in fell)
        return [
            self._sign(self._drop(name, replace(grown[name], time_s=settled_s), shown=name == fell[-1]))
            for name in fell
        ]

    # -- inside ----------------------------------------------------------------------------------------

    def _deadline_s(self, pending: ClassificationRecord) -> float:
        """Later drops are not the shown item."""
        return pending.shown_s + self._limits.drop_timeout_s

    def _timed_out(self, time_s: float) -> bool:
        """Whether the shown item did not fall in time, which the load cells may report a while later."""
        pending = self.memory.pending
        if pending is None or time_s <= self._deadline_s(pending):
            return False
        # It waits twice as long as a drop that waits for another cell, because the drop must be reported
        # first.
        return self._weighed(self._deadline_s(pending), time_s - self._limits.weigh_s)

    def _weighed(self, until_s: float, time_s: float, but: Collection[str] = ()) -> bool:
        """Whether all that fell up to `until_s` is accounted for, in the compartments other than `but`.

        A silent load cell is given up after `weigh_s`.
        """
        if time_s - max(until_s, self._presence.hearing_since_s) > self._limits.weigh_s:
            return True
        return all(cell.memory.seen_s > until_s for name, cell in self._cells.items() if name not in but)

    def _grown(self, time_s: float) -> dict[str, Step]:
        """Compartments whose weight grew; not those whose load cell fell silent before that was sure."""
        steps = {name: cell.step for name, cell in self._cells.items() if cell.step is not None}
        patience_s = self._limits.weigh_s
        return {
            n: s for n, s in steps.items() if s.delta_n > 0 and (s.ripe or time_s - s.time_s <= patience_s)
        }

    def _unseen(self, step: Step) -> bool:
        """Whether it may have happened while nobody looked."""
        return step.time_s - step.after_s > self._limits.shaken_s

    def _removal(self, compartment: str, step: Step) -> Attest:
        return self._sign(
            RemovalRecord(
                compartment=compartment,
                weight_n=round(-step.delta_n, 3),
                after_s=step.after_s,
                settled_s=step.time_s,
            )
        )

    def _drop(self, compartment: str, step: Step, shown: bool) -> DropRecord:
        pending = self._awaited(step) if shown else None
        if pending is not None and step.after_s > self._deadline_s(pending):
            pending = None
        expected = None if pending is None else pending.compartment
        self.memory.drops += 1
        record = DropRecord(
            number=self.memory.drops,
            classification=None if pending is None else pending.number,
            compartment=compartment,
            expected_compartment=expected,
            weight_n=round(step.delta_n, 3),
            after_s=step.after_s,
            settled_s=step.time_s,
            correct=compartment == expected,
            claimants=() if pending is None else pending.claimants,
        )
        if pending is not None:
            self.memory.pending = self.memory.replaced = None
            self.memory.presented = []
            self._enter(State.CONFIRMED if record.correct else State.WRONG_COMPARTMENT, step.time_s)
        watch = WatchRecord(
            drop=record.number,
            compartment=compartment,
            after_s=step.time_s,
            until_s=step.time_s + WATCHED_S,
        )
        self.memory.watched = [*self.memory.watched, watch]
        return record

    def _awaited(self, step: Step) -> ClassificationRecord | None:
        """The classification of what fell. What was shown while that fell is the gripper that draws back."""
        pending, before = self.memory.pending, self.memory.replaced
        if pending is None or before is None or self._unseen(step):
            return pending
        return before if pending.shown_s > step.after_s else pending

    def _sign(self, record: Record) -> Attest:
        self.memory.unsigned.append(record)
        return Attest(record)

    def _enter(self, state: State, time_s: float) -> None:
        self.memory.state = state
        self.memory.since_s = time_s

    def _combine(self, answer: Classification, look: Look) -> None:
        """Add a picture to the others of the item. A repeated one, from a camera that hangs, counts once, as
        seen last."""
        others = [one for one in self._seen if one.look.image_sha256 != look.image_sha256]
        # A camera's clock may step back; signed pictures stand in the order of their times.
        self._seen = sorted([*others, _Seen(look, answer)], key=lambda one: one.look.taken_s)[-MAX_LOOKS:]

    def _is_settled(self, pending: ClassificationRecord | None) -> bool:
        """Whether the item shown last has a class, and is not being shown from the other angle that was asked
        for: whoever shows that waits for an answer."""
        named = pending is not None and pending.item_class != UNKNOWN and not pending.another_angle
        return named and not self._another

    def _goes_on(self, time_s: float, absent_s: float) -> bool:
        """Whether what is shown now is the other angle that was asked for, by the same robot for the same
        recording: one that begins again proves nothing with pictures from before. A robot presents itself
        before each showing, so the newest is the one that shows. Where nobody has presented itself, somebody
        else comes after a longer while."""
        pending = self.memory.pending
        if pending is None or not pending.another_angle or not self._seen or self._another:
            return False
        named, before = self.showing.named(time_s), self._shown_by
        if not named or before is None:
            return not named and before is None and absent_s <= self._limits.turned_s
        return named[0].recording == before.recording

    def _grasped_anew(self, time_s: float) -> bool:
        """Whether the one who showed an item last has taken hold of it again since."""
        named, before = self.showing.named(time_s), self._shown_by
        if not named or before is None or named[0].recording != before.recording:
            return False
        return named[0].grasped_s != before.grasped_s

    def _see_item(self, time_s: float, absent_s: float, held_after: State | None = None) -> None:
        self._look = 0
        if self._goes_on(time_s, absent_s):
            self._angle += 1
        else:
            self._angle, self._seen = 0, []
        self._held_after = held_after
        self._retry_at_s = time_s
        self._enter(State.ITEM_SEEN, time_s)
