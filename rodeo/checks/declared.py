"""Does the executor itself say that it failed?"""

from collections.abc import Mapping
from typing import Any

from rodeo.checks.case import Case, CaseError, OthersFailed, ordered
from rodeo.checks.report import Finding, impossible, standing
from rodeo.checks.tables import events_of
from rodeo.evidence.errors import EvidenceError
from rodeo.text.foreign_text import in_words, quoted


def reported_failure(case: Case) -> str | None:
    """Why the executor says that the attempt failed, quoted; None where it does not."""
    failure = _failure(case)
    return None if failure is None else quoted(failure.get("message", "no reason given"))


def not_given_up(case: Case) -> Finding:
    """The executor does not report that the attempt failed: then nothing else needs to be asked. What nobody
    could do is not its failure."""
    failure = _failure(case)
    if failure is None:
        return Finding(passed=True, source=_SOURCE, detail="the executor's own statement")
    return _worth(case, failure).model_copy(update={"last": True})


def _worth(case: Case, failure: Mapping[str, Any]) -> Finding:
    lacking = ""
    if case.chain_record:
        if case.checks.params:
            try:
                ordered(case, case.checks.params)
            except OthersFailed as error:
                return impossible(in_words(error), error.fault, source="the task's parameters")
        try:
            if (found := case.checks.undoable(case, failure)) is not None:
                return found
        except CaseError as error:
            lacking = f"; {in_words(error)}"
    reason = reported_failure(case)
    detail = f"the executor reports: {reason}{lacking}"
    found = Finding(passed=False, measured=reason, source=_SOURCE, detail=detail)
    return found if _may_have_come(case) else standing(found)


def _may_have_come(case: Case) -> bool:
    try:
        return case.checks.may_have_come(case)
    except EvidenceError:
        return True


_SOURCE = "the executor's own recording"


def _failure(case: Case) -> Mapping[str, Any] | None:
    failures = [event for event in events_of(case) if event.get("event") == "execution_failed"]
    return failures[-1] if failures else None
