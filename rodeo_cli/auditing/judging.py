"""What is wrong with verdicts today, and why: each is judged again, and compared with chain and store."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
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

What = Literal["file", "rules", "verdict", "amount", "acts", "report", "payment"]
_REPORT_BYTES = 16 << 20


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
                if self._kinds.by_people(verdict.kind):
                    verdict.unjudged = "people judge this kind"
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
            _judged(verdict, done, self._verify.rules.get(verdict.kind))
            yield self._settle(verdict)
        yield from map(self._settle, _emptied(ready))

    def _settle(self, verdict: Verdict) -> Verdict:
        """With what chain and store say beside its proof."""
        verdict.findings += [*_payment(verdict.attempt), *self._report(verdict)]
        return verdict

    def _report(self, verdict: Verdict) -> Iterator[Finding]:
        attempt = verdict.attempt
        try:
            with tempfile.TemporaryDirectory() as folder:
                uri = self._store.whereabouts(attempt.report_uri, attempt.report_sha256, ".json")
                path = self._store.fetch(uri, attempt.report_sha256, _REPORT_BYTES, Path(folder))
                data = path.read_bytes()
        except StoreUnavailable as error:
            verdict.failed, verdict.unjudged = True, f"its report cannot be read: {error}"
            return
        except EvidenceError as error:
            yield Finding("report", f"the report is not in the store: {error.code}: {in_words(error)}")
            return
        if attempt.ruling != "accepted":
            return
        for text in {*verdict.acts, *acts_listed(data, attempt.report_sha256)}:
            try:
                act = Act.parse(text)
            except MalformedAct as error:
                yield Finding("report", f"the report lists an act that is none: {error}")
                continue
            self._claims[act.what].append(_Claim(act, verdict))

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


def _judged(verdict: Verdict, done: Done, rules_sha256: str | None) -> None:
    """Compare the chain's verdict with today's."""
    verdict.by = done.by
    if done.answer is None:
        verdict.failed = True
        if done.error is not None:
            verdict.unjudged, verdict.log = str(done.error), done.error.log
        return
    report = Report.model_validate_json(done.answer)
    attempt = verdict.attempt
    verdict.today, verdict.reason, verdict.acts = report.outcome, report.reason, tuple(report.acts)
    verdict.same_report = attempt.report_sha256 in _hashes(report)
    other_rules = verdict.rules_sha256 != rules_sha256
    differs = not _agrees(attempt, report.outcome)
    if report.reason.startswith(f"{ENDED}: ") and differs:
        # Of an oracle that is a verdict. Here it says that this machine is slower, or has less memory.
        verdict.failed, verdict.today, verdict.unjudged = True, "", report.reason
        return
    if report.reason.startswith("fetched: ") and differs:
        verdict.findings.append(Finding("file", report.reason.removeprefix("fetched: ")))
        return
    if differs:
        detail = f"the chain has {attempt.ruling}; today it is {report.outcome}: {report.reason}"
        verdict.findings.append(Finding("rules" if other_rules else "verdict", detail))
    elif other_rules:
        now = rules_sha256 or "none"
        detail = f"posted under {verdict.rules_sha256 or 'none'}, judged again by {now}: the same verdict"
        verdict.findings.append(Finding("rules", detail, wrong=False))
    if not differs and report.accepted:
        price = attempt.assigned["price_iec"]
        amount_iec = price if report.amount_iec is None else report.amount_iec
        if amount_iec != attempt.amount_iec:
            detail = f"the ruling grants {attempt.amount_iec} IEC; today it is {amount_iec} IEC"
            verdict.findings.append(Finding("amount", detail))


def _agrees(attempt: Attempt, outcome: str) -> bool:
    """Whether today's outcome is the one on the chain. What the judge passed on, people decided."""
    if outcome == "undecided" or attempt.passed_on:
        return attempt.passed_on or attempt.ruling == "void"
    return attempt.ruling == outcome


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


def _claimed_twice(one: _Claim, other: _Claim) -> None:
    first, second = sorted((one, other), key=lambda claim: claim.verdict.attempt.place)
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


def wrong_roots(
    site: Site, roots: Iterable[Root], devices: Iterable[Device], tell: Callable[[], None]
) -> Iterator[RootFinding]:
    """Daily roots whose log the store lacks, or is not its device's. `tell` is called for each root.

    Raises StoreUnavailable.
    """
    store = Store(site)
    by_key = {one.address.lower(): (one.role, one.name) for one in devices}
    for root in roots:
        tell()
        try:
            with tempfile.TemporaryDirectory() as folder:
                signed = SignedDay.load(store.fetch(root.uri, root.root, folder=Path(folder)))
        except StoreUnavailable:
            raise
        except EvidenceError as error:
            yield RootFinding(root, f"{error.code}: {in_words(error)}")
            continue
        said = (signed.log.address.lower(), signed.log.day)
        whose = by_key.get(root.device.lower())
        if said != (root.device.lower(), root.day) or by_key.get(signed.signer.lower()) != whose:
            yield RootFinding(root, f"the log is of day {signed.log.day} of {signed.log.address}")
