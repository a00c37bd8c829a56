"""The oracle's process: every submitted proof gets one ruling, whatever is in it, or is passed on.

Submissions are learnt from the event stream, read from its beginning at every start: that and the reports in
the store also show which acts were paid for before (`rodeo.checks.acts`). Whether a submission still waits
for a ruling is asked from the index when its turn comes, so nothing needs to be remembered across restarts.
One on which nobody has ruled in the verdict window waits until its case ends.

Several proofs are verified side by side, and their providers take turns (`services.oracle.turns`). But of two
that claim the same act the one that was submitted earlier is decided first. A submission that is due waits no
longer for proofs that others have in line: people decide on those that claim the same act.

Where a site has several oracles, each of them votes (`services.oracle.votes`) in place of ruling.
"""

from __future__ import annotations

import logging
import os
import shutil
import threading
from collections.abc import Callable
from decimal import Decimal
from functools import partial
from typing import TypeVar

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Task, Vote
from rodeo.bus.session import DaoEvents
from rodeo.checks.acts import ConsumedActs, Promised
from rodeo.checks.report import Report
from rodeo.commands.judging import Rule
from rodeo.dao import Participant
from rodeo.errors import BusError, RemoteError, RodeoError
from rodeo.evidence.errors import EvidenceError, StoreUnavailable
from rodeo.host.files import read_model
from rodeo.jobs import apart
from rodeo.jobs.apart import FAULT
from rodeo.kinds import Kinds, kinds_of
from rodeo.runtime.process import Process, is_transient, repeated
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site
from rodeo.site.names import oracle_process
from rodeo.text.foreign_text import in_words
from services.oracle.away import MissingProofs, ProofAway, due_s, is_due, owner_of
from services.oracle.chain_view import read_chain_record
from services.oracle.reports import PROMISED, RETRY_S, Reports
from services.oracle.rules import Judging
from services.oracle.scrub import Scrub
from services.oracle.status import Status
from services.oracle.turns import Key, Line
from services.oracle.voters import Voters
from services.oracle.votes import Votes

log = logging.getLogger(__name__)

SIDE_BY_SIDE = max(2, (os.cpu_count() or 1) - 1)
"""Proofs verified at the same time; one core stays free for all else, and no proof waits for one that
hangs."""
SWEEP_S = 30.0
"""Wall time between two looks for submissions that got no verdict, whatever kept them from it."""

_VERIFYING = "verifying"
"""Folder for children's files, in the oracle's own."""
_NO_MORE = frozenset({"case_over", "passed_on_before", "not_judge", "not_a_judge"})
"""Errors when this oracle cannot rule any more, and others may."""
_DECIDED = _NO_MORE | {"wrong_state", "wrong_attempt"}
"""Errors when this oracle cannot rule any more, or when the attempt has ended."""

Answer = TypeVar("Answer")


class PromisesLost(RodeoError):
    """The file that says what submissions may be paid for is damaged."""

    restart_cures = False


class IndexBehind(RodeoError):
    """The bridge's answer is older than an event that it published before."""


def run(site: Site, name: str, stop: threading.Event) -> None:
    """The process of the oracle called `name`, until `stop`."""
    with Process(oracle_process(site, name), site, stop) as process:
        process.serve_alone(served_by(site, process.name))
        Oracle(process, name, Participant(process.bus, site.org, name)).serve()


class Oracle:
    """Decides every submission once: verifies it, rules or votes, or leaves it to others."""

    def __init__(self, process: Process, name: str, wallet: Participant) -> None:
        self.process, self._wallet = process, wallet
        self._site, self._kinds, self._clock = process.site, kinds_of(process.site), process.clock
        words = (
            "cannot read what may be paid for; delete the file once the chain has all rulings of this oracle"
        )
        promised = read_model(Promised, process.data_dir / PROMISED, PromisesLost, words)
        self.acts = ConsumedActs(self._clock.notify, promised)
        self.reports = Reports(process, self.acts)
        self.line = Line(
            self._clock,
            SIDE_BY_SIDE,
            self.acts,
            lambda key: self.missing.last_word(key) is not None,
            self._decide,
            lambda key: self.status.publish(key),
        )
        self.missing = MissingProofs(
            self._site,
            process.bus,
            self._clock,
            process.data_dir / "proofs",
            self.line.put,
            self.acts.waits,
            lambda: wallet.ask(queries.CHAIN).stores,
        )
        self.judging = Judging(self._site, self._clock, partial(self.line.put, word=True), self.acts.waits)
        self.status = Status(process, self.missing, self.judging)
        shutil.rmtree(process.data_dir / _VERIFYING, ignore_errors=True)  # of a process that was killed
        self._late: set[Key] = set()
        """Submissions in line whose verdict is due."""
        self._abstained: set[Key] = set()
        """Submissions that this oracle leaves to the others, since the start."""
        self._chain = ""
        """Genesis hash of the chain that they are on."""
        self._lock = threading.Lock()
        if self._site.oracles:  # else this oracle's verdict is enough
            self.status.votes = Votes(
                self._site,
                name,
                Voters(self._site, process.wait_account(f"{name}-device"), wallet),
                process.bus,
                wallet,
                self._clock,
                self.acts.waits,
                self.status.publish,
            )

    def serve(self) -> None:
        # The first verdict must not wait for what all of them share.
        self.judging.begin(apart.start(self._site))
        events = DaoEvents(self.process.bus, self._site.org, self.on_event, clock=self._clock)
        threads = [threading.Thread(target=run, name=name, daemon=True) for name, run in self.loops().items()]
        for thread in threads:
            thread.start()
        self.process.ready()
        self.process.stop.wait()
        events.close()
        for thread in threads:
            thread.join(timeout=2 * RETRY_S)

    def loops(self) -> dict[str, Callable[[], None]]:
        """Loops that run side by side until the process ends."""
        stop, process = self.process.stop, self.process
        scrub = Scrub(
            self._site,
            process.bus,
            process.data_dir,
            self.reports.folder,
            self.acts.judged_files,
            partial(process.notices.concern, "store"),
        )
        runs: dict[str, Callable[[], None]] = {
            "turns": partial(self.line.turns.run, stop, self.line.work),
            "words": partial(self.line.words.run, stop, self.line.work),
            "reports": self.reports.run,
            "scrub": partial(scrub.run, stop),
            "sweep": self._sweep,
            "rules": partial(self.judging.run, stop),
            "missing": partial(self.missing.run, stop, self.status.update),
        }
        if self.status.votes is not None:
            runs["votes"] = partial(self.status.votes.run, stop)
        return runs

    def on_event(self, event: DaoEvent) -> None:
        if event.chain != self._chain:
            with self._lock:
                self._chain = event.chain
                self.status.for_auditors.clear()
                self._abstained.clear()
                self.line.failed.clear()
            if self.status.votes is not None:
                self.status.votes.forget_all()
        self.acts.on_event(event)
        self.judging.on_event(event)
        if event.name == "ProofSubmitted" and event.task_id is not None:
            self.line.put(event.task_id, int(event.args["attempt"]), again=False)

    def _sweep(self) -> None:
        while not self.process.stop.wait(SWEEP_S):
            known = self.line.keys() | self.missing.keys() | self.judging.keys()
            with self._lock:
                known |= self.status.for_auditors
                if self.status.votes is not None:
                    known |= self.status.votes.keys() | self._abstained
            for submission in self.acts.waiting():
                if submission.key not in known:
                    log.warning("task %d attempt %d has no verdict yet; looking again", *submission.key)
                    self.line.put(*submission.key)
            self._tell_late()

    def _tell_late(self) -> None:
        """Report the submissions whose verdict is due, or whose window has ended, before their turn."""
        try:
            in_line = [
                self._wallet.task(key[0]) for key in self.line.turns.waiting() if self.acts.waits(*key)
            ]
        except (BusError, RemoteError) as error:
            log.info("cannot ask what is due: %s", error)
            return
        late = {(one.id, one.attempt) for one in in_line if is_due(one, self._site, self._clock)}
        for key in late - self._late:
            log.warning("task %d attempt %d is due, and its turn to be verified has not come", *key)
        for key in self._late - late:
            submission = self.acts.submission(*key)
            if submission is not None and submission.over and submission.ruling is None:
                log.warning("task %d attempt %d: its window ended before it was verified", *key)
        self._late = late
        said = f"{len(late)} of {len(in_line)} proofs in line are due: too many to verify them in time"
        self.process.notices.concern("turns", said if late else "")

    # -- verdicts --------------------------------------------------------------------------------------

    def _decide(self, key: Key, leave: Callable[[], None]) -> None:
        """Verify one submission and post the verdict, unless it has one. Waits for bridge and store and,
        after its turn, for earlier submissions; `leave` ends its turn."""
        task_id, attempt = key
        if not self.acts.waits(*key):
            self.missing.forget(key)
            self.judging.forget(key)
            return
        try:
            found = self._until_answered(lambda: self._verified(task_id, attempt))
        except ProofAway as away:
            self.acts.away(*key, True)
            self.missing.seek(away.task, away)
            return
        leave()
        if found is None:
            return
        self.acts.away(*key, False)
        task, report = found
        may_be_paid = report.outcome in ("accepted", "undecided")  # people may accept an undecided proof
        self.acts.judged(task_id, attempt, report.acts if may_be_paid else [])
        if may_be_paid:
            newest = partial(self._until_answered, lambda: self._wallet.ask(queries.CHAIN).last_seq, task)
            check = self.reports.unspent(task, report.acts, newest, partial(self.status.publish, key))
            if check is None:
                return
            report = report.with_checks(check)
        log.info("task %d attempt %d: %s", task_id, attempt, report.reason)
        if report.outcome == "given_up" and report.fault == FAULT:
            self.process.notices.concern(
                "unforeseen",
                f"task {task_id} attempt {attempt} could not be judged, which the checks do not foresee: "
                f"{report.reason}",
            )
        stored = self._until_answered(lambda: self.reports.keep(task, report), task)
        if stored is None:
            return
        uri, sha256 = stored
        votes = self.status.votes
        say = self._post if votes is None else partial(self._vote, votes)
        self._until_answered(lambda: say(task, report, sha256, uri))
        self.missing.forget(key)
        self.status.decided += 1

    def _verified(self, task_id: int, attempt: int) -> tuple[Task, Report] | None:
        """Result of the verification; None when the submission is not ours to judge, or no longer waits.

        Raises ProofAway, DiskFull, BusError, RemoteError or IndexBehind.
        """
        submission = self.acts.submission(task_id, attempt)
        if submission is None or not submission.waits:
            return None
        chain_record = read_chain_record(self._wallet, task_id)
        task = chain_record.task
        if task.attempt < attempt or (task.attempt == attempt and task.state == "assigned"):
            raise IndexBehind(
                "the bridge's index does not know of the submission yet",
                task_id=task_id,
                attempt=attempt,
                state=task.state,
                submitted_in_block=submission.block,
            )
        if task.state not in ("submitted", "ruled") or task.attempt != attempt:
            return None
        if not is_ours(self._kinds, task):
            log.info("task %d attempt %d of %s waits for an auditor", task_id, attempt, task.kind)
            self.acts.judged(task_id, attempt, None)
            with self._lock:
                self.status.for_auditors.add((task_id, attempt))
            return None
        if not self.judging.has(task.kind, task.rules_sha256):
            return self._left(task)
        key = task_id, attempt
        if (last_word := self.missing.last_word(key)) is not None:
            return task, last_word
        self.status.publish(key, f"verifying task {task_id}")
        copy = self.missing.copy(key)
        try:
            report = apart.verify_apart(
                self._site,
                chain_record,
                self.process.data_dir / _VERIFYING,
                self.process.stop,
                copy=copy,
                failed=self.line.failed[key],
            )
        except EvidenceError as error:
            owner = owner_of(error, task.proof_uri or "", self._site, self.missing.stores)
            raise ProofAway(in_words(error), task=task, owner=owner) from error
        if report is None:
            return None
        if report.rules_sha256 != task.rules_sha256:
            log.error("the checks judge by %s since this oracle was started: restart it", report.rules_sha256)
            return self._left(task)
        return task, report

    def _left(self, task: Task) -> tuple[Task, Report] | None:
        """The report on a submission by rules that are missing here; None while others may judge it."""
        last_word = self.judging.leave(task)
        # Only later submissions of the same executor wait for this judge.
        self.acts.away(task.id, task.attempt, True)
        return None if last_word is None else (task, last_word)

    def _post(self, task: Task, report: Report, report_sha256: str, report_uri: str) -> bool:
        """Rule, or pass the case on; False when others did meanwhile."""
        rule = Rule(
            # A verification repeated after a crash may word its report on the same proof differently.
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
            self.acts.judged(task.id, task.attempt, None)
            if error.code in _NO_MORE:
                with self._lock:
                    self.status.for_auditors.add((task.id, task.attempt))
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

    def _until_answered(self, ask: Callable[[], Answer], task: Task | None = None) -> Answer | None:
        """The answer of `ask`, repeated while bridge or store are away or behind, or the disk is full, and
        once the verdict on `task` is due; None when stopped."""

        def wait(error: RodeoError) -> None:
            away = is_transient(error) or isinstance(error, StoreUnavailable | IndexBehind)
            # A bridge that fails at one task must not block all others.
            if not away or error.code == "internal":
                raise error
            log.warning("waiting: %s", error)
            self._pause(task)

        return repeated(ask, wait, self.process.stop)

    def _pause(self, task: Task | None = None) -> None:
        """Pause before the next attempt, without holding a simulated clock. The clock may jump to the time at
        which `task` is due. It may not jump if that time is unknown or past, because a window would end."""
        until_s = None if task is None or is_due(task, self._site, self._clock) else due_s(task, self._site)
        self._clock.wait_for(
            lambda: False, self.process.stop, until_s=until_s, wall_s=RETRY_S, resting=until_s is not None
        )


def is_ours(kinds: Kinds, task: Task) -> bool:
    """Whether oracles judge this task, as the organization's rules were when it was posted. Never where the
    oracle has no checks of its own, whatever those say, nor once the right to judge was taken from them."""
    return not kinds.by_people(task.kind) and task.judge == "oracle" and not task.judge_removed


def _amount_iec(task: Task, report: Report) -> Decimal | None:
    """Amount paid for an accepted proof: the one in its report, which may be nothing, else the full price."""
    if not report.accepted:
        return None
    return task.price_iec if report.amount_iec is None else report.amount_iec
