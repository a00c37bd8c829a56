"""Does the executor itself say that it failed?"""

from rodeo.cleaning import CleaningParams
from rodeo.dao import CLEANING
from services.oracle.case import Case
from services.oracle.report import Finding


def not_given_up(case: Case) -> Finding:
    """The executor does not report that the attempt failed: then nothing else needs to be asked."""
    failures = [event for event in case.proof.events() if event.get("event") == "execution_failed"]
    if failures and case.kind == CLEANING and case.ledger is not None:
        case.ordered(CleaningParams)  # what nobody can do is not the executor's failure
    reason = str(failures[-1].get("message", "no reason given"))[:200] if failures else None
    return Finding(
        passed=not failures,
        measured=reason,
        source="the executor's own recording",
        detail=f"the executor reports: {reason}" if failures else "the executor's own word",
    )
