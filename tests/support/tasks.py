"""Tasks that no chain knows."""

from rodeo.messages import Task


def task(state: str) -> Task:
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
    return Task.model_validate(unknown | known)
