"""What was done can be paid for once: acts, and which of them were paid for or may be.

While a ruling of acceptance stands, what its proof claims is claimed: somebody else who claims the same waits
until that is concluded, or until the ruling is replaced. Once it is concluded, the act is spent. An executor
claims an act once: while any of its own proofs has a ruling that may be replaced, the act is not free for
another one. An acceptance that a reorganization took off the chain keeps its claim until the attempt gets
another ruling or ends: its bridge posts it again. The kinds of the tasks do not matter: one drop into a bin
is one act.

An act is a line of text, `<what it is>/<number>` or `<what it is>/<from>-<to>`: `bin/itrash/drop/7`,
`mocap/item3/120-180`, `meter/dock1/register/1000.0-1200.0`. Two acts overlap when they are of the same thing
and their numbers do. Whole numbers count things, statements or drops, and both ends belong to the act;
decimals measure a quantity, and where one ends the next may begin.

`ConsumedActs` is made again at every start, from the events, from the reports that rulings name, and from
what was found free to be paid for (`Promised`): rulings on that may be on their way to the chain.
"""

from __future__ import annotations

import logging
import re
import threading
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import NamedTuple, Self

from pydantic import BaseModel

from rodeo.bus.messages import DaoEvent, Ruling
from rodeo.checks.report import Check
from rodeo.errors import RodeoError
from rodeo.text.foreign_text import quoted
from rodeo.text.strict_json import read_json

log = logging.getLogger(__name__)

_ACT = re.compile(
    r"(?P<what>[^\s/]+(?:/[^\s/]+)*)/(?P<first>[0-9]+(?:\.[0-9]+)?)(?:-(?P<last>[0-9]+(?:\.[0-9]+)?))?",
    re.ASCII,
)
_MAX_CHARACTERS = 300


class Judged(NamedTuple):
    """A file that the store must have, because a ruling names it."""

    what: str
    """In words."""
    uri: str
    sha256: str
    """As 0x hex."""


def judged_files(events: Iterable[DaoEvent]) -> Iterator[Judged]:
    """What the rulings in a task's events, which are in chain order, say that the store has."""
    proof: DaoEvent | None = None
    reported: DaoEvent | None = None
    for event in events:
        if event.name == "ProofSubmitted":
            proof = event
        elif event.name == "Reported":  # right before its ruling
            reported = event
        elif event.name == "Ruled" and reported is not None:
            of, said = f"task {event.task_id} attempt {event.args['attempt']}", reported.args
            # Nobody ever had the bytes of what was not handed over.
            if proof is not None and not str(said["reason"]).startswith("fetched: "):
                yield Judged(f"the proof of {of}", proof.args["uri"], str(proof.args["proof_hash"]).lower())
            yield Judged(f"the report on {of}", said["report_uri"], str(event.args["report"]).lower())
            reported = None


class MalformedAct(RodeoError):
    """A report lists as an act what is none."""

    machines = False


@dataclass(frozen=True)
class Act:
    """One act, read from its text."""

    text: str
    what: str
    first: Decimal
    last: Decimal
    whole: bool
    """Whether its numbers count things, so that `last` belongs to it."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Raises MalformedAct."""
        found = _ACT.fullmatch(text) if len(text) <= _MAX_CHARACTERS else None
        if found is None:
            raise MalformedAct("this is not an act", act=text[:_MAX_CHARACTERS])
        first, last = found["first"], found["last"] or found["first"]
        if Decimal(last) < Decimal(first):
            raise MalformedAct("an act ends before it begins", act=text)
        whole = "." not in first + last or found["last"] is None
        return cls(text, found["what"], Decimal(first), Decimal(last), whole)

    def overlaps(self, other: Act) -> bool:
        if self.what != other.what:
            return False
        if self.whole or other.whole:
            return self.first <= other.last and other.first <= self.last
        return self.first < other.last and other.first < self.last


@dataclass(frozen=True)
class Submission:
    """One submitted proof, as the chain's events tell of it."""

    task_id: int
    attempt: int
    executor: str
    block: int
    log_index: int
    proof: str = ""
    """SHA-256 of its file, as 0x hex."""
    ruling: Ruling | None = None
    """The last of a judge, whether it stands or is final; None while no judge has ruled."""
    passed_on: bool = False
    """The judge could not decide, and people may."""
    over: bool = False
    """The attempt ended, with or without a ruling."""
    reports: tuple[tuple[str, str], ...] = ()
    """(uri, SHA-256 as 0x hex) of each ruling's report."""

    @property
    def key(self) -> tuple[int, int]:
        return self.task_id, self.attempt

    @property
    def place(self) -> tuple[int, int]:
        """Submissions in chain order are in the order of these."""
        return self.block, self.log_index

    @property
    def waits(self) -> bool:
        """Whether its first ruling is still to come. After the verdict window, too: until the case ends it
        may be ruled on."""
        return self.ruling is None and not self.over

    @property
    def stands(self) -> bool:
        """Whether it has a ruling that may be replaced yet."""
        return self.ruling is not None and not self.over

    @property
    def accepted(self) -> bool:
        """Whether it was paid for, or is as things stand."""
        return self.ruling == "accepted"


@dataclass(frozen=True)
class Spent:
    """An act that was paid for before, or that another proof with a ruling claims."""

    act: str
    by: Submission
    theirs: str
    """The act of theirs that it overlaps."""
    earlier: bool
    """Whether it was submitted earlier in chain order."""
    own: bool
    """Whether both are of one executor."""


@dataclass(frozen=True)
class Wait:
    """Whether an act is spent cannot be told yet."""

    on: Submission
    why: str


class Promise(BaseModel):
    """Acts that a submission may be paid for, as was said of it."""

    task_id: int
    attempt: int
    proof_sha256: str
    acts: list[str]


class Promised(BaseModel):
    """Promises on one chain."""

    chain: str = ""
    """Genesis hash."""
    promises: list[Promise] = []


class ConsumedActs:
    """The acts of accepted proofs, by the chain's events. Thread-safe.

    Args:
        tell: is called when something was learnt, under a lock: it must not ask anything here but `news`.
        promised: before this start.
    """

    def __init__(self, tell: Callable[[], None] = lambda: None, promised: Promised | None = None) -> None:
        self._lock = threading.Condition()
        self._tell = tell
        self._promised = promised or Promised()
        self.news = 0
        """Counts what was learnt."""
        self._chain = ""
        self._seq = 0
        """Number of the last event."""
        self._events: defaultdict[int, list[DaoEvent]] = defaultdict(list)
        """What happened to each task; what was undone is taken out again."""
        self._submissions: dict[int, list[Submission]] = {}
        self._listed: dict[str, list[Act]] = {}
        """SHA-256 of a report -> the acts that it lists."""
        self._judged: dict[tuple[int, int], list[Act] | None] = {}
        """What own verifications found that a submission claims; None where they found nothing out."""
        self._clear: dict[tuple[int, int], frozenset[str]] = {}
        """Acts that submissions may be paid for, as was said of them."""
        self._undone: dict[tuple[int, int], Submission] = {}
        """Submissions whose acceptance was taken off the chain, as they were accepted."""
        self._away: set[tuple[int, int]] = set()
        """Submissions whose proofs cannot be read yet."""

    def on_event(self, event: DaoEvent) -> None:
        with self._lock:
            if event.chain != self._chain or event.seq == 1 < self._seq:
                # Another chain: its tasks are others. Or an index that was made anew: it tells all again.
                if event.chain != self._chain:
                    self._away.clear()
                self._chain = event.chain
                self._events.clear()
                self._submissions.clear()
                self._judged.clear()
                self._clear.clear()
                self._undone.clear()
            self._seq = event.seq
            self._lock.notify_all()
            if event.task_id is None:
                return
            events = self._events[event.task_id]
            if event.name == "EventUndone":
                self._undo(event, events)
            elif event.name in _TELLING and all(one.seq != event.seq for one in events):
                events.append(event)
            self._submissions[event.task_id] = list(submissions_of(events))
            if event.name == "ProofSubmitted":
                self._remember(event.task_id, int(event.args["attempt"]))
            self._release(event)
            self._told()

    def _remember(self, task_id: int, attempt: int) -> None:
        """What was promised to a submission before this start, or before it was taken off the chain."""
        one = self._find(task_id, attempt)
        for said in self._promised.promises if self._promised.chain == self._chain else ():
            if one is not None and (said.task_id, said.attempt, said.proof_sha256) == (*one.key, one.proof):
                self._clear[one.key] = frozenset(said.acts)
                self._judged[one.key] = [Act.parse(text) for text in said.acts]

    def promised(self) -> Promised:
        """What may be paid for, as far as is not known to have its ruling."""
        with self._lock:
            paid = [key for key in self._clear if (one := self._find(*key)) and one.over and one.accepted]
            for key in paid:
                del self._clear[key]
            before = self._promised.promises if self._promised.chain == self._chain else []
            now = [
                Promise(task_id=one.task_id, attempt=one.attempt, proof_sha256=one.proof, acts=sorted(acts))
                for key, acts in self._clear.items()
                if (one := self._find(*key)) is not None and one.waits
            ]
            unheard = [one for one in before if self._find(one.task_id, one.attempt) is None]
            self._promised = Promised(chain=self._chain, promises=[*unheard, *now])
            return self._promised

    def _undo(self, event: DaoEvent, events: list[DaoEvent]) -> None:
        """Take out of a task's `events` what `event` says was taken off the chain."""
        name, undone, task_id = event.args["undone_name"], event.args["undone_seq"], event.task_id or 0
        before = {one.key: one for one in self._submissions.get(task_id, ())}
        events[:] = [one for one in events if one.seq != undone]
        if name not in ("ProofSubmitted", "Ruled"):
            return
        key = task_id, int(event.args["attempt"])
        if name == "ProofSubmitted":
            self._judged.pop(key, None)
            self._clear.pop(key, None)
        elif key in before and before[key].accepted:
            self._undone[key] = replace(before[key], over=False)

    def _release(self, event: DaoEvent) -> None:
        """Forget the claims of undone acceptances that `event` ends: the attempt has another ruling, is over,
        or is somebody else's now; or the task was taken off the chain, and its number may be another's."""
        ends = event.name in _ENDS or event.args.get("undone_name") == "TaskRegistered"
        now = {one.key: one for one in self._submissions[event.task_id or 0]}
        for key, kept in list(self._undone.items()):
            if key[0] == event.task_id:
                one = now.get(key, kept)
                changed = one is not kept and (not one.waits or one.executor != kept.executor)
                if ends or changed:
                    del self._undone[key]

    def heard(self, seq: int, longest_s: float) -> bool:
        """Wait until the event of this number was heard; whether it was. At a start all are heard again."""
        with self._lock:
            return self._lock.wait_for(lambda: self._seq >= seq, longest_s)

    def _told(self) -> None:
        self.news += 1
        self._tell()

    def submission(self, task_id: int, attempt: int) -> Submission | None:
        """None when its event was not heard, or was undone."""
        with self._lock:
            return self._find(task_id, attempt)

    def waits(self, task_id: int, attempt: int) -> bool:
        """Whether a submission is known, and waits for a ruling."""
        submission = self.submission(task_id, attempt)
        return submission is not None and submission.waits

    def waiting(self) -> list[Submission]:
        """Those whose first ruling is still to come."""
        with self._lock:
            return [one for one in self._all() if one.waits]

    def judged_files(self) -> list[Judged]:
        """What rulings name in the store."""
        with self._lock:
            return [one for events in self._events.values() for one in judged_files(events)]

    def unread(self) -> list[Submission]:
        """Those with a report that has to be read: they were accepted, or may be yet."""
        with self._lock:
            return [one for one in self._claimants() if (one.accepted or one.stands) and self._unread(one)]

    def read(self, sha256: str, listed: Iterable[str]) -> None:
        """The report of this hash lists these acts; what is none is left out and logged."""
        found = []
        for text in listed:
            try:
                found.append(Act.parse(text))
            except MalformedAct as error:
                log.error("the report %s lists an invalid act: %s", sha256, error)
        with self._lock:
            self._listed[sha256.lower()] = found
            self._told()

    def is_read(self, sha256: str) -> bool:
        with self._lock:
            return sha256.lower() in self._listed

    def judged(self, task_id: int, attempt: int, claimed: Iterable[str] | None) -> None:
        """A verification ended, so that others do not wait for it in vain: the submission claims these acts,
        none if it is refused. None where it gets no ruling from here."""
        found = None if claimed is None else [Act.parse(text) for text in claimed]
        with self._lock:
            if found is not None:  # a ruling that pays for what was promised may be on its way
                promised = self._clear.get((task_id, attempt), frozenset())
                found += [Act.parse(text) for text in sorted(promised - {act.text for act in found})]
            self._judged[task_id, attempt] = found
            if found is None:
                self._clear.pop((task_id, attempt), None)
            self._told()

    def failed(self, task_id: int, attempt: int) -> None:
        """An own decision failed: others wait for what was promised, and for nothing else."""
        with self._lock:
            if (task_id, attempt) not in self._clear:
                self._judged[task_id, attempt] = None
            self._told()

    def away(self, task_id: int, attempt: int, is_away: bool) -> None:
        """Note whether the proof of a submission cannot be read yet. Then only later submissions of the same
        executor wait for it. An executor that submits the hash of nothing must not delay others. It must not
        be paid twice for one act either, by handing over the first proof late."""
        with self._lock:
            (self._away.add if is_away else self._away.discard)((task_id, attempt))
            self._told()

    def spent(
        self,
        task_id: int,
        attempt: int,
        claimed: Iterable[str],
        *,
        due: bool = False,
        late: bool = False,
        newest: int = 0,
    ) -> Spent | Wait | None:
        """Whether any of the acts that a submission claims was paid for; None if none was.

        What was submitted earlier goes first: while it waits for its ruling and may claim one of these acts,
        the later one waits, too. So does everybody while the acceptance of somebody else's claim may still be
        replaced. What its own executor claims in a proof that has a ruling is spent until that ruling is
        final: it may be accepted yet, and no honest executor claims one act twice. Somebody else's claim that
        was not accepted holds nobody up. Nor do others' proofs that are not verified yet, once the ruling is
        `due`: they wait for it then. And what was accepted and may be replaced counts as spent then; what was
        promised to others, whose rulings take seconds, when it is `late`. No act is free before the event
        of number `newest` was heard: an index that is made anew tells all again.
        """
        wanted: dict[str, list[Act]] = defaultdict(list)
        for text in claimed:
            act = Act.parse(text)
            wanted[act.what].append(act)
        with self._lock:
            me = self._find(task_id, attempt)
            if me is None or not wanted:
                return None
            if self._seq < newest:
                return Wait(me, f"of {newest} events {self._seq} were heard")
            wait: Wait | None = None
            for other in sorted(self._claimants(), key=lambda one: one.place):
                found = None if other.key == me.key else self._in_the_way(other, me, wanted, due, late)
                if isinstance(found, Spent):
                    return found
                wait = wait or found
            if wait is None:
                self._clear[me.key] = frozenset(act.text for acts in wanted.values() for act in acts)
            return wait

    def _in_the_way(
        self, other: Submission, me: Submission, wanted: dict[str, list[Act]], due: bool, late: bool
    ) -> Spent | Wait | None:
        """What one other submission has to do with the acts that are `wanted`."""
        earlier, own = other.place < me.place, other.executor == me.executor
        if other.accepted or (own and other.stands):
            if self._unread(other):
                return Wait(other, "its report could not be read yet")
            if (both := _overlap(wanted, self._acts(other))) is None:
                return None
            if own or due or other.over:
                return Spent(both[0].text, other, both[1].text, earlier, own)
            return Wait(other, "it was accepted, and that may be replaced yet")
        unknown = other.key in self._away or (due and other.key not in self._judged)
        if not own and unknown and other.key not in self._clear:
            return None
        # Others wait for what may be paid for since that was said; of two such, the later one does.
        promised = other.key in self._clear
        if (earlier if promised == (me.key in self._clear) else promised) and other.waits:
            known, theirs = other.key in self._judged, self._judged.get(other.key)
            both = _overlap(wanted, theirs) if theirs is not None else None
            if both is not None and promised and late and not own:
                return Spent(both[0].text, other, both[1].text, earlier, own)
            if not known or both is not None:
                was = "was submitted earlier" if earlier else "may be paid for it"
                return Wait(other, f"it {was} and has no ruling yet")
        return None

    def _find(self, task_id: int, attempt: int) -> Submission | None:
        return next((one for one in self._submissions.get(task_id, ()) if one.attempt == attempt), None)

    def _all(self) -> Iterator[Submission]:
        for submissions in self._submissions.values():
            yield from submissions

    def _claimants(self) -> Iterator[Submission]:
        """All submissions, those whose acceptance was taken off the chain as they were."""
        yield from (one for one in self._all() if one.key not in self._undone)
        yield from self._undone.values()

    def _unread(self, submission: Submission) -> bool:
        return any(sha256 not in self._listed for _, sha256 in submission.reports)

    def _acts(self, submission: Submission) -> list[Act]:
        return [act for _, sha256 in submission.reports for act in self._listed[sha256]]


def acts_unspent(claimed: list[str], found: Spent | None) -> Check:
    """Whether what a proof claims was paid for before, as the check that is asked last."""
    source = "accepted proofs on chain and their reports"
    if found is None:
        return Check(name="acts_unspent", passed=True, source=source, detail=", ".join(map(quoted, claimed)))
    by = f"task {found.by.task_id} attempt {found.by.attempt}"
    if found.by.over:
        said = "was paid for"
    elif found.by.accepted:
        said = "was accepted"
    elif found.by.waits:
        said = "may be paid for"
    else:
        said = "is with auditors" if found.by.passed_on else "has a ruling that may be replaced"
    fault = None
    if found.by.accepted and not found.earlier:
        # Who submitted first would have been paid, had its ruling come in time.
        fault = "the oracle, which decided a later submission first"
    elif not found.by.over and not found.own:
        fault = "another executor, whose claim may still be rejected"
    return Check(
        name="acts_unspent",
        passed=False,
        measured=quoted(found.act),
        source=source,
        detail=f"{quoted(found.act)} {said} in {by} as {quoted(found.theirs)}",
        fault=fault,
    )


def acts_listed(data: bytes, sha256: str) -> list[str]:
    """The acts in a report: none in one by people; and no wait would change what is malformed."""
    try:
        listed = read_json(data).get("acts", [])
    except ValueError as error:
        log.error("the report %s of a ruling lists no acts: %r", sha256, error)
        return []
    return [str(act) for act in listed] if isinstance(listed, list) else []


_ENDS = frozenset({"TaskSettled", "TaskRequeued", "TaskFailed", "TaskCancelled"})
_TELLING = _ENDS | {"ProofSubmitted", "Reported", "PassedOn", "Ruled"}


def submissions_of(events: Iterable[DaoEvent]) -> Iterator[Submission]:
    """Those of one task, from its events in chain order."""
    uri: str | None = None
    made: list[Submission] = []
    for event in events:
        args = event.args
        if event.name == "ProofSubmitted":
            attempt = int(args["attempt"])
            executor = str(args["executor"])
            place = event.block, event.log_index
            proof = str(args.get("proof_hash", "")).lower()
            made.append(Submission(event.task_id or 0, attempt, executor, *place, proof))
        elif not made:
            continue
        elif event.name == "Reported":
            uri = str(args["report_uri"])
        elif event.name == "PassedOn":
            made[-1] = replace(made[-1], passed_on=True)
        elif event.name == "Ruled":
            ruling: Ruling = args["ruling"]
            if uri is not None:
                report = uri, str(args["report"]).lower()
                made[-1] = replace(made[-1], reports=tuple(dict.fromkeys((*made[-1].reports, report))))
                uri = None
            # A void without a report no judge has said: nobody had ruled when the verdict window ended.
            silent = ruling == "void" and not int(str(args["report"]), 16)
            if made[-1].ruling is not None or not silent:
                made[-1] = replace(made[-1], ruling=ruling)
        elif event.name in _ENDS:
            made[-1] = replace(made[-1], over=True)
    yield from made


def _overlap(wanted: dict[str, list[Act]], others: Iterable[Act]) -> tuple[Act, Act] | None:
    """The first of `wanted` that one of `others` overlaps, and that one."""
    return next(
        ((own, other) for other in others for own in wanted.get(other.what, ()) if own.overlaps(other)), None
    )
