"""Proofs that the oracle cannot read yet: whose failure that is, and how they are obtained all the same.

A store may lose or damage what it was given, be out of reach, or be one that this oracle does not know. None
of that is the executor's failure. But a proof that nobody but its executor ever saw proves nothing, and
auditors should not have to look for it. So the decision depends on whether the executor hands over, on
request, the bytes whose hash it submitted. It keeps a copy until long after its verdict
(`rodeo.recording.copies`); asked over the bus it puts them into the store again, and hands them to the oracle
directly where the store cannot be read.

    the bytes come, from wherever         verified as any other proof
    the store cannot be read              waits until the verdict is due; then undecided: the store failed
    the bridge knows the store, not we    the same: the oracle failed, as it does where its disk is full
    the store can be read and lacks them  its executor hands them over in `oracle.handover_s`; or rejected
"""

from __future__ import annotations

import logging
import os
import shutil
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Literal

from rodeo.bus.messages import Task
from rodeo.bus.session import Bus
from rodeo.checks.report import Check, Report
from rodeo.errors import BusError, ClockUnavailable, DiskFull, RodeoError
from rodeo.evidence.errors import EvidenceError, StoreUnavailable
from rodeo.evidence.store import Store
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent, Rest
from rodeo.jobs.apart import FAULT, report_on
from rodeo.recording.copies import ask_to_put, hand_over
from rodeo.runtime.logs import about_task
from rodeo.site.config import Site
from rodeo.text.foreign_text import in_words, quoted

log = logging.getLogger(__name__)

LOOK_S = 1.0
"""Wall time between two looks at what is due."""
_PAUSE_S = (1.0, 30.0)
"""Shortest and longest wall time before a proof is looked and asked for again."""
_SEEKERS = 4
"""Proofs looked for at the same time: one store that hangs must not keep the others waiting."""
_MARGIN_SHARE = 0.25
"""Largest share of a verdict window that is kept for the verdict on a proof that turned up late."""

_NUMBERS = count()
"""Numbers for folders."""

Owner = Literal["executor", "store", "oracle"]


class ProofAway(RodeoError):
    """The bytes of a submitted proof are unavailable now; `owner` is the party that seems to have failed."""

    def __init__(self, message: str, task: Task, owner: Owner) -> None:
        super().__init__(message)
        self.task = task
        self.owner = owner


@dataclass
class _Sought:
    task: Task
    why: str
    owner: Owner
    folder: Path
    """Its own: an executor may copy another's hash, and an older look may not have ended yet."""
    pause_s: float = _PAUSE_S[0]
    due_s: float = 0.0
    """Wall (monotonic) time of the next look."""
    looked_s: float | None = None
    asked_s: float = 0.0
    """Wall time for which the executor has been asked."""
    was_asked: bool = False
    """Whether anybody could hear it."""
    busy: bool = field(default=False, repr=False)


class MissingProofs:
    """Looks for the proofs of submissions until they are found or patience ends. Thread-safe.

    Args:
        found: called with (task id, attempt) when there is something to decide: a copy, or the final verdict.
        waits: whether a submission still waits for its verdict.
        stores: prefixes of URIs that the bridge takes proofs in. Raises BusError, RemoteError.
    """

    def __init__(
        self,
        site: Site,
        bus: Bus,
        clock: Clock,
        folder: Path,
        found: Callable[[int, int], None],
        waits: Callable[[int, int], bool],
        stores: Callable[[], list[str]],
    ) -> None:
        self._site, self._bus, self._clock = site, bus, clock
        self._store = Store(site)
        self._folder = folder
        shutil.rmtree(folder, ignore_errors=True)  # of a process that was killed
        self._found, self._waits, self.stores = found, waits, stores
        self._lock = threading.Lock()
        self._sought: dict[tuple[int, int], _Sought] = {}
        self._news = ClockedEvent(clock)
        self._ended: dict[tuple[int, int], Path | Report] = {}
        """The proof itself, or the report on one that was unavailable."""
        self._looked = threading.Event()
        """Set once a look has ended since it was last cleared."""
        self._pool = ThreadPoolExecutor(_SEEKERS, thread_name_prefix="seeker")
        self._storing = ThreadPoolExecutor(1, thread_name_prefix="storing")

    def seek(self, task: Task, away: ProofAway) -> None:
        """Look for the task's proof from now on."""
        key = task.id, task.attempt
        with self._lock:
            if (one := self._sought.get(key)) is not None:
                one.why, one.owner = away.message, away.owner
                return
        self.forget(key)
        folder = self._folder / f"{task.id}-{task.attempt}-{next(_NUMBERS)}"
        with self._lock:
            self._sought[key] = _Sought(task, away.message, away.owner, folder)
        log.warning("task %d attempt %d: %s; asking its executor for the proof", *key, away.message)
        self._news.set()

    def run(self, stop: threading.Event, tell: Callable[[], None]) -> None:
        """Run until `stop`; `tell` is called now and then to publish the status."""

        def look() -> Rest | None:
            self._looked.clear()
            tell()
            if not self._look_around():
                return Rest(self._first_due_s(), LOOK_S)
            # A simulated clock, which may jump, waits for the final verdict on what is due.
            self._looked.wait(LOOK_S)
            return None

        self._news.loop(stop, look)
        for pool in (self._pool, self._storing):
            pool.shutdown(wait=False, cancel_futures=True)

    def _look_around(self) -> bool:
        """Begin the looks that are due; returns whether a verdict is due on any of them."""
        now_s = time.monotonic()
        with self._lock:
            overdue = {key for key, one in self._sought.items() if self._verdict_is_due(one.task)}
            begun = [
                one
                for key, one in self._sought.items()
                if not one.busy and (one.due_s <= now_s or key in overdue)
            ]
            for one in begun:
                one.busy = True
        for one in begun:
            self._pool.submit(self._look, one)
        return bool(overdue)

    def _first_due_s(self) -> float | None:
        """Site time of the first verdict that is due on what is looked for; None where none is."""
        with self._lock:
            times = (due_s(one.task, self._site) for one in self._sought.values())
            return min((time_s for time_s in times if time_s is not None), default=None)

    def keys(self) -> set[tuple[int, int]]:
        """Submissions whose proof is looked for."""
        with self._lock:
            return set(self._sought)

    def copy(self, key: tuple[int, int]) -> Path | None:
        """The proof itself, if it had to be looked for and was found."""
        with self._lock:
            return ended if isinstance(ended := self._ended.get(key), Path) else None

    def last_word(self, key: tuple[int, int]) -> Report | None:
        """The report on a proof that was unavailable."""
        with self._lock:
            return ended if isinstance(ended := self._ended.get(key), Report) else None

    def forget(self, key: tuple[int, int]) -> None:
        """Forget a submission that has its verdict, or is looked for anew."""
        with self._lock:
            self._sought.pop(key, None)
            ended = self._ended.pop(key, None)
        if isinstance(ended, Path):
            shutil.rmtree(ended.parent, ignore_errors=True)

    def summary(self) -> list[str]:
        """A sentence for each proof that is looked for."""
        with self._lock:
            return [
                f"task {one.task.id} attempt {one.task.attempt} waits for its proof: {one.why}"
                for one in self._sought.values()
            ]

    @property
    def unreadable(self) -> str:
        """Why the store cannot be read, if a proof waits for that."""
        with self._lock:
            return next((one.why for one in self._sought.values() if one.owner == "store"), "")

    # -- one look --------------------------------------------------------------------------------------

    def _look(self, one: _Sought) -> None:
        task = one.task
        key = task.id, task.attempt
        with about_task(task.id):
            try:
                if not self._waits(*key):
                    self.forget(key)
                    return
                ended = self._obtain(one) or self._last_word(one)
            except Exception:
                # The next look must come whatever happened in this one.
                log.exception("looking for the proof of task %d attempt %d failed", *key)
                ended = None
            with self._clock.hold():
                with self._lock:
                    one.busy = False
                    one.due_s = time.monotonic() + one.pause_s
                    one.pause_s = min(2 * one.pause_s, _PAUSE_S[1])
                    ends = ended is not None and self._sought.get(key) is one
                    if ended is not None and ends:
                        del self._sought[key]
                        self._ended[key] = ended
                if not (ends and isinstance(ended, Path)):
                    shutil.rmtree(one.folder, ignore_errors=True)
                if not ends:
                    return
                said = ended.reason if isinstance(ended, Report) else "the executor sent the proof"
                log.info("task %d attempt %d: %s", *key, said)
                self._found(*key)
            self._looked.set()

    def _obtain(self, one: _Sought) -> Path | None:
        """The proof, from the store or from its executor; with None, `one` has the reason."""
        wanted = (one.task.proof_sha256 or "").lower()
        try:
            if (path := self._fetch(one, wanted)) is not None:
                return path
            now_s = time.monotonic()
            if one.looked_s is not None and self._bus.connected and one.owner == "executor":
                one.asked_s += now_s - one.looked_s
            one.looked_s = now_s
            if ask_to_put(self._bus, self._site.org, wanted) and (path := self._fetch(one, wanted)):
                return path
            one.folder.mkdir(parents=True, exist_ok=True)
            path = one.folder / f"{wanted.removeprefix('0x')}.mcap"
            if hand_over(self._bus, self._site.org, wanted, path, self._site.store.max_bytes):
                self._storing.submit(self._put, self._kept(path))
                return path
            one.was_asked |= self._bus.connected
        except BusError as error:
            log.info("cannot ask for the proof: %s", error)
        except (OSError, DiskFull) as error:
            one.owner, one.why = "oracle", f"the oracle cannot store the proof: {error}"
        return None

    def _fetch(self, one: _Sought, wanted: str) -> Path | None:
        uri = self._store.whereabouts(one.task.proof_uri or "", wanted, ".mcap")
        try:
            return self._store.fetch(uri, wanted, folder=one.folder)
        except EvidenceError as error:
            one.why = in_words(error)
            one.owner = owner_of(error, one.task.proof_uri or "", self._site, self.stores)
        return None

    def _kept(self, path: Path) -> Path:
        """A link to the file, for the store: the file itself is removed with its verdict, maybe before."""
        kept = path.parent.with_suffix(".kept")
        kept.mkdir()
        os.link(path, kept / path.name)
        return kept / path.name

    def _put(self, path: Path) -> None:
        try:
            self._store.put(path)
        except EvidenceError as error:
            log.warning("the proof is verified, but cannot be stored: %s", error)
        finally:
            shutil.rmtree(path.parent, ignore_errors=True)

    # -- patience --------------------------------------------------------------------------------------

    def _last_word(self, one: _Sought) -> Report | None:
        """The report on a proof that the oracle waits for no longer; None while it still waits."""
        task, over = one.task, self._verdict_is_due(one.task)
        if one.owner == "executor" and (over or one.asked_s >= self._site.oracle.handover_s):
            asked = "did not send it when asked" if one.was_asked else "could not be asked"
            detail = f"{one.why}; the executor {asked}"
            fault = None if one.was_asked else FAULT
        elif over and one.owner != "executor":
            detail = f"the oracle could not read it before the verdict was due: {one.why}"
            fault = "the store" if one.owner == "store" else FAULT
        else:
            return None
        check = Check(
            name="fetched", passed=False, source=quoted(task.proof_uri or ""), detail=detail, fault=fault
        )
        return report_on(task, check)

    def _verdict_is_due(self, task: Task) -> bool:
        return is_due(task, self._site, self._clock)


def due_s(task: Task, site: Site, patience: float = 1.0) -> float | None:
    """Site time from which the verdict on a task cannot wait any longer, or its window passes without one;
    None where no window runs. Where the verdict window has passed already, the case has to end. `patience`:
    the share of the usual time before the end that the caller needs. A verdict that can be challenged comes
    early enough for all that may follow."""
    end_s = task.case_end if task.state == "ruled" else task.verdict_deadline
    if end_s is None:
        return None
    longest_s = 0 if site.disputes is None else site.disputes.longest_s
    if task.verdict_window_s < longest_s:
        longest_s = 0  # posted before there were challenges: judged at once
    margin_s = min(site.min_verdict_window_s, _MARGIN_SHARE * (task.verdict_window_s - longest_s))
    return end_s - longest_s - patience * margin_s


def is_due(task: Task, site: Site, clock: Clock, patience: float = 1.0) -> bool:
    """Whether the verdict on a task cannot wait any longer; `patience` as for `due_s`."""
    time_s = due_s(task, site, patience)
    try:
        return time_s is not None and clock.now_s() >= time_s
    except ClockUnavailable:
        return False


def owner_of(error: EvidenceError, uri: str, site: Site, stores: Callable[[], list[str]]) -> Owner:
    """The party that seems to be at fault for a proof that cannot be fetched."""
    if isinstance(error, StoreUnavailable):
        return "store"
    base = uri.rpartition("/")[0]
    if base in Store(site).urls:
        return "executor"
    try:
        return "oracle" if base in [url.rstrip("/") for url in stores()] else "executor"
    except RodeoError as error_:
        log.info("cannot ask the bridge for the site's stores: %s", error_)
        return "oracle"
