"""The actions of `rodeo_msgs`: a task from its posting to its end, and the work that a mind does for one."""

from __future__ import annotations

from pydantic import Field

from rodeo.bus.messages import Hex32, Message, Task
from rodeo.commands.tasks import RegisterTask
from rodeo.interfaces.fields import Field as RosField
from rodeo.interfaces.fields import fields_of
from rodeo.interfaces.problem import Problem

POSTED = RegisterTask
"""The command that a goal of `create_task` is."""

CREATE_TASK = "CreateTask"
DO_TASK = "DoTask"

_THE_GOALS = frozenset({"request_id", "dry_run"})
"""The goal's UUID is the ID of the request, and who only wants to know the cost asks the service."""


class TaskEnded(Message):
    """How a task ended that a goal has posted."""

    problem: Problem | None = Field(
        description="Why it was not posted, was not done, or is not followed any more (code `lost`)."
    )
    task: Task | None = Field(
        description="The task at its end: `paid_iec`, `proof_sha256`, `proof_uri`, `verdict`, `reason`."
    )
    transactions: list[str] = Field(description="Hashes of the task's transactions, in the chain's order.")


class TaskChanged(Message):
    """The task has another state, another executor or another ruling than before."""

    task: Task
    transactions: list[str] = Field(description="Hashes of its transactions until now.")


class Assigned(Message):
    """A task that the participant is to do. To accept the goal accepts the task, to reject it gives the task
    back."""

    task: Task


class WorkDone(Message):
    """The proof of the work, which is submitted. A goal that is aborted gives the task back."""

    proof_sha256: Hex32
    proof_uri: str = Field(description="Where the proof is, in a store of the site.")


class Working(Message):
    """What the mind does now, shown in the status of the process."""

    activity: str
    progress: float | None = Field(description="Part of the work that is done, 0 to 1.")


def task_fields() -> tuple[RosField, ...]:
    """The fields of a goal that posts a task."""
    return tuple(fields_of(POSTED, request=True, without=_THE_GOALS))
