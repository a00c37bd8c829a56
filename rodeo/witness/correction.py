"""What a person says that an item really was, and the count of it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from rodeo.bus.queries import Answer
from rodeo.witness.statement import Digest, Name, Scope


class Correction(Scope):
    """An auditor of the organization says what a picture that the bin classified shows."""

    type: Literal["bin.correction"] = "bin.correction"
    bin: Name
    image_sha256: Digest
    """Hash of the picture, as in the bin's statement."""
    item_class: str = Field(alias="class", max_length=32)
    """What it really was; what the bin said, where it was right; `unknown` if it was no item."""


class Judged(Answer):
    """The items of a bin that one person judged."""

    address: str
    name: str | None
    """None for who is no auditor any more."""
    items: int
    """What was shown from several angles is one item, whatever number of answers about it was judged."""
    right: int
    """Those of which the bin had said the right class, in the last of its answers that was judged."""


class Pictured(Answer):
    """A picture that can be corrected."""

    image_sha256: str
    item_class: str = Field(alias="class")
    """What the bin said that it shows."""
    shown_s: float
    """Site time of the picture."""
    corrections: dict[str, str] = Field(default_factory=dict)
    """Name of a person -> the class that this person saw. Former auditors are named by address."""


class Corrections(Answer):
    """How often a bin was right in operation, by those who looked, and what they can look at."""

    bin: str
    people: list[Judged]
    pictures: tuple[Pictured, ...] = ()
    """The last items', the newest first."""
