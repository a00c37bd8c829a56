"""What the creator of a cleaning and the robot that does it agree on: the task's parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from rodeo.charging import Name, Number

FARTHEST_M = 10_000.0
"""From the origin of a site's map: no robot drives so far."""
Coordinate = Annotated[Number, Field(ge=-FARTHEST_M, le=FARTHEST_M)]


_UNDER_WAY = ("open", "assigned", "submitted", "undecided")


def doubt_about(item_id: str, tasks: Iterable[Mapping[str, Any]]) -> str:
    """Why the item of a task to be posted is probably not where that says; empty where nothing tells so.

    `tasks` are those that there are, the newest first (`rodeo.messages.Task` as JSON)."""
    for task in tasks:
        params = task["params"]
        if not isinstance(params, dict) or params.get("item_id") != item_id:
            continue
        if task["state"] in _UNDER_WAY:
            return f"task {task['id']} is about {item_id} already, and is {task['state']}"
        if task["state"] == "settled" and task["verdict"] == "accepted":
            return (
                f"{item_id} should lie in the bin: task {task['id']} was paid for carrying it there; unless "
                "somebody took it out again, this one fails"
            )
    return ""


class CleaningParams(BaseModel):
    """What a waste_disposal task says beyond its reward: which item, and where it lies, m in frame `map`."""

    model_config = ConfigDict(extra="allow")

    item_id: Name
    x_m: Coordinate
    y_m: Coordinate
