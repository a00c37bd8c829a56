"""From a file to a report. The same code runs in the oracle and as `rodeo verify FILE`."""

from __future__ import annotations

import logging
from pathlib import Path

from rodeo.config import Site
from rodeo.dao import CLEANING
from rodeo.errors import RodeoError
from rodeo.evidence import (
    EvidenceError,
    Limits,
    Proof,
    Store,
    is_bag,
    is_never_sealed,
    open_bag,
    open_proof,
)
from rodeo.evidence.errors import CorruptProof, SealError, StoreUnavailable
from services.oracle.acts import acts
from services.oracle.case import Case, CaseError, Ledger, OthersFailed
from services.oracle.checks import CHECKS, STATEMENT, CheckFunction, provenance
from services.oracle.counts import COUNTS
from services.oracle.report import Check, Finding, Report, skipped, undecided

log = logging.getLogger(__name__)

_UNFORESEEN = (KeyError, TypeError, ValueError, IndexError, ArithmeticError)
"""What numbers and parameters of a kind that no check foresaw make Python raise."""


def verify_file(path: Path, site: Site, ledger: Ledger | None = None, *, reads_bags: bool = True) -> Report:
    """Check the proof at `path`. Without `ledger`, what only the chain knows is skipped. A bag, which is
    never paid for, is only read if `reads_bags`.

    Never raises for what the file holds: a file that cannot be read is a report that says so.
    """
    checks: list[Check] = []
    try:
        proof = _open(path, Limits(file_bytes=site.store.max_bytes, messages=COUNTS.messages), reads_bags)
    except EvidenceError as error:
        return _report([_failed("readable_and_sealed", error)], ledger)
    if proof is None:
        return _report([Check(name="sealed", **provenance.vouched_for(False).model_dump())], ledger)
    by = f"under {proof.seals} seals by {proof.signer}" if proof.sealed else "of a bag"
    detail = f"{proof.messages} messages {by}"
    checks.append(Check(name="readable_and_sealed", passed=True, source="docs/evidence.md", detail=detail))
    case = Case(proof, site, ledger)
    missed = ""
    for stage in CHECKS.get(case.kind, STATEMENT):
        if missed and (proof.sealed or provenance.sealed not in stage):  # nobody need be asked about a bag
            checks += [_skipped(check, f"not asked: {missed} did not pass") for check in stage]
            continue
        checks += [_run(check, case) for check in stage]
        missed = next((check.name for check in checks if check.passed is False), "")
    source = case.item_pose_source if case.kind == CLEANING else None
    report = _report(checks, ledger, proof.sha256, case.kind, source)
    if report.accepted:
        return report.model_copy(update={"amount_iec": case.amount_iec, "acts": acts(case)})
    if report.outcome == "undecided":
        return report.model_copy(update={"acts": _claimed(case)})
    return report


def _claimed(case: Case) -> list[str]:
    """The acts of a proof that could not be decided, as far as it tells them."""
    try:
        return acts(case)
    except (EvidenceError, *_UNFORESEEN) as error:
        log.info("what an undecided proof claims is not known: %r", error)
        return []


def verify_submission(
    site: Site, ledger: Ledger, folder: Path, copy: Path | None = None, *, may_wait: bool = False
) -> Report:
    """Fetch the task's proof into `folder` and check it; `copy` is the proof, where it was had already.

    Raises StoreUnavailable and DiskFull, which say nothing about the proof; with `may_wait` also whatever
    else keeps the bytes away, unless the URI is none of a file with the submitted hash.
    """
    task = ledger.task
    uri, sha256 = task.proof_uri or "", task.proof_sha256 or ""
    try:
        path = copy or Store(site).fetch(uri, sha256, folder=folder)
    except StoreUnavailable:
        raise
    except EvidenceError as error:
        if may_wait and Store.names(uri, sha256):
            raise
        return _report([_failed("fetched", error)], ledger, task.proof_sha256)
    # Bags are read by libraries that know no limits: what exhausts them must not be for people to decide.
    report = verify_file(path, site, ledger, reads_bags=False)
    fetched = Check(name="fetched", passed=True, measured=task.proof_sha256, source=task.proof_uri or "")
    return report.with_checks(fetched, first=True)


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
    name = function.__name__
    try:
        finding = function(case)
    except OthersFailed as error:
        finding = undecided(str(error)[:300], error.fault, source="what others signed and posted")
    except EvidenceError as error:
        return _failed(name, error)
    except _UNFORESEEN as error:
        # The recording's numbers or the task's parameters are of a kind that no check foresaw.
        log.exception("%s could not be computed", name)
        finding = Finding(passed=False, detail=f"could not be computed: {error!r}"[:300])
    return Check(name=name, **finding.model_dump())


def _skipped(function: CheckFunction, why: str) -> Check:
    return Check(name=function.__name__, **skipped(why).model_dump())


def _failed(name: str, error: RodeoError) -> Check:
    # A case's errors are findings in words; those of a broken file are known by their code.
    detail = str(error) if isinstance(error, CaseError) else f"{error.code}: {error}"
    return Check(name=name, passed=False, detail=detail[:300])


def _report(
    checks: list[Check],
    ledger: Ledger | None,
    sha256: str | None = None,
    kind: str | None = None,
    item_pose_source: str | None = None,
) -> Report:
    task = ledger.task if ledger else None
    return Report.of(
        checks,
        kind=kind or (task.kind if task else None),
        task_id=task.id if task else None,
        attempt=task.attempt if task else None,
        proof_sha256=sha256 or (task.proof_sha256 if task else None),
        item_pose_source=item_pose_source,
    )
