"""The rows of a family, as its TOML file has them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Family = Literal["nodes", "files", "environment", "drivers"]
FAMILIES: tuple[Family, ...] = ("nodes", "files", "environment", "drivers")


class Row(BaseModel):
    """One vice that somebody has met."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    vice: str
    """In a few words; unique in its family."""
    source: str
    """A public report of it, or the standard that allows it."""
    must: Literal["works", "refused"]
    says: str = ""
    """What the error has to say, where it must be refused: its code or a part of its sentence."""
    how: str
    """Which of the family's deeds meets it."""
    given: dict[str, Any] = Field(default_factory=dict)
    """What the deed plays the vice from."""

    @model_validator(mode="after")
    def _refusals_say_why(self) -> Row:
        if (self.must == "refused") != bool(self.says):
            raise ValueError(f"{self.vice}: `says` is for what is refused")
        return self


def rows(family: Family) -> list[Row]:
    """All of a family, in the order of its file."""
    text = Path(__file__).with_name(f"{family}.toml").read_text()
    found = [Row.model_validate(one) for one in tomllib.loads(text)["row"]]
    if len({one.vice for one in found}) != len(found):
        raise ValueError(f"a vice stands twice in {family}.toml")
    return found
