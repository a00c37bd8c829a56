"""Does the executor itself say that it failed?"""

from rodeo.checks.case import Case, ordered
from rodeo.checks.report import Finding
from rodeo.checks.tables import events_of


def reported_failure(case: Case) -> str | None:
    """Why the executor says that the attempt failed; None where it does not."""
    failures = [event for event in events_of(case) if event.get("event") == "execution_failed"]
    return str(failures[-1].get("message", "no reason given"))[:200] if failures else None


def not_given_up(case: Case) -> Finding:
    """The executor does not report that the attempt failed: then nothing else needs to be asked."""
    reason = reported_failure(case)
    if reason is not None and case.checks.params and case.chain_record:
        ordered(case, case.checks.params)  # what nobody can do is not the executor's failure
    return Finding(
        passed=reason is None,
        measured=reason,
        source="the executor's own recording",
        detail="the executor's own statement" if reason is None else f"the executor reports: {reason}",
    )
