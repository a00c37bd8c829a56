"""From a file to a report. The same code runs in the oracle and as `rodeo verify FILE`."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from rodeo.checks import provenance
from rodeo.checks.case import Case, CaseError, ChainRecord, CheckFunction, Checks, OthersFailed
from rodeo.checks.counts import counts_of, within_counts
from rodeo.checks.motion.sources import judged, parties
from rodeo.checks.report import Check, Finding, Report, given_up, skipped, undecided
from rodeo.checks.results import sources_read
from rodeo.checks.rules import rules_hash
from rodeo.checks.stages import PEOPLE
from rodeo.errors import RodeoError, is_machines
from rodeo.evidence.container import Limits
from rodeo.evidence.errors import CorruptProof, EvidenceError, SealError, StoreUnavailable
from rodeo.evidence.proof import Proof, open_proof
from rodeo.evidence.store import Store
from rodeo.evidence.unsealed import is_bag, is_never_sealed, open_bag
from rodeo.kinds import kinds_of
from rodeo.site.config import Site
from rodeo.text.foreign_text import in_words, quoted

log = logging.getLogger(__name__)

ORACLE = "the oracle"
"""As who failed."""
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")


def verify_file(
    path: Path,
    site: Site,
    chain_record: ChainRecord | None = None,
    *,
    reads_bags: bool = True,
    checks_of: Callable[[Checks], Checks] = lambda checks: checks,
    claims: Callable[[list[str]], None] = lambda acts: None,
) -> Report:
    """Check the proof at `path`. Without `chain_record`, what only the chain knows is skipped. A bag,
    which is never paid for, is only read if `reads_bags`. `checks_of` may change the kind's checks,
    to find out what one of them is good for; an oracle never does. `claims` gets the acts that the
    proof claims before anything is checked: whatever ends the process later, they are known.

    Never raises because of the file's content: a fault in it is a rejection that names the fault. Raises only
    errors of this machine (`rodeo.errors.is_machines`), which say nothing about the proof.
    """
    try:
        limits = counts_of(site, chain_record).limits(site.store.max_bytes)
        proof = _open(path, limits, reads_bags)
    except Exception as error:  # noqa: BLE001 - strangers' bytes make libraries raise whatever they like
        return _report([_failed("readable_and_sealed", error)], site, chain_record)
    if proof is None:
        unsealed = Check.of("sealed", provenance.vouched_for(False))
        return _report([unsealed], site, chain_record)
    return verify_proof(proof, site, chain_record, checks_of=checks_of, claims=claims)


def verify_proof(
    proof: Proof,
    site: Site,
    chain_record: ChainRecord | None = None,
    *,
    checks_of: Callable[[Checks], Checks] = lambda checks: checks,
    claims: Callable[[list[str]], None] = lambda acts: None,
) -> Report:
    """What `verify_file` reports of a proof once it is open; one proof may be judged several times."""
    by = f"under {proof.seals} seals by {proof.signer}" if proof.sealed else "of a bag"
    detail = f"{proof.messages} messages {by}"
    source = "docs/reference/evidence.md"
    checks = [Check(name="readable_and_sealed", passed=True, source=source, detail=detail)]
    try:
        case = case_of(proof, site, chain_record)
    except Exception as error:  # noqa: BLE001 - the same: a kind looks into the recording
        return _report([*checks, _failed("kind_recognized", error)], site, chain_record)
    case = replace(case, checks=checks_of(case.checks))
    acts = _claimed(case)
    claims(acts)
    missed = ""
    for stage in case.checks.stages:
        if missed and (proof.sealed or provenance.sealed not in stage):  # nobody need be asked about a bag
            checks += [_skipped(check, f"skipped: {missed} did not pass") for check in stage]
            continue
        found = [_run(check, case) for check in stage]
        checks += found
        decided = (one.name for one in found if one.outcome == "rejected" or (one.outcome and one.last))
        missed = missed or next(decided, "")
    report = _report(checks, site, chain_record, case)
    return _with_payment(report, case) if report.accepted else report.model_copy(update={"acts": acts})


def _with_payment(report: Report, case: Case) -> Report:
    """With what is paid, and for what; given up where the kind cannot tell."""
    try:
        paid = {"amount_iec": case.checks.amount_iec(case), "acts": case.checks.acts(case)}
    except Exception as error:
        if is_machines(error):
            raise
        log.exception("what an accepted proof is paid for could not be computed")
        finding = given_up(_not_computed(error), source="the kind's checks", fault=ORACLE)
        return report.with_checks(Check.of("payment_computed", finding))
    return report.model_copy(update=paid)


def case_of(proof: Proof, site: Site, chain_record: ChainRecord | None) -> Case:
    """By the checks of the task's kind; without a chain, of the first kind that the recording looks like.

    Raises KindError if a kind that the site lists cannot be imported.
    """
    kinds = kinds_of(site)
    if chain_record is not None:
        name = chain_record.task.kind
        checks = PEOPLE if kinds.by_people(name) else kinds[name].load_checks()
        return Case(proof, site, chain_record, name, checks)
    if not PEOPLE.recognizes(proof, site):
        for name, kind in kinds.items():
            if not kind.by_people and (checks := kind.load_checks()).recognizes(proof, site):
                return Case(proof, site, None, name, checks)
    return Case(proof, site, None, None, PEOPLE)


def _claimed(case: Case) -> list[str]:
    """The acts of a proof, as far as it tells them. One that holds more than a proof may claims none: it is
    not even read."""
    try:
        return case.checks.acts(case) if within_counts(case).passed else []
    except Exception as error:
        if is_machines(error):
            raise
        log.info("cannot determine what this proof claims: %r", error)
        return []


def verify_submission(
    site: Site,
    chain_record: ChainRecord,
    folder: Path,
    copy: Path | None = None,
    *,
    may_wait: bool = False,
    checks_of: Callable[[Checks], Checks] = lambda checks: checks,
    claims: Callable[[list[str]], None] = lambda acts: None,
    fetched: Callable[[], None] = lambda: None,
) -> Report:
    """Fetch the task's proof into `folder` and check it as `verify_file` does; `copy` is the proof, where it
    was had already. `fetched` is called once the bytes are here.

    Raises StoreUnavailable and DiskFull, which say nothing about the proof; with `may_wait` also whatever
    else keeps the bytes away, unless the URI is none of a file with the submitted hash.
    """
    task = chain_record.task
    uri, sha256 = task.proof_uri or "", task.proof_sha256 or ""
    try:
        path = copy or Store(site).fetch(uri, sha256, folder=folder)
    except StoreUnavailable:
        raise
    except EvidenceError as error:
        if may_wait and Store.names(uri, sha256):
            raise
        return _report([_failed("fetched", error)], site, chain_record)
    fetched()
    # Bags are read by libraries that know no limits: what exhausts them must not be for people to decide.
    report = verify_file(path, site, chain_record, reads_bags=False, checks_of=checks_of, claims=claims)
    check = Check(name="fetched", passed=True, measured=task.proof_sha256, source=quoted(uri))
    return report.with_checks(check, first=True)


def _open(path: Path, limits: Limits, reads_bags: bool) -> Proof | None:
    """None for a bag that is not to be read. Raises EvidenceError."""
    if is_bag(path):
        return open_bag(path, limits) if reads_bags else None
    try:
        return open_proof(path, limits)
    except (SealError, CorruptProof):
        if is_never_sealed(path):
            return open_bag(path, limits) if reads_bags else None
        raise


def _run(function: CheckFunction, case: Case) -> Check:
    with sources_read() as sources:
        try:
            finding = function(case)
        except OthersFailed as error:
            finding = undecided(in_words(error), error.fault, source="other parties' statements and posts")
        except Exception as error:  # noqa: BLE001 - the same
            finding = _failure(function.__name__, error)
    return Check.of(function.__name__, judged(case, finding, sources))


def _skipped(function: CheckFunction, why: str) -> Check:
    return Check.of(function.__name__, skipped(why))


def _failed(name: str, error: Exception) -> Check:
    return Check.of(name, _failure(name, error))


def _failure(name: str, error: Exception) -> Finding:
    """What was read and computed is the executor's file: what it lacks or breaks rejects it. What no check
    foresees may be a mistake in the check: that fines nobody, and pays nobody. Raises what the oracle's own
    machine failed at."""
    if is_machines(error):
        raise error
    # A case's errors are findings in words; those of a broken file are known by their code.
    if isinstance(error, CaseError):
        return Finding(passed=False, detail=in_words(error))
    if isinstance(error, RodeoError):
        return Finding(passed=False, detail=f"{error.code}: {in_words(error)}")
    log.error("%s could not be computed", name, exc_info=error)
    return given_up(_not_computed(error), source="the checks", fault=ORACLE)


def _not_computed(error: Exception) -> str:
    # Judges vote for equal reports, and where an object lies in memory differs.
    said = _ADDRESS.sub("", str(error))
    return f"could not be computed: {type(error).__name__}: {quoted(said)}"


def _report(
    checks: list[Check], site: Site, chain_record: ChainRecord | None, case: Case | None = None
) -> Report:
    task = chain_record.task if chain_record else None
    name = task.kind if task else case.kind if case else None
    kind = kinds_of(site).get(name or "")
    return Report.of(
        checks,
        kind=name,
        task_id=task.id if task else None,
        attempt=task.attempt if task else None,
        proof_sha256=case.proof.sha256 if case else task.proof_sha256 if task else None,
        item_pose_source=case.item_pose_source if case and case.checks.item else None,
        rules_sha256=None if kind is None else rules_hash(kind),
        parties=parties(case) if case else {},
    )
