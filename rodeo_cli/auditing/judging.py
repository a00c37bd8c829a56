"""What is wrong with verdicts today, and why: each is judged again, and compared with chain and store."""

from __future__ import annotations

import logging
import re
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Literal, NamedTuple

from rodeo.bus.messages import Device, Root
from rodeo.checks.acts import Act, MalformedAct, acts_listed, acts_unspent
from rodeo.checks.report import Report
from rodeo.evidence.errors import EvidenceError, StoreUnavailable
from rodeo.evidence.store import Store
from rodeo.jobs.apart import ENDED
from rodeo.jobs.job import Job
from rodeo.jobs.proofs import Verify
from rodeo.jobs.runner import Done, Runner
from rodeo.kinds import kinds_of
from rodeo.site.config import Site
from rodeo.text.foreign_text import in_words, quoted
from rodeo.witness.days import SignedDay
from rodeo_cli.auditing.reading import Attempt, History

log = logging.getLogger(__name__)

What = Literal["file", "rules", "verdict", "amount", "acts", "report", "payment"]
_REPORT_BYTES = 16 << 20
_PAID = ("accepted", "impossible")
"""Rulings that pay the executor."""
_FETCHED, _ENDED = "fetched: ", f"{ENDED}: "
_OF_THEN = {
    "rejected": (_FETCHED,),
    "void": (_FETCHED, _ENDED, "rules: no oracle "),
    "given_up": (_ENDED,),
}
"""Ruling -> beginnings of reasons that were so at that time and need not be today: what was not handed over,
machines that were too slow, and rules that nobody had."""
_SPENT = re.compile(
    r'acts_unspent: ".*"(?:\.\.\.)? (?:was|is|has) [a-z ]+ in '
    r"task (?P<task>\d{1,18}) attempt (?P<attempt>\d{1,3}) "
)
"""Reason of a ruling on a proof that claims what another one claimed (`acts_unspent`)."""


class Finding(NamedTuple):
    """Something about a verdict that is not as the chain has it."""

    what: What
    detail: str
    wrong: bool = True
    """Whether the verdict would be another one, or cannot be checked any more."""


@dataclass(slots=True)
class Verdict:
    """A verdict on the chain, and what is said of it today."""

    attempt: Attempt
    kind: str
    rules_sha256: str | None
    """The rules that the task was posted under."""
    today: str = ""
    """Outcome by the rules that are installed here; empty where it was not judged."""
    reason: str = ""
    unjudged: str = ""
    """Why it was not judged again: people judge it, or it could not be verified."""
    failed: bool = False
    """Whether it should have been."""
    log: str = ""
    by: str = ""
    """The engine that judged it again; "kept" where an earlier answer was there."""
    acts: tuple[str, ...] = ()
    """What the proof claims, as it is found today."""
    same_report: bool = False
    """Whether the report of today is the one on the chain, byte for byte."""
    findings: list[Finding] = field(default_factory=list)

    @property
    def wrong(self) -> bool:
        return any(finding.wrong for finding in self.findings)


class _Claim(NamedTuple):
    act: Act
    verdict: Verdict


class Audit:
    """Judges attempts again.

    Args:
        verify: whose installed rules count.
        runner: has the verifications done.
    """

    def __init__(self, site: Site, history: History, verify: Verify, runner: Runner) -> None:
        self._site, self._history, self._verify, self._runner = site, history, verify, runner
        self._store, self._kinds = Store(site), kinds_of(site)
        self._claims: dict[str, list[_Claim]] = defaultdict(list)

    def judge(self, attempts: Iterable[Attempt]) -> Iterator[Verdict]:
        """The verdicts on `attempts`, in the order in which they were judged again.

        What they claim is compared at the end (`compare_claims`). Raises StoreUnavailable where the store is
        a folder that is not there.
        """
        asked: dict[str, Verdict] = {}
        ready: list[Verdict] = []

        def jobs() -> Iterator[Job]:
            for attempt in attempts:
                record = self._history.chain_record(attempt)
                task = record.task
                verdict = Verdict(attempt, task.kind, task.rules_sha256)
                if attempt.by_people:
                    verdict.unjudged = "no oracle decided this"
                elif attempt.judge != "oracle":
                    verdict.failed, verdict.unjudged = True, "another contract judges this kind"
                elif self._kinds.by_people(task.kind):
                    verdict.failed, verdict.unjudged = True, "the site file has no checks for this kind"
                if verdict.unjudged:
                    ready.append(verdict)
                    continue
                # Executors name what they like: files of this machine, too.
                uri = self._store.whereabouts(attempt.proof_uri, attempt.proof_sha256, ".mcap")
                self._store.require_folder(uri)
                record = record.model_copy(update={"task": task.model_copy(update={"proof_uri": uri})})
                job = self._verify.job(attempt.proof_sha256, record, self._store.file(uri))
                asked[job.key] = verdict
                yield job

        for done in self._runner.run(jobs()):
            yield from map(self._settle, _emptied(ready))
            verdict = asked.pop(done.job.key)
            self._judged(verdict, done)
            yield self._settle(verdict)
        yield from map(self._settle, _emptied(ready))

    def _judged(self, verdict: Verdict, done: Done) -> None:
        """Take in what came of judging it again."""
        verdict.by = done.by
        if done.answer is None:
            verdict.failed = True
            if done.error is not None:
                verdict.unjudged, verdict.log = str(done.error), done.error.log
            return
        report, attempt = Report.model_validate_json(done.answer), verdict.attempt
        verdict.today, verdict.reason, verdict.acts = report.outcome, report.reason, tuple(report.acts)
        verdict.same_report = attempt.report_sha256 in _hashes(report)
        agrees = _agrees(attempt, report)
        if report.reason.startswith(_ENDED) and not (agrees and attempt.reason.startswith(_ENDED)):
            # Of an oracle that is a verdict. Here it says that this machine is too slow, or too small.
            verdict.failed, verdict.today, verdict.unjudged = True, "", report.reason
        elif not agrees and attempt.reason.startswith(_OF_THEN.get(attempt.ruling, ())):
            verdict.failed, verdict.today = True, ""
            said = f"the chain has {attempt.ruling}: {quoted(attempt.reason)}"
            verdict.unjudged = f"{said}; today it is {report.outcome}, and nobody can tell what was so then"
        elif not agrees and (spent := self._spent(attempt, report.acts)) is not None:
            verdict.today, verdict.reason = attempt.ruling, attempt.reason
            if spent:
                verdict.failed, verdict.today, verdict.unjudged = True, "", spent
        else:
            verdict.findings += _compared(verdict, report, self._verify.rules.get(verdict.kind))

    def _settle(self, verdict: Verdict) -> Verdict:
        """With what chain and store say beside its proof."""
        verdict.findings += [*_payment(verdict.attempt), *self._report(verdict)]
        return verdict

    def _spent(self, attempt: Attempt, acts: Iterable[str]) -> str | None:
        """Empty where the attempt that a refusal names had claimed the same before: it was accepted then, or
        it was of the same executor and might still be. A sentence where that cannot be read; else None."""
        named = _SPENT.match(attempt.reason)
        if named is None or attempt.ruling in _PAID:
            return None
        by = self._history.submission(int(named["task"]), int(named["attempt"]), attempt.ruled)
        if by is None or by.key == (attempt.task_id, attempt.number):
            return None
        if not (by.accepted or (by.stands and by.executor == attempt.executor)):
            return None
        unread = None
        for uri, digest in by.reports:
            try:
                listed = _acts(acts_listed(self._fetched(uri, digest), digest))
            except EvidenceError as error:
                unread = f"what it is said to claim again cannot be read: {in_words(error)}"
                continue
            if any(act.overlaps(other) for act in _acts(acts) for other in listed):
                return ""
        return unread

    def _fetched(self, uri: str, sha256: str) -> bytes:
        """A report. Raises EvidenceError."""
        with tempfile.TemporaryDirectory() as folder:
            uri = self._store.whereabouts(uri, sha256, ".json")
            return self._store.fetch(uri, sha256, _REPORT_BYTES, Path(folder)).read_bytes()

    def _report(self, verdict: Verdict) -> Iterator[Finding]:
        attempt = verdict.attempt
        try:
            data = self._fetched(attempt.report_uri, attempt.report_sha256)
        except StoreUnavailable as error:
            verdict.failed, verdict.unjudged = True, f"its report cannot be read: {error}"
            return
        except EvidenceError as error:
            yield Finding("report", f"the report is not in the store: {error.code}: {in_words(error)}")
            return
        if attempt.ruling != "accepted":
            return
        listed = acts_listed(data, attempt.report_sha256)
        if verdict.today == "accepted" and verdict.rules_sha256 == self._verify.rules.get(verdict.kind):
            for text in sorted(set(listed) - set(verdict.acts)):  # others would be refused for it
                yield Finding("report", f"the report lists {quoted(text)}, which the proof does not show")
        for text in {*verdict.acts, *listed, *self._passed_on(attempt)}:
            try:
                act = Act.parse(text)
            except MalformedAct as error:
                yield Finding("report", f"the report lists an act that is none: {error}")
                continue
            self._claims[act.what].append(_Claim(act, verdict))

    def _passed_on(self, attempt: Attempt) -> Iterator[str]:
        """What the oracle had said that it claims, of an attempt that people accepted: their reports list
        nothing."""
        by = self._history.submission(attempt.task_id, attempt.number) if attempt.by_people else None
        for uri, digest in by.reports if by is not None else ():
            if digest != attempt.report_sha256:
                try:
                    yield from acts_listed(self._fetched(uri, digest), digest)
                except EvidenceError as error:
                    log.warning("task %d: an earlier report cannot be read: %s", attempt.task_id, error)

    def compare_claims(self) -> None:
        """Find acts that two accepted proofs claim: the one that was submitted later was paid for nothing."""
        for claims in self._claims.values():
            claims.sort(key=lambda claim: claim.act.first)
            active: list[_Claim] = []
            for claim in claims:
                active = [one for one in active if one.act.last >= claim.act.first]
                for one in active:
                    if one.verdict is not claim.verdict and one.act.overlaps(claim.act):
                        _claimed_twice(one, claim)
                active.append(claim)


def _emptied(ready: list[Verdict]) -> list[Verdict]:
    found = list(ready)
    ready.clear()
    return found


def _compared(verdict: Verdict, report: Report, rules_sha256: str | None) -> Iterator[Finding]:
    """How the chain's verdict differs from today's."""
    attempt, other_rules = verdict.attempt, verdict.rules_sha256 != rules_sha256
    if report.reason.startswith(_FETCHED) and not attempt.reason.startswith(_FETCHED):
        yield Finding("file", report.reason.removeprefix(_FETCHED))
        return
    if not _agrees(attempt, report):
        ruled = "passed on" if attempt.passed_on else attempt.ruling
        detail = f"the chain has {ruled}; today it is {report.outcome}: {report.reason}"
        yield Finding("rules" if other_rules else "verdict", detail)
        return
    if other_rules:
        now = rules_sha256 or "none"
        detail = f"posted under {verdict.rules_sha256 or 'none'}, judged again by {now}: the same verdict"
        yield Finding("rules", detail, wrong=False)
    if report.accepted:
        price = attempt.assigned["price_iec"]
        amount_iec = price if report.amount_iec is None else report.amount_iec
        if amount_iec != attempt.amount_iec:
            detail = f"the ruling grants {attempt.amount_iec} IEC; today it is {amount_iec} IEC"
            yield Finding("amount", detail)


def _agrees(attempt: Attempt, report: Report) -> bool:
    return attempt.ruling == ("void" if report.outcome == "undecided" else report.outcome)


def _hashes(report: Report) -> set[str]:
    """Hashes that the oracle's report has if it found the same: it has asked whether the acts were free."""
    whole = report.with_checks(acts_unspent(report.acts, None)) if report.accepted else report
    return {"0x" + sha256(one.to_bytes()).hexdigest() for one in (report, whole)}


def _payment(attempt: Attempt) -> Iterator[Finding]:
    """What the chain paid for the attempt, against its ruling."""
    if attempt.ruling == "accepted" and attempt.ended != "TaskSettled":
        yield Finding("payment", f"it was accepted, and ended with {attempt.ended}")
    elif attempt.ended == "TaskSettled" and attempt.ruling == "accepted":
        if attempt.paid_iec != attempt.amount_iec:
            yield Finding(
                "payment", f"the ruling grants {attempt.amount_iec} IEC, {attempt.paid_iec} IEC were paid"
            )
        if attempt.received_iec < attempt.paid_iec:
            yield Finding("payment", f"{attempt.payout} got {attempt.received_iec} of {attempt.paid_iec} IEC")


def _acts(texts: Iterable[str]) -> list[Act]:
    """Those that are acts."""
    found = []
    for text in texts:
        with suppress(MalformedAct):  # as `ConsumedActs` has it
            found.append(Act.parse(text))
    return found


def _claimed_twice(one: _Claim, other: _Claim) -> None:
    """Find against the later: by acceptance where executors differ; one executor claims in its own order."""
    attempts = one.verdict.attempt, other.verdict.attempt
    is_own = attempts[0].executor == attempts[1].executor
    first, second = sorted(
        (one, other), key=lambda it: it.verdict.attempt.place if is_own else it.verdict.attempt.ruled
    )
    by = first.verdict.attempt
    detail = (
        f"{quoted(second.act.text)} was paid for in task {by.task_id} attempt {by.number} "
        f"as {quoted(first.act.text)}"
    )
    second.verdict.findings.append(Finding("acts", detail))


class RootFinding(NamedTuple):
    """A daily root that is not what it should be."""

    root: Root
    detail: str
    failed: bool = False
    """Whether the log could not be looked at."""


def odd_roots(
    site: Site, roots: Iterable[Root], devices: Iterable[Device], tell: Callable[[], None]
) -> Iterator[RootFinding]:
    """Daily roots whose log the store lacks, or is not its device's, or cannot be looked at. `tell` is called
    for each root."""
    store = Store(site)
    by_key = {one.address.lower(): (one.role, one.name) for one in devices}
    for root in roots:
        tell()
        try:
            with tempfile.TemporaryDirectory() as folder:
                uri = store.whereabouts(root.uri, root.root, ".json")
                signed = SignedDay.load(store.fetch(uri, root.root, folder=Path(folder)))
        except EvidenceError as error:
            yield RootFinding(
                root, f"{error.code}: {in_words(error)}", failed=isinstance(error, StoreUnavailable)
            )
            continue
        said = (signed.log.address.lower(), signed.log.day)
        whose = by_key.get(root.device.lower())
        if said != (root.device.lower(), root.day) or by_key.get(signed.signer.lower()) != whose:
            yield RootFinding(root, f"the log is of day {signed.log.day} of {signed.log.address}")
