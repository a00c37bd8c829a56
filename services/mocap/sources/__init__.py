"""Sources of poses: one module for each kind of camera system, each with a `SOURCE`.

    [mocap]
    source = "natnet"                # a name in `BUILT_IN`, or of an installed package's entry point
    address = "192.168.1.5"
    settings = { multicast = true }  # fields of the source's own model
    bodies = { item1 = "Can 1" }     # the system's names, where they differ

A package adds a source with an entry point in the group `rodeo.mocap_sources`: name -> "module:SOURCE". A
source runs beside the key of motion capture, so only the one that the site file names is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, NamedTuple, Protocol

from pydantic import BaseModel, ConfigDict, ValidationError

from rodeo.errors import ConfigError
from rodeo.host.clock import TimeSource
from rodeo.lab.config import MocapConfig
from rodeo.ros2.node import Node
from rodeo.text.pydantic_words import wrong_fields

GROUP = "rodeo.mocap_sources"
"""Entry point group: name in the site file -> its `SourceKind`."""

BUILT_IN: dict[str, str] = {
    "natnet": "services.mocap.sources.natnet:SOURCE",
    "recorded": "services.mocap.sources.recorded:SOURCE",
    "ros2": "services.mocap.sources.ros2:SOURCE",
}
"""Name in the site file -> "module:SOURCE"."""


class Pose(NamedTuple):
    """Position in m in the system's frame, z up; unit quaternion w, x, y, z."""

    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


class Frame(NamedTuple):
    """What the cameras saw at one moment."""

    time_ns: int | None
    """Middle of the exposure, by the system's own clock; None where it says none, and the frame counts as
    taken when it arrives. See `SourceKind.stamps`."""
    bodies: Mapping[str, Pose | None]
    """By the system's names. None: the body is known and not in view. A body without an entry is not part of
    this frame; some systems send a message for each body."""


class Settings(BaseModel):
    """Base of the models of `[mocap.settings]`. This one has no fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Opening:
    """Arguments with which a source is opened."""

    address: str
    """`mocap.address`: where the system is."""
    settings: Any
    """`mocap.settings` as an instance of `SourceKind.settings`."""
    bodies: frozenset[str]
    """The system's names of what the site tracks. Others may be delivered, and are ignored."""
    deliver: Callable[[Frame], None]
    """Takes each frame, from one thread at a time. Never blocks, and raises nothing."""
    node: Node
    """For sources on the bus."""
    clock: TimeSource
    """The site's time."""


class Source(Protocol):
    """An open source: it delivers frames until it is closed. A connection that is lost is opened again by the
    source itself."""

    def problem(self) -> str:
        """Why no frames come, as far as the source knows; "" while nothing is known to be wrong."""
        ...

    def close(self) -> None:
        """Deliver no more, and let go of the system."""
        ...


@dataclass(frozen=True)
class SourceKind:
    """Declaration of a source."""

    open: Callable[[Opening], Source]
    """Returns soon: connecting is done in a thread. Raises ConfigError for what no retry cures."""
    settings: type[Settings] = Settings
    """Model of its settings."""
    stamps: Literal["system", "site"] = "system"
    """Clock of `Frame.time_ns`. `system`: any that goes as fast as the wall's; its offset is measured.
    `site`: the site's time, as a ROS 2 driver has it; frames whose stamps are off it are refused."""
    over_bus: bool = False
    """Whether frames come over the site's bus: what is signed then says so."""


def known() -> dict[str, str]:
    """Name of each source that the site file may name -> "module:attribute"."""
    return BUILT_IN | {one.name: one.value for one in entry_points(group=GROUP)}


def load(name: str) -> SourceKind:
    """The source called `name`. Raises ConfigError where there is none, or its libraries are missing."""
    found = known()
    if name not in found:
        raise ConfigError("no such source of motion capture", source=name, known=["sim", *sorted(found)])
    try:
        kind = EntryPoint(name, found[name], GROUP).load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"the source {name} of motion capture cannot be imported: {error}", source=name
        ) from error
    if not isinstance(kind, SourceKind):
        raise ConfigError("the entry point names no SourceKind", source=name, value=found[name])
    return kind


def chosen_settings(kind: SourceKind, config: MocapConfig) -> Settings:
    """`mocap.settings` as the source's own model. Raises ConfigError."""
    try:
        return kind.settings.model_validate(config.settings)
    except ValidationError as error:
        raise ConfigError(
            f"the settings of the source {config.source} are not valid", fields=wrong_fields(error.errors())
        ) from error
