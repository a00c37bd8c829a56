"""Reports of verdicts: the oracle's own copies, and the acts that they say were paid for."""

from __future__ import annotations

import hashlib
import logging
import shutil
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rodeo.bus.messages import Task
from rodeo.checks.acts import ConsumedActs, Submission, Wait, acts_listed, acts_unspent
from rodeo.checks.report import Check, Report
from rodeo.errors import DiskFull
from rodeo.evidence.errors import EvidenceError, ProofNotFound, ProofUriNotAllowed, StoreUnavailable
from rodeo.evidence.store import Store
from rodeo.host.clocked import ClockedEvent, Rest
from rodeo.host.files import replace_file, writing
from rodeo.runtime.process import Process
from rodeo.text.foreign_text import in_words
from services.oracle.away import due_s, is_due

log = logging.getLogger(__name__)

PROMISED = "promised.json"
"""File of the oracle's folder with what submissions may be paid for."""
RETRY_S = 1.0
"""Wall time between attempts to reach the bridge or the store."""
_LATE = 0.5
"""Share of the margin before its window's end from which a verdict waits for no promise to others."""
_REPORT_BYTES = 16 << 20


class Reports:
    """Keeps the reports of this oracle and reads those of others, to know which acts were paid for."""

    def __init__(self, process: Process, acts: ConsumedActs) -> None:
        self._site, self._clock, self._stop = process.site, process.clock, process.stop
        self._acts = acts
        self._seen = 0
        """Up to which news of acts `run` has looked."""
        self._news = ClockedEvent(process.clock, lambda: self._has_news(self._seen))
        self.store = Store(process.site)
        self.folder = process.data_dir / "reports"
        """Own copies: a store that loses a report must keep nobody waiting."""
        self._promised, self._writing = process.data_dir / PROMISED, threading.Lock()
        self._reading = process.data_dir / "reading"
        shutil.rmtree(self._reading, ignore_errors=True)  # of a process that was killed

    def keep(self, task: Task, report: Report) -> tuple[str, str]:
        """Where the report is in the store, and its hash. A store that takes nothing until the verdict is due
        gets the report later: the executor must not lose its pay by that. What it may be paid for is kept,
        too: a process that ends before the ruling is on chain must promise that to nobody else.

        Raises StoreUnavailable, DiskFull.
        """
        data = report.to_bytes()
        sha256 = hashlib.sha256(data).hexdigest()
        own = self.folder / f"{sha256}.json"
        with writing(own):
            own.parent.mkdir(parents=True, exist_ok=True)
            replace_file(own, data.decode())
        with self._writing:
            promised = self._acts.promised().model_dump_json()
            if not self._promised.exists() or self._promised.read_text() != promised:
                replace_file(self._promised, promised)
        try:
            uri = self.store.put(own)
        except EvidenceError as error:
            if not is_due(task, self._site, self._clock):
                raise StoreUnavailable("the store does not keep the report", cause=in_words(error)) from error
            log.error("the verdict is due, but the store does not accept its report: %s", error)
            uri = self.store.uri_of(sha256, ".json")
        self._acts.read("0x" + sha256, report.acts)
        return uri, "0x" + sha256

    def unspent(
        self, task: Task, claimed: list[str], newest: Callable[[], int | None], tell: Callable[[str], None]
    ) -> Check | None:
        """The check that nobody was paid before for the acts that a proof claims; None if no verdict is
        needed any more. `newest` asks for the number of the last event, and `tell` gets the reason why it
        waits.

        Waits until all events were heard, for the verdicts of earlier submissions that may
        claim one of these acts, too, and for reports that cannot be fetched. Once the verdict is due it waits
        no longer for what others have in line: an executor with many proofs must not cost others the pay.
        """
        key = task.id, task.attempt
        said: str | None = None
        while not self._stop.is_set():
            news = self._acts.news
            if not self._acts.waits(*key):
                log.info("task %d attempt %d was decided meanwhile", *key)
                return None
            if (last := newest()) is None:
                return None
            if not self._acts.heard(last, RETRY_S):
                tell(f"task {task.id} waiting for events up to number {last}")
                continue
            due = is_due(task, self._site, self._clock)
            late = due and is_due(task, self._site, self._clock, _LATE)
            found = self._acts.spent(*key, claimed, due=due, late=late, newest=last)
            if not isinstance(found, Wait):
                return acts_unspent(claimed, found)
            why = f"waiting for task {found.on.task_id} attempt {found.on.attempt}: {found.why}"
            if why != said:
                log.warning("task %d attempt %d: %s", *key, why)
                tell(f"task {task.id} {why}")
                said = why
            # A clock that jumped to the end of the window would leave no time for the report.
            until_s = None if late else due_s(task, self._site, _LATE if due else 1.0)
            # No simulated clock waits meanwhile: the awaited event may be that something is due.
            more = ClockedEvent(self._clock, partial(self._has_news, news))
            more.wait(self._stop, until_s=until_s, resting=not due)
        return None

    def _has_news(self, since: int) -> bool:
        return self._acts.news != since

    def run(self) -> None:
        """Read the reports on work that was paid for, or may be paid for, as soon as they are announced."""
        self._news.loop(self._stop, self._look)

    def _look(self) -> Rest | None:
        self._seen = self._acts.news
        missing = [one for one in self._acts.unread() if not self._read(one)]
        if not missing:
            return Rest()
        # Submissions that wait for these reports have their own timers.
        self._news.pause(self._stop, wall_s=RETRY_S, resting=True)
        return None

    def _read(self, submission: Submission) -> bool:
        """Learn the acts that a submission's reports list; False while a report cannot be fetched."""
        for uri, sha256 in submission.reports:
            if self._acts.is_read(sha256):
                continue
            try:
                data = self._fetch(uri, sha256)
            except (EvidenceError, DiskFull, OSError) as error:
                log.warning(
                    "cannot read the report of task %d attempt %d; until then no proof is accepted that it "
                    "may have paid for: %s",
                    *submission.key,
                    error,
                )
                return False
            self._acts.read(sha256, acts_listed(data, sha256))
        return True

    def _fetch(self, uri: str, sha256: str) -> bytes:
        """Raises EvidenceError, DiskFull, OSError."""
        # The name is the content: a report that others keep elsewhere may be in our store, too.
        own = self.store.uri_of(sha256, ".json")
        kept = self.folder / f"{sha256.removeprefix('0x')}.json"
        if kept.is_file() and hashlib.sha256(data := kept.read_bytes()).hexdigest() == kept.stem:
            return data
        self._reading.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._reading) as folder:
            try:
                path = self.store.fetch(uri, sha256, _REPORT_BYTES, Path(folder))
            except (ProofUriNotAllowed, ProofNotFound):
                path = self.store.fetch(own, sha256, _REPORT_BYTES, Path(folder))
            return path.read_bytes()
