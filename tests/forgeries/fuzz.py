"""A fuzzer of values: whoever writes a number, a text, a length or an order into a proof writes an odd one.

A seed draws one to three changes of the honest run of a kind: of a ROS message, of what a device signs, of an
event, of the order or the times of messages, of the task's parameters, and of the sealed file itself. A
change of the last kind, or of a statement under its old signature, changes what was signed.

No verification may end without a named outcome, and none may be accepted whose signed words were changed and
counted. `make bench ONLY=fuzz` asks thousands of seeds.
"""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, TypeVar, get_args

import numpy as np
from eth_account.signers.local import LocalAccount

from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Outcome, Report
from rodeo.evidence.attestation import Attestation, attest
from rodeo.evidence.errors import BadAttestation
from rodeo.ros2.definitions import BASE, NAME, SEQUENCE, definition
from rodeo.ros2.types import new
from rodeo_testing.assignments import BIN, METER, MOCAP, ROBOT
from rodeo_testing.recordings import Sample, Sides, Take, Witnesses
from rodeo_testing.workshop import McapMessage, Submission, Workshop
from tests.forgeries.catalogue import HARNESSES, Shops

T = TypeVar("T")
FileEdit = Callable[[list[McapMessage]], list[McapMessage]]
Rng = np.random.Generator
OUTCOMES = get_args(Outcome)
_KEYS: dict[str, LocalAccount] = {str(account.address): account for account in (ROBOT, BIN, METER, MOCAP)}
_MOST_CHANGES = 3
_MANY = 10_000
"""Entries of a sequence, and characters of a text."""
FLOATS = (0.0, -0.0, 1e-320, 5e-324, 1e-300, 1e308, -1e308, math.inf, -math.inf, math.nan, 2.0**53, 2.0**63)
INTEGERS = (
    0,
    1,
    -1,
    2,
    127,
    128,
    255,
    256,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**53,
    2**63 - 1,
    -(2**31),
    -(2**63),
)
TEXTS = (
    "",
    " ",
    "\0",
    "\n",
    "nan",
    "null",
    "-1",
    "0x",
    "\u202eabc",
    "\u200b",
    "e\u0301",
    "\ufeff",
    "\ud7ff\ue000",
    "\U0001f916",
    "\uffff",
    "../../etc/passwd",
    "%s%n{}",
    "a/b",
    "x" * _MANY,
    "\u0130",
)


@dataclass
class Run:
    """An honest run while it is changed."""

    take: Take
    chain_record: ChainRecord
    edits: list[Callable[[int, Attestation], Attestation | None]]
    """What the recorder makes of statements, in turn; each has its number among all that were said."""
    files: list[FileEdit]
    """The same of the sealed file's messages."""


@dataclass(frozen=True)
class Change:
    words: str
    apply: Callable[[Run], None]
    without: Change | None = None
    """The same run without a statement that its device did not sign."""
    sealed: bool = False
    """Whether it changes what the executor's device sealed."""


@dataclass(frozen=True)
class Fuzzed:
    """What a seed draws."""

    kind: str
    changes: tuple[Change, ...]

    @property
    def words(self) -> str:
        return f"{self.kind}: " + "; ".join(change.words for change in self.changes)

    def judged(self, shops: Shops) -> tuple[Report, list[str]]:
        """What the oracle says, and what raised unforeseen meanwhile."""
        shop = shops[self.kind]
        with _unforeseen() as raised:
            report = shop.judged(self._submission(shop))
        shop.empty()
        return report, raised

    def _submission(self, shop: Workshop) -> Submission:
        run = Run(shop.take, shop.chain_record(), [], [])
        for change in self.changes:
            change.apply(run)

        numbers = itertools.count()

        def edit(one: Attestation) -> Attestation | None:
            number = next(numbers)
            kept: Attestation | None = one
            for change in run.edits:
                kept = None if kept is None else change(number, kept)
            return kept

        witnesses = Witnesses(edit=edit, charge=Sides(keep=edit))
        path = shop.sealed(run.take, witnesses=witnesses)
        if run.files:
            path = shop.rewritten(lambda messages: _each(run.files, messages), path)
        return Submission(run.chain_record, path)

    def wrong(self, shops: Shops) -> str | None:
        """What must not be, if anything."""
        try:
            report, raised = self.judged(shops)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is the finding
            return f"ended without a report: {error!r}"
        if report.outcome not in OUTCOMES:
            return f"has no named outcome: {report.outcome}"
        if raised:
            return f"raised unforeseen: {raised[0]}"
        if not report.accepted:
            return None
        if any(change.sealed for change in self.changes):
            return "was accepted although the sealed file was changed"
        if any(change.without for change in self.changes):
            without = replace(self, changes=tuple(change.without or change for change in self.changes))
            other, _ = without.judged(shops)
            if (other.outcome, other.amount_iec) != (report.outcome, report.amount_iec):
                return f"a statement counted that nobody signed: {other.reason}"
        return None

    def minimized(self, shops: Shops) -> Fuzzed:
        """With no change that is not needed for what is wrong."""
        found = self
        for change in self.changes:
            fewer = replace(found, changes=tuple(one for one in found.changes if one is not change))
            if fewer.changes and fewer.wrong(shops):
                found = fewer
        return found


def fuzzed(seed: str) -> Fuzzed:
    """The changes that a seed stands for."""
    rng = np.random.default_rng(list(seed.encode()))
    kind = list(HARNESSES)[int(rng.integers(len(HARNESSES)))]
    count = 1 + int(rng.integers(_MOST_CHANGES))
    return Fuzzed(kind, tuple(_DRAWN[int(rng.integers(len(_DRAWN)))](rng) for _ in range(count)))


@contextmanager
def _unforeseen() -> Iterator[list[str]]:
    """What a verification logs with a traceback."""
    raised: list[str] = []

    class Heard(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.exc_info:
                raised.append(f"{record.getMessage()}: {record.exc_info[1]!r}")

    handler, logger = Heard(logging.ERROR), logging.getLogger("rodeo.checks")
    logger.addHandler(handler)
    try:
        yield raised
    finally:
        logger.removeHandler(handler)


def _each(files: list[FileEdit], messages: list[McapMessage]) -> list[McapMessage]:
    for edit in files:
        messages = edit(messages)
    return messages


# -- values ------------------------------------------------------------------------------------------------


def _one_of(rng: Rng, values: Sequence[T]) -> T:
    return values[int(rng.integers(len(values)))]


def odd_float(rng: Rng, value: float) -> float:
    return _one_of(rng, (*FLOATS, -value, value * 1e3, value + 1e-9, math.nextafter(value, math.inf)))


def odd_json(rng: Rng, depth: int = 3) -> Any:
    """Any value that JSON has, and some that it has not."""
    match int(rng.integers(9 if depth else 6)):
        case 0:
            return _one_of(rng, TEXTS)
        case 1:
            return _one_of(rng, FLOATS)
        case 2:
            return _one_of(rng, (*INTEGERS, 10**30))
        case 3:
            return _one_of(rng, (True, False))
        case 4:
            return None
        case 5:
            return _one_of(rng, ("0x" + "ab" * 32, "0x" + "AB" * 20, "1e999", "2026-11-28T00:00:00Z"))
        case 6:
            return [odd_json(rng, depth - 1) for _ in range(int(rng.integers(4)))]
        case 7:
            return {_one_of(rng, TEXTS): odd_json(rng, depth - 1) for _ in range(int(rng.integers(4)))}
        case _:
            found: Any = []
            for _ in range(_one_of(rng, (50, 199, 300))):
                found = [found]
            return found


def odd_object(rng: Rng, value: dict[str, Any]) -> dict[str, Any]:
    """With one value, at some depth, that is odd, missing, or too many."""
    keys = sorted(value)
    if not keys or rng.random() < 0.1:
        return value | {_one_of(rng, TEXTS): odd_json(rng)}
    key = _one_of(rng, keys)
    inner = value[key]
    if isinstance(inner, dict) and rng.random() < 0.7:
        return value | {key: odd_object(rng, inner)}
    if isinstance(inner, list) and inner and rng.random() < 0.7:
        at = int(rng.integers(len(inner)))
        odd = odd_object(rng, inner[at]) if isinstance(inner[at], dict) else odd_json(rng)
        return value | {key: [*inner[:at], odd, *inner[at + 1 :]]}
    if rng.random() < 0.15:
        return {name: one for name, one in value.items() if name != key}
    near = isinstance(inner, int | float) and not isinstance(inner, bool) and rng.random() < 0.5
    return value | {key: odd_float(rng, float(inner)) if near else odd_json(rng)}


def odd_message(rng: Rng, message: Any, ros_type: str) -> Any:
    """With one odd field, at some depth, that its type can hold."""
    name, (kind, detail) = _one_of(rng, definition(ros_type).fields)
    value = getattr(message, name)
    if kind == NAME:
        return replace(message, **{name: odd_message(rng, value, detail)})
    if kind == BASE:
        return replace(message, **{name: _odd_base(rng, detail[0], value)})
    (element_kind, element), _ = detail
    entries = list(value)
    at = int(rng.integers(len(entries))) if entries else None
    if kind == SEQUENCE and (at is None or rng.random() < 0.4):
        first = entries[0] if entries else _nothing(element_kind, element)
        entries = _one_of(rng, ([], [first], entries * 2, entries[1:], [first] * _MANY))
    elif at is not None and element_kind == NAME:
        entries[at] = odd_message(rng, entries[at], element)
    elif at is not None:
        entries[at] = _odd_base(rng, element[0], entries[at])
    return replace(message, **{name: _like(value, entries)})


def _like(value: Any, entries: list[Any]) -> Any:
    return np.array(entries, value.dtype) if isinstance(value, np.ndarray) else entries


def _nothing(kind: int, element: Any) -> Any:
    return new(element) if kind == NAME else "" if element[0] in ("string", "wstring") else 0


def _odd_base(rng: Rng, base: str, value: Any) -> Any:
    if base in ("string", "wstring"):
        return _one_of(rng, TEXTS)
    if base == "bool":
        return not value
    if base.startswith("float"):
        number = odd_float(rng, float(value))
        with np.errstate(over="ignore"):
            return float(np.float32(number)) if base == "float32" else number
    limits = np.iinfo({"byte": "uint8", "char": "uint8"}.get(base, base))
    return min(
        max(_one_of(rng, (*INTEGERS, int(value) + 1, int(value) - 1)), int(limits.min)), int(limits.max)
    )


# -- changes -----------------------------------------------------------------------------------------------


def _recorded(take: Take) -> list[str]:
    """Topics of ROS messages that are recorded: what motion capture sees, it signs."""
    found = {sample.topic for sample in take.samples if sample.ros_type}
    return sorted(topic for topic in found if not topic.startswith("mocap/"))


def _fields(rng: Rng) -> Change:
    """Odd values in messages of one topic: in one, in some that follow each other, in all."""
    seed, share, first = int(rng.integers(2**32)), _one_of(rng, (0.0, 0.05, 1.0)), rng.random()

    def apply(run: Run) -> None:
        rng = np.random.default_rng(seed)
        topic = _one_of(rng, _recorded(run.take))
        count = len(run.take.of(topic))
        begin = int(first * count)
        chosen, number = range(begin, begin + max(1, int(share * count))), itertools.count()

        def edit(sample: Sample) -> Sample:
            if next(number) not in chosen:
                return sample
            again = np.random.default_rng(seed + 1)  # the same field of each
            return replace(sample, message=odd_message(again, sample.message, sample.ros_type))

        run.take = run.take.edited(topic, edit)

    return Change(f"odd fields ({seed}) of {share:.0%} of a topic", apply)


def _statement(rng: Rng) -> Change:
    """An odd value in what a device signs, under its key or under the old signature."""
    seed, at, again = int(rng.integers(2**32)), int(rng.integers(60)), rng.random() < 0.6

    def apply(run: Run) -> None:
        def edit(number: int, one: Attestation) -> Attestation | None:
            if number != at:
                return one
            payload = odd_object(np.random.default_rng(seed), one.payload)
            with suppress(BadAttestation):
                if again:
                    return attest(payload, _KEYS[one.signer])
            return one.model_copy(update={"payload": payload})

        run.edits.append(edit)

    def leave_out(run: Run) -> None:
        run.edits.append(lambda number, one: None if number == at else one)

    under = "its key" if again else "the old signature"
    words = f"an odd statement {at} ({seed}) under {under}"
    return Change(words, apply, None if again else Change(f"without statement {at}", leave_out))


def _event(rng: Rng) -> Change:
    """An odd note of the recorder or the robot."""
    name = _one_of(rng, ("execution_failed", "recording_resumed", "releasing", "stalled", "statement", "x"))
    message = odd_object(rng, {"event": name, "message": "m", "item": "item1", "details": {}, "topics": {}})
    share = rng.random()

    def apply(run: Run) -> None:
        samples = run.take.samples
        at = 1 + int(share * (len(samples) - 1))
        note = Sample("rodeo/event", "", message, samples[at - 1].time_ns)
        run.take = Take([*samples[:at], note, *samples[at:]])

    return Change(f"an event {str(message)[:60]!r}", apply)


def _order(rng: Rng) -> Change:
    """Some messages in another order, left out, or there twice."""
    what, share, seed = int(rng.integers(4)), rng.random(), int(rng.integers(2**32))
    length = _one_of(rng, (2, 20, 500))

    def apply(run: Run) -> None:
        samples = run.take.samples
        at = 1 + int(share * max(0, len(samples) - length - 1))
        window = samples[at : at + length]
        if what == 0:
            window = window[::-1]
        elif what == 1:
            window = [window[one] for one in np.random.default_rng(seed).permutation(len(window))]
        else:
            window = [] if what == 2 else window * 2
        run.take = Take([*samples[:at], *window, *samples[at + length :]])

    words = ("reversed", "shuffled", "left out", "twice")[what]
    return Change(f"{length} messages {words} at {share:.0%}", apply)


def _time(rng: Rng) -> Change:
    """Another log time, or another number on the bus, of some messages."""
    share, length, numbers = rng.random(), _one_of(rng, (1, 50)), rng.random() < 0.5
    by = _one_of(rng, (-1, 1, 10**6, -(10**9), 10**9, 10**12, -(10**12), 2**31, 2**32 - 1))

    def changed(sample: Sample) -> Sample:
        if numbers:
            return replace(sample, sequence=sample.sequence + by)
        return replace(sample, time_ns=sample.time_ns + by)

    def apply(run: Run) -> None:
        samples = run.take.samples
        at = 1 + int(share * (len(samples) - 1))
        window = (changed(one) if one.ros_type else one for one in samples[at : at + length])
        run.take = Take([*samples[:at], *window, *samples[at + length :]])

    return Change(f"{'numbers' if numbers else 'log times'} of {length} messages by {by}", apply)


def _params(rng: Rng) -> Change:
    """An odd parameter of the task, which its creator chose."""
    seed = int(rng.integers(2**32))

    def apply(run: Run) -> None:
        rng, task = np.random.default_rng(seed), run.chain_record.task
        params = odd_object(rng, dict(task.params))
        run.chain_record = run.chain_record.model_copy(
            update={"task": task.model_copy(update={"params": params})}
        )

    return Change(f"odd parameters ({seed})", apply)


def _file(rng: Rng) -> Change:
    """The sealed file: a bit, a number, a time, the order of its messages."""
    what, share, seed = int(rng.integers(5)), rng.random(), int(rng.integers(2**32))

    def edit(messages: list[McapMessage]) -> list[McapMessage]:
        rng, at = np.random.default_rng(seed), int(share * (len(messages) - 2))
        one, following = messages[at], messages[at + 1]
        if what == 0:
            data = bytearray(one.data)
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            return [*messages[:at], one._replace(data=bytes(data)), *messages[at + 1 :]]
        if what == 1:
            return [*messages[:at], one._replace(sequence=one.sequence ^ 1), *messages[at + 1 :]]
        if what == 2:
            return [*messages[:at], one._replace(publish_ns=one.publish_ns + 1), *messages[at + 1 :]]
        if what == 3:
            return [*messages[:at], *messages[at + 1 :]]
        return [*messages[:at], following, one, *messages[at + 2 :]]

    words = ("a bit", "a number", "a publish time", "one message less", "two exchanged")[what]
    change = Change(f"{words} in the sealed file at {share:.2%}", lambda run: run.files.append(edit))
    return replace(change, sealed=True)


_DRAWN: tuple[Callable[[Rng], Change], ...] = (
    _fields,
    _fields,
    _statement,
    _statement,
    _event,
    _order,
    _time,
    _params,
    _file,
)
"""Each as often as it has ways to be odd."""
