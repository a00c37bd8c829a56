"""Tasks that no chain knows."""

from typing import Any

from rodeo.messages import Task

UNTIL_S, DEADLINE_S = 1_000.0, 2_000.0
"""Ends of the window in which a ruling can be challenged, and of the verdict window."""


def task(state: str, **changes: Any) -> Task:
    """A cleaning of which nothing else is known."""
    unknown = dict.fromkeys(Task.model_fields)
    known = {
        "id": 1,
        "kind": "waste_disposal",
        "state": state,
        "attempt": 1,
        "max_attempts": 3,
        "creator": "0x0",
        "reward_iec": "100",
        "paid_iec": "0",
        "refunded_iec": "0",
        "params": {},
        "description": "",
        "registered": 0.0,
        "execution_window_s": 7200,
        "verdict_window_s": 3600,
    }
    return Task.model_validate(unknown | known | changes)


def ruled(task_id: int, outcome: str = "accepted", **changes: Any) -> Task:
    """A submitted task on which a ruling stands."""
    digests = dict.fromkeys(("proof_sha256", "report_sha256", "rules_sha256"), "0x" + "a" * 64)
    amount = "100" if outcome == "accepted" else "0"
    vote = {
        "task_id": task_id,
        "attempt": 1,
        "outcome": outcome,
        "amount_iec": amount,
        "reason": "",
        **digests,
    }
    ruling = {"instance": 0, "vote": vote, "report_uri": "file:///report", "until": UNTIL_S}
    told = {"id": task_id, "dispute": ruling, "verdict_deadline": DEADLINE_S}
    return task(**({"state": "submitted"} | told | changes))
