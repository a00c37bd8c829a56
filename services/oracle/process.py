"""The oracle's process: every submitted proof gets one ruling, whatever is in it, or is passed on.

Submissions are learnt from the event stream, read from its beginning at every start: that and the reports in
the store also tell which acts were paid for before (`rodeo.checks.acts`). Whether a submission still waits
for a ruling is asked from the index when its turn comes, so nothing needs to be remembered across restarts.
One on which nobody has ruled in the verdict window waits until its case ends.

Several proofs are verified side by side, and their providers take turns (`services.oracle.turns`). But of two
that claim the same act the one that was submitted earlier is decided first. Only what is due waits no longer
for proofs that others have in line: people decide on those of them that claim the same act.

Where a site has several oracles, each of them votes (`services.oracle.votes`) in place of ruling.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import TypeVar

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Task, Vote
from rodeo.bus.session import DaoEvents
from rodeo.checks.acts import ConsumedActs, Submission, Wait, acts_listed, acts_unspent
from rodeo.checks.report import Check, Report
from rodeo.commands.judging import Rule
from rodeo.dao import Participant
from rodeo.errors import BusError, DiskFull, RemoteError, RodeoError
from rodeo.evidence.errors import EvidenceError, ProofNotFound, ProofUriNotAllowed, StoreUnavailable
from rodeo.evidence.store import Store
from rodeo.host.files import replace_file, writing
from rodeo.kinds import Kinds, kinds_of
from rodeo.runtime.logs import about_task
from rodeo.runtime.process import Process, repeated
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site, oracle_process
from rodeo.text.foreign_text import in_words
from services.oracle import worker
from services.oracle.away import FAULT, MissingProofs, ProofAway, due_s, is_due, owner_of
from services.oracle.chain_view import read_chain_record
from services.oracle.rules import Judging
from services.oracle.scrub import Scrub
from services.oracle.turns import Key, Turns
from services.oracle.votes import Votes

log = logging.getLogger(__name__)

RETRY_S = 1.0
"""Wall time between attempts to reach the bridge or the store."""
SIDE_BY_SIDE = max(2, (os.cpu_count() or 1) - 1)
"""Proofs verified at the same time; one core stays for everybody else, but none waits for one that hangs."""
SWEEP_S = 30.0
"""Wall time between two looks for submissions that got no verdict, whatever kept them from it."""
_REPORT_BYTES = 16 << 20

_NO_MORE = frozenset({"case_over", "passed_on_before", "not_judge", "not_a_judge"})
"""What is answered when this oracle cannot rule any more, and others may."""
_DECIDED = _NO_MORE | {"wrong_state", "wrong_attempt"}
"""The same, and when the attempt has ended."""

Answer = TypeVar("Answer")


class IndexBehind(RodeoError):
    """The bridge's answer is older than an event that it told before."""


def run(site: Site, name: str, stop: threading.Event) -> None:
    """The process of the oracle called `name`, until `stop`."""
    with Process(oracle_process(site, name), site, stop) as process:
        process.serve_alone(served_by(site, process.name))
        Oracle(process, name).serve()


class Oracle:
    def __init__(self, process: Process, name: str) -> None:
        self._process = process
        self._site = process.site
        self._stop = process.stop
        self._store = Store(process.site)
        self._wallet = Participant(process.bus, process.site.org, name)
        self._kinds = kinds_of(process.site)
        self._clock = process.clock
        self._turns = Turns(process.clock, SIDE_BY_SIDE)
        self._words = Turns(process.clock, 1)
        """Last words: what needs no verification waits for none."""
        self._late: set[Key] = set()
        """Submissions in line whose verdict is due."""
        self._acts = ConsumedActs(process.clock.notify)
        self._running: dict[Key, str] = {}
        self._in_work: set[Key] = set()
        """Submissions that are in line or being decided."""
        self._once_more: dict[Key, bool] = {}
        """Submissions in work of which something was found during their turn; whether it is their last
        word."""
        self._failed = Counter[Key]()
        """How many verifications of a submission ended without a report."""
        self._decided = 0
        self._for_auditors: set[Key] = set()
        """Submissions that were left to auditors since the start."""
        self._abstained: set[Key] = set()
        """Submissions that this oracle leaves to the others, since the start."""
        self._chain = ""
        """Genesis hash of the chain that they are on."""
        self._missing = MissingProofs(
            process.site,
            process.bus,
            self._clock,
            process.data_dir / "proofs",
            self._enqueue,
            self._waits,
            lambda: self._wallet.ask(queries.CHAIN).stores,
        )
        self._judging = Judging(process.site, self._clock, partial(self._enqueue, word=True), self._waits)
        self._told: list[str] = []
        """What is open, as told last."""
        self._reports = process.data_dir / "reports"
        """Own copies: a store that loses one must not keep anybody waiting."""
        self._scrub = Scrub(
            process.site,
            process.bus,
            process.data_dir,
            self._reports,
            self._acts.judged_files,
            partial(process.concern, "store"),
        )
        self._lock = threading.Lock()
        self._telling = threading.Lock()
        """Held while the status is published: else an older one could come last, and would stay."""
        self._votes: Votes | None = None
        """None where this oracle's verdict is enough."""
        if process.site.oracles:
            self._votes = Votes(
                process.site,
                name,
                process.wait_account(f"{name}-device"),
                process.bus,
                self._wallet,
                self._clock,
                self._waits,
                lambda: self._set_activity(None, None),
            )

    def serve(self) -> None:
        # The first verdict must not wait for what all of them share.
        self._judging.begin(worker.start(self._site))
        events = DaoEvents(self._process.bus, self._site.org, self._on_event, clock=self._clock)
        runs: dict[str, Callable[[], None]] = {
            "turns": partial(self._turns.run, self._stop, self._work),
            "words": partial(self._words.run, self._stop, self._work),
            "reports": self._read_reports,
            "scrub": partial(self._scrub.run, self._stop),
            "sweep": self._sweep,
            "rules": partial(self._judging.run, self._stop),
            "missing": partial(self._missing.run, self._stop, self._update_status),
        }
        if self._votes is not None:
            runs["votes"] = partial(self._votes.run, self._stop)
        threads = [threading.Thread(target=run, name=name, daemon=True) for name, run in runs.items()]
        for thread in threads:
            thread.start()
        self._process.ready()
        self._stop.wait()
        events.close()
        for thread in threads:
            thread.join(timeout=2 * RETRY_S)

    def _on_event(self, event: DaoEvent) -> None:
        if event.chain != self._chain:
            with self._lock:
                self._chain = event.chain
                self._for_auditors.clear()
                self._abstained.clear()
                self._failed.clear()
            if self._votes is not None:
                self._votes.forget_all()
        self._acts.on_event(event)
        self._judging.on_event(event)
        if event.name == "ProofSubmitted" and event.task_id is not None:
            self._enqueue(event.task_id, int(event.args["attempt"]), again=False)

    def _enqueue(self, task_id: int, attempt: int, *, again: bool = True, word: bool = False) -> None:
        """In line, if it is not yet; during its turn: once more after it. `word`: for its last word."""
        key = task_id, attempt
        submission = self._acts.submission(*key)
        with self._lock:
            if key in self._in_work:
                self._once_more[key] = word or self._once_more.get(key, False)
                return
            self._in_work.add(key)
        turns = self._words if word or self._missing.last_word(key) is not None else self._turns
        turns.put(key, "" if submission is None else submission.executor, again=again)

    def _waits(self, task_id: int, attempt: int) -> bool:
        submission = self._acts.submission(task_id, attempt)
        return submission is not None and submission.waits

    def _update_status(self) -> None:
        """Whether the store can be read, as far as a proof waits for it, which proofs are looked for, and how
        many tasks need which rules."""
        if unreadable := self._missing.unreadable:
            self._process.not_ready(f"the store cannot be read: {unreadable}")
        else:
            self._process.ready()
        self._process.concern("rules", self._judging.lacking())
        if self._open() != self._told:
            self._set_activity(None, None)

    def _sweep(self) -> None:
        while not self._stop.wait(SWEEP_S):
            with self._lock:
                known = self._in_work | self._for_auditors | self._missing.keys() | self._judging.keys()
            if self._votes is not None:
                known |= self._votes.keys() | self._abstained
            for submission in self._acts.waiting():
                if submission.key not in known:
                    log.warning(
                        "task %d attempt %d has no verdict yet; looking again",
                        submission.task_id,
                        submission.attempt,
                    )
                    self._enqueue(*submission.key)
            self._tell_late()

    def _tell_late(self) -> None:
        """Say of which submissions the verdict is due, or the window has ended, before their turn."""
        try:
            in_line = [self._wallet.task(key[0]) for key in self._turns.waiting() if self._waits(*key)]
        except (BusError, RemoteError) as error:
            log.info("cannot ask what is due: %s", error)
            return
        late = {(one.id, one.attempt) for one in in_line if is_due(one, self._site, self._clock)}
        for key in late - self._late:
            log.warning("task %d attempt %d is due, and its turn to be verified has not come", *key)
        for key in self._late - late:
            submission = self._acts.submission(*key)
            if submission is not None and submission.over and submission.ruling is None:
                log.warning("task %d attempt %d: its window ended before it was verified", *key)
        self._late = late
        said = f"{len(late)} of {len(in_line)} proofs in line are due: too many to verify them in time"
        self._process.concern("turns", said if late else "")

    # -- verdicts --------------------------------------------------------------------------------------

    def _work(self, key: Key, leave: Callable[[], None]) -> None:
        task_id, attempt = key
        failed = self._failed[key]
        with self._lock:
            # This turn sees what was found before it.
            self._once_more.pop(key, None)
        with about_task(task_id):
            try:
                self._decide(task_id, attempt, leave)
            except worker.VerificationFailed:
                self._failed[key] += 1
            except Exception:
                # The next proof must get its verdict whatever happened to this one.
                log.exception("task %d attempt %d got no verdict", task_id, attempt)
                self._acts.judged(task_id, attempt, None)
            finally:
                with self._lock:
                    self._in_work.discard(key)
                    word = self._once_more.pop(key, None)
                self._set_activity(key, None)
            if word is not None or self._failed[key] > failed:
                self._enqueue(*key, word=bool(word))

    def _decide(self, task_id: int, attempt: int, leave: Callable[[], None]) -> None:
        """Verify one submission and post the verdict, unless it has one. Waits for bridge and store and,
        after its turn, for earlier submissions; `leave` ends its turn."""
        key = task_id, attempt
        if not self._waits(*key):
            self._missing.forget(key)
            self._judging.forget(key)
            return
        try:
            found = self._until_answered(lambda: self._verified(task_id, attempt))
        except ProofAway as away:
            self._acts.away(*key, True)
            self._missing.seek(away.task, away)
            return
        leave()
        if found is None:
            return
        self._acts.away(*key, False)
        task, report = found
        may_be_paid = report.outcome in ("accepted", "undecided")  # people may accept what is undecided
        self._acts.judged(task_id, attempt, report.acts if may_be_paid else [])
        if may_be_paid:
            check = self._unspent(task, report.acts)
            if check is None:
                return
            report = report.with_checks(check)
        log.info("task %d attempt %d: %s", task_id, attempt, report.reason)
        if report.outcome == "given_up" and report.fault == FAULT:
            self._process.concern(
                "unforeseen",
                f"task {task_id} attempt {attempt} could not be judged, which the checks do not foresee: "
                f"{report.reason}",
            )
        stored = self._until_answered(lambda: self._stored(task, report), task)
        if stored is None:
            return
        uri, sha256 = stored
        self._acts.read(sha256, report.acts)
        say = self._post if self._votes is None else partial(self._vote, self._votes)
        self._until_answered(lambda: say(task, report, sha256, uri))
        self._missing.forget(key)
        self._decided += 1

    def _stored(self, task: Task, report: Report) -> tuple[str, str]:
        """Where the report is in the store, and its hash. A store that takes nothing until the verdict is due
        gets the report later: the executor must not lose its pay by that.

        Raises StoreUnavailable, DiskFull.
        """
        data = report.to_bytes()
        sha256 = hashlib.sha256(data).hexdigest()
        own = self._reports / f"{sha256}.json"
        with writing(own):
            own.parent.mkdir(parents=True, exist_ok=True)
            replace_file(own, data.decode())
        try:
            return self._store.put(own), "0x" + sha256
        except StoreUnavailable as error:
            if not is_due(task, self._site, self._clock):
                raise
            log.error("the verdict is due, but the store does not accept its report: %s", error)
            return self._store.uri_of(sha256, ".json"), "0x" + sha256

    def _verified(self, task_id: int, attempt: int) -> tuple[Task, Report] | None:
        """What verification says; None when the submission is not ours to judge, or no longer waits.

        Raises ProofAway, DiskFull, BusError, RemoteError or IndexBehind.
        """
        submission = self._acts.submission(task_id, attempt)
        if submission is None or not submission.waits:
            return None
        chain_record = read_chain_record(self._wallet, task_id)
        if chain_record.task.attempt < attempt or (
            chain_record.task.attempt == attempt and chain_record.task.state == "assigned"
        ):
            raise IndexBehind(
                "the bridge's index does not know of the submission yet",
                task_id=task_id,
                attempt=attempt,
                state=chain_record.task.state,
                submitted_in_block=submission.block,
            )
        if chain_record.task.state not in ("submitted", "ruled") or chain_record.task.attempt != attempt:
            return None
        if not is_ours(self._kinds, chain_record.task):
            log.info(
                "task %d attempt %d of %s waits for an auditor",
                task_id,
                attempt,
                chain_record.task.kind,
            )
            self._acts.judged(task_id, attempt, None)
            with self._lock:
                self._for_auditors.add((task_id, attempt))
            return None
        if not self._judging.has(chain_record.task.kind, chain_record.task.rules_sha256):
            return self._left(chain_record.task)
        key = task_id, attempt
        if (last_word := self._missing.last_word(key)) is not None:
            return chain_record.task, last_word
        self._set_activity(key, f"verifying task {task_id}")
        scratch = self._process.data_dir / "verifying"
        copy = self._missing.copy(key)
        try:
            report = worker.verify_apart(
                self._site, chain_record, scratch, self._stop, copy=copy, failed=self._failed[key]
            )
        except EvidenceError as error:
            owner = owner_of(error, chain_record.task.proof_uri or "", self._site, self._missing.stores)
            raise ProofAway(in_words(error), task=chain_record.task, owner=owner) from error
        if report is None:
            return None
        if report.rules_sha256 != chain_record.task.rules_sha256:
            log.error("the checks judge by %s since this oracle was started: restart it", report.rules_sha256)
            return self._left(chain_record.task)
        return chain_record.task, report

    def _left(self, task: Task) -> tuple[Task, Report] | None:
        """What is said of a submission by rules that are not had here; None while others may judge it."""
        last_word = self._judging.leave(task)
        # Its own executor's later ones wait for that judge; nobody else's do.
        self._acts.away(task.id, task.attempt, True)
        return None if last_word is None else (task, last_word)

    def _post(self, task: Task, report: Report, report_sha256: str, report_uri: str) -> bool:
        """Rule, or pass the case on; False when others did meanwhile."""
        rule = Rule(
            # A verification repeated after a crash may find other words for the same proof.
            request_id=f"rule-{task.id}-{task.attempt}-{report_sha256}",
            task_id=task.id,
            attempt=task.attempt,
            proof_sha256=task.proof_sha256 or "",
            ruling=report.outcome,
            fault=report.party,
            amount_iec=_amount_iec(task, report),
            reason=report.reason,
            rules_sha256=report.rules_sha256,
            report_sha256=report_sha256,
            report_uri=report_uri,
        )
        try:
            self._wallet.command("rule", rule)
        except RemoteError as error:
            if error.code not in _DECIDED:
                raise
            log.info("task %d attempt %d was decided meanwhile: %s", task.id, task.attempt, error)
            self._acts.judged(task.id, task.attempt, None)
            if error.code in _NO_MORE:
                with self._lock:
                    self._for_auditors.add((task.id, task.attempt))
            return False
        return True

    def _vote(self, votes: Votes, task: Task, report: Report, report_sha256: str, report_uri: str) -> bool:
        """Vote for the ruling; False when this oracle abstains, because it alone could not judge."""
        if report.fault == FAULT and report.outcome == "undecided":
            log.warning("task %d attempt %d: abstaining: %s", task.id, task.attempt, report.reason)
            with self._lock:
                self._abstained.add((task.id, task.attempt))
            return False
        vote = Vote(
            task_id=task.id,
            attempt=task.attempt,
            proof_sha256=task.proof_sha256 or "",
            report_sha256=report_sha256,
            rules_sha256=report.rules_sha256 or "",
            ruling=report.outcome,
            fault=report.party,
            amount_iec=_amount_iec(task, report) or Decimal(0),
            reason=report.reason,
        )
        votes.cast(task, vote, report_uri)
        return True

    # -- acts ------------------------------------------------------------------------------------------

    def _unspent(self, task: Task, claimed: list[str]) -> Check | None:
        """Whether what a proof claims was not paid for before, as a check; None when there is nobody to tell.

        Waits while that cannot be told: for the verdicts of earlier submissions that may claim it, too, and
        for reports that cannot be fetched. Once the verdict is due it waits no longer for what others have in
        line: who hands in many proofs must not cost anybody else the pay.
        """
        key = task.id, task.attempt
        said: str | None = None
        while not self._stop.is_set():
            news = self._acts.news
            submission = self._acts.submission(*key)
            if submission is None or not submission.waits:
                log.info("task %d attempt %d was decided meanwhile", *key)
                return None
            due = is_due(task, self._site, self._clock)
            found = self._acts.spent(*key, claimed, due=due)
            if not isinstance(found, Wait):
                return acts_unspent(claimed, found)
            why = f"waiting for task {found.on.task_id} attempt {found.on.attempt}: {found.why}"
            if why != said:
                log.warning("task %d attempt %d: %s", *key, why)
                self._set_activity(key, f"task {task.id} {why}")
                said = why
            # A clock that jumped to the end of the window would leave no time for the report.
            until_s = None if due else due_s(task, self._site)
            self._wait_for_news(news, until_s, resting=not due)
        return None

    def _wait_for_news(self, news: int, until_s: float | None = None, *, resting: bool = True) -> None:
        """Until more was learnt of acts than when `news` was asked for, or `until_s`. No simulated clock
        waits meanwhile: what is waited for may be that something is due."""
        self._clock.wait_for(lambda: self._acts.news != news, self._stop, until_s=until_s, resting=resting)

    def _read_reports(self) -> None:
        """Read the reports of what was paid for, or may be, as soon as they are heard of."""
        with self._clock.acting():
            while not self._stop.is_set():
                news = self._acts.news
                missing = [one for one in self._acts.unread() if not self._read(one)]
                if missing:
                    # Who waits for what they list is woken itself when it is due.
                    self._clock.wait_for(lambda: False, self._stop, wall_s=RETRY_S, resting=True)
                else:
                    self._wait_for_news(news)

    def _read(self, submission: Submission) -> bool:
        """Learn the acts that a submission's reports list; False while one cannot be had."""
        for uri, sha256 in submission.reports:
            if self._acts.is_read(sha256):
                continue
            try:
                data = self._fetch_report(uri, sha256)
            except EvidenceError as error:
                log.warning(
                    "cannot read the report of task %d attempt %d; until then no proof is accepted that it "
                    "may have paid for: %s",
                    submission.task_id,
                    submission.attempt,
                    error,
                )
                return False
            self._acts.read(sha256, acts_listed(data, sha256))
        return True

    def _fetch_report(self, uri: str, sha256: str) -> bytes:
        """Raises EvidenceError."""
        # The name is the content: a report that others keep elsewhere may be in our store, too.
        own = self._store.uri_of(sha256, ".json")
        kept = self._reports / f"{sha256.removeprefix('0x')}.json"
        if kept.is_file() and hashlib.sha256(data := kept.read_bytes()).hexdigest() == kept.stem:
            return data
        with tempfile.TemporaryDirectory() as folder:
            try:
                path = self._store.fetch(uri, sha256, _REPORT_BYTES, Path(folder))
            except (ProofUriNotAllowed, ProofNotFound):
                path = self._store.fetch(own, sha256, _REPORT_BYTES, Path(folder))
            return path.read_bytes()

    # -- what all of it needs --------------------------------------------------------------------------

    def _until_answered(self, ask: Callable[[], Answer], task: Task | None = None) -> Answer | None:
        """The answer of `ask`, repeated while bridge or store are away or behind, or the disk is full, and
        once the verdict on `task` is due; None when stopped."""

        def wait(error: RodeoError) -> None:
            away = isinstance(error, BusError | StoreUnavailable | DiskFull | IndexBehind)
            # A bridge that fails at one task must not keep the places of all others.
            if not (away or (isinstance(error, RemoteError) and error.passes and error.code != "internal")):
                raise error
            log.warning("waiting: %s", error)
            self._pause(task)

        return repeated(ask, wait, self._stop)

    def _pause(self, task: Task | None = None) -> None:
        """Before the next attempt. No simulated clock waits meanwhile. It may jump to when `task` is due, but
        not where that is unknown or past: a window would end."""
        until_s = None if task is None or is_due(task, self._site, self._clock) else due_s(task, self._site)
        self._clock.wait_for(
            lambda: False, self._stop, until_s=until_s, wall_s=RETRY_S, resting=until_s is not None
        )

    def _open(self) -> list[str]:
        """A sentence for each proof that is looked for, and for the open tasks of each of the rules."""
        return [*self._missing.summary(), *self._judging.summary()]

    def _set_activity(self, key: tuple[int, int] | None, activity: str | None) -> None:
        """What is done about the submission `key` now; None of either where nothing is."""
        with self._telling:
            with self._lock:
                if key is not None and activity is not None:
                    self._running[key] = activity
                elif key is not None:
                    self._running.pop(key, None)
                for_auditors = len(self._for_auditors)
                running = list(self._running.values())
            votes = self._votes
            self._told = self._open()
            said = [*running, *self._told]
            if votes is not None:
                said += votes.summary()
            details = {} if votes is None else {"votes": votes.held()}
            self._process.activity(
                ", ".join(said) or "idle",
                None,
                decided=self._decided,
                for_auditors=for_auditors,
                rules=self._judging.open_tasks(),
                **details,
            )


def is_ours(kinds: Kinds, task: Task) -> bool:
    """Whether oracles judge this task, as the organization's rules were when it was posted. Never where the
    oracle has no checks of its own, whatever those say, nor once the right to judge was taken from them."""
    return not kinds.by_people(task.kind) and task.judge == "oracle" and not task.judge_removed


def _amount_iec(task: Task, report: Report) -> Decimal | None:
    """What an accepted proof is paid: what its report says, which may be nothing, else the full price."""
    if not report.accepted:
        return None
    return task.price_iec if report.amount_iec is None else report.amount_iec
