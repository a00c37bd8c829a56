"""Proofs by people: who says it, for which assignment, and that something is said. Whether it is true is not
for a machine to tell; kinds of task where that matters are judged by an auditor."""

from rodeo.checks.case import Case
from rodeo.checks.report import Finding, equal, skipped
from rodeo.person.statement import BadPhoto, check_photo, read_statement
from rodeo.text.foreign_text import in_words


def executors_own_seal(case: Case) -> Finding:
    """Sealed with the executor's own key: a person has no device that could speak for it."""
    if case.chain_record is None:
        return skipped("no chain to compare with")
    return equal(
        (case.proof.signer or "").lower(),
        (case.chain_record.task.executor or "").lower(),
        source="the assignment on chain",
        detail="signer of the statement",
    )


def stated(case: Case) -> Finding:
    """A note is there, and the photos are those that it speaks of, and pictures."""
    statement = read_statement(case.proof)
    for number, photo in enumerate(statement.photos, start=1):
        try:
            check_photo(photo)
        except BadPhoto as error:
            return Finding(
                passed=False, measured=number, detail=f"a photo is not an image: {in_words(error)}"
            )
    return Finding(
        passed=True,
        measured=f"{len(statement.note)} characters, {len(statement.photos)} photos",
        detail="the executor's statement",
    )


def judged_by_people(_case: Case) -> Finding:
    """Whether the work was done is not for a machine to tell."""
    return Finding(
        passed=False,
        detail="an auditor judges people's work; see `rodeo task review`",
        fault="none: the oracle has no checks for this work",
    )
