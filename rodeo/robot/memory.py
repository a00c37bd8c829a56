"""What the robot knows of things: what it holds, and where it last knew items to lie. Survives restarts."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel, ConfigDict

from rodeo.host.files import read_model, replace_file
from rodeo.robot.errors import JournalBroken
from rodeo.site.config import Site

Point = tuple[float, float]


class Held(BaseModel):
    """The item between the fingers."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    item_id: str
    place_m: Point
    """Where it was taken from, in the map."""
    hang_m: float
    """How far it reaches below where the pads meet, fingers down."""
    centre_m: float
    """How far its centre is above where the pads meet, fingers down."""
    grasped_s: float = 0.0
    """Site time at which the fingers closed on it; 0 if nobody remembers."""
    weight_n: float | None = None
    """What the arm felt of it; None where nobody asked for that."""


class _Facts(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    held: Held | None = None
    lying: dict[str, Point] = {}


class Memory:
    """Raises JournalBroken when its file holds something else. One thread."""

    def __init__(self, site: Site, path: Path) -> None:
        self._path = path
        words = (
            "the robot's memory is damaged: restore the file, or move it away; then the robot "
            "looks for items at their places in the site file"
        )
        lying = {item.id: (item.pose.x_m, item.pose.y_m) for item in site.items}
        self._facts = read_model(_Facts, path, JournalBroken, words) or _Facts(lying=lying)

    @property
    def held(self) -> Held | None:
        return self._facts.held

    def lying(self, but: str | None = None) -> list[Point]:
        """Where items lay when the robot last knew, leaving out the item `but`."""
        return [place for item, place in self._facts.lying.items() if item != but]

    def place(self, item_id: str) -> Point | None:
        return self._facts.lying.get(item_id)

    def saw(self, item_id: str, place_m: Point) -> None:
        self._facts.lying[item_id] = place_m
        self._save()

    def took(self, held: Held) -> None:
        self._facts.held = held
        self._facts.lying.pop(held.item_id, None)
        self._save()

    def let_go(self, place_m: Point | None) -> None:
        """What was held lies at `place_m`, or is gone."""
        if self._facts.held is not None and place_m is not None:
            self._facts.lying[self._facts.held.item_id] = place_m
        self._facts.held = None
        self._save()

    def _save(self) -> None:
        replace_file(self._path, self._facts.model_dump_json())
