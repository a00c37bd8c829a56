"""What a robot notes in its recording about a thing that no site file lists."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from rodeo.lab.config import ItemClass, Pose2
from rodeo.lab.items import MeasuredItem

FOUND: Final = "found"
SMALLEST_M, LARGEST_M = 0.005, 0.3
"""Extents of what a gripper takes from the floor."""
HEAVIEST_N = 20.0

Extent = Annotated[float, Field(ge=SMALLEST_M, le=LARGEST_M)]


class Found(BaseModel):
    """The thing that a robot lifted off the floor at a task's place."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, strict=True)

    event: Literal["found"] = FOUND
    size_m: tuple[Extent, Extent, Extent]
    """Extents of the box around it along the axes of the frame in which `item_pose` said that it lay. The
    fingers close along y; z is up."""
    weight_n: float = Field(gt=0, le=HEAVIEST_N)
    """What the robot felt when it lifted it."""

    def note(self) -> dict[str, Any]:
        """Content of the note."""
        return self.model_dump(mode="json")


def thing(size_m: tuple[float, float, float], pose: Pose2, **felt: float) -> MeasuredItem:
    """A thing that no site file lists, as the box that was measured; `felt` is its `mass_kg`, where that is
    known. The bin says of which class it is."""
    return MeasuredItem(
        id=FOUND, item_class=ItemClass.TRASH, shape="carton", pose=pose, size_m=size_m, **felt
    )
