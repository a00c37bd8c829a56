"""What the creator of a cleaning and the robot that does it agree on: the task's parameters."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from rodeo.charging import Name, Number

FARTHEST_M = 10_000.0
"""From the origin of a site's map: no robot drives so far."""
Coordinate = Annotated[Number, Field(ge=-FARTHEST_M, le=FARTHEST_M)]


class CleaningParams(BaseModel):
    """What a waste_disposal task says beyond its reward: which item, and where it lies, m in frame `map`."""

    model_config = ConfigDict(extra="allow")

    item_id: Name
    x_m: Coordinate
    y_m: Coordinate
