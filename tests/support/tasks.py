"""Tasks that no chain knows."""

from typing import Any

from rodeo.bus.messages import Task

UNTIL_S, DEADLINE_S, CASE_END_S = 1_000.0, 1_500.0, 2_000.0
"""Ends of the time for which a ruling stands, of the verdict window, and of the case."""


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
        "grace_s": 180,
        "verdict_window_s": 3600,
        "passed_on": False,
        "judge": "oracle",
        "judge_removed": False,
        "passed": [],
    }
    return Task.model_validate(unknown | known | changes)


def ruled(task_id: int, ruling: str = "accepted", **changes: Any) -> Task:
    """A task on whose proof a ruling stands."""
    standing = {"ruling": ruling, "until": UNTIL_S, "amount_iec": "100" if ruling == "accepted" else "0"}
    told: dict[str, Any] = {"id": task_id, "state": "ruled", "standing": standing, "case_end": CASE_END_S}
    return task(**(told | {"verdict_deadline": DEADLINE_S} | changes))
