"""An error as ROS 2 nodes get it."""

from __future__ import annotations

from typing import Any

from rodeo.bus.messages import Message
from rodeo.errors import RodeoError
from rodeo.text.redaction import redacted_json


class Problem(Message):
    """Why something was not done: the error's code, in words, and the values that explain it."""

    code: str
    """What programs tell errors apart by, such as insufficient_funds."""
    message: str
    details: dict[str, Any]


def problem_of(error: RodeoError) -> Problem:
    """What the bridge, or this process, refused."""
    return Problem.model_validate(redacted_json(error.to_json()))
