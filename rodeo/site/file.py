"""What a site file says, as a whole: its tables, and what is found in them by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from rodeo.errors import ConfigError
from rodeo.host.stamps import FASTEST_CLOCK
from rodeo.lab.config import (
    BinConfig,
    DockConfig,
    ItemConfig,
    LabConfig,
    MocapConfig,
    PlaceConfig,
    RobotConfig,
)
from rodeo.lab.rooms import RoomConfig, walls
from rodeo.site import endpoint, sections

if TYPE_CHECKING:
    # The lab's modules take lists of these, and a list of something more is another type.
    from rodeo.lab.config import RobotConfig as SiteRobot
else:
    from rodeo.site.sections import SiteRobot

ANSWER_WALL_S = 5.0
"""Wall time in which a process hears of an assignment and has given it back, on a slow machine."""


class SiteFile(BaseModel):
    """What the site file says, completed with what follows from it."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    org: str = Field(pattern=r"^[a-z][a-z0-9-]*$")
    """Name of the organization; the first part of every DAO-plane key."""
    data_dir: Path
    """Where processes keep what must survive them. A relative path is resolved against the site file that
    sets it, and `~` is the user's home."""

    bus: sections.BusConfig = sections.BusConfig()
    clock: sections.ClockConfig = sections.ClockConfig()
    chain: sections.ChainConfig = sections.ChainConfig()
    economy: sections.EconomyConfig = sections.EconomyConfig()
    governance: sections.GovernanceConfig = sections.GovernanceConfig()
    disputes: sections.DisputesConfig | None = None
    """By default what the oracles say is final."""
    disk: sections.DiskConfig = sections.DiskConfig()
    store: sections.StoreConfig = sections.StoreConfig()
    oracle: sections.OracleConfig = sections.OracleConfig()
    oracles: list[sections.JudgeConfig] = []
    """Several oracles that vote. By default there is one, whose verdict is enough."""
    agent: sections.AgentConfig = sections.AgentConfig()
    bridge: sections.BridgeConfig = sections.BridgeConfig()
    bridges: list[sections.OtherBridgeConfig] = []
    """By default one bridge manages all wallets."""
    hosts: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9.-]*$")], list[str]] = {}
    """Computer -> its processes, by their names in `rodeo status`. `rodeo deploy systemd` writes the units of
    each, and each process is listed once. By default all are on one computer."""
    metrics: sections.MetricsConfig = sections.MetricsConfig()
    console: sections.ConsoleConfig = sections.ConsoleConfig()

    lab: LabConfig
    mocap: MocapConfig = MocapConfig()
    bins: list[BinConfig] = []
    docks: list[DockConfig] = []
    rooms: list[RoomConfig] = []
    """Walls with doors inside the lab; they are furniture of it once the site is loaded."""
    places: list[PlaceConfig] = []
    robots: list[SiteRobot]
    items: list[ItemConfig] = []
    things: list[ItemConfig] = []
    """What lies in a simulated lab and carries no markers: no process but `robot_sim` knows of it."""
    participants: list[sections.ParticipantConfig] = []
    ros: list[sections.RosConfig] = []
    """By default nobody's ROS 2 nodes take part in the organization, and no process waits for them."""
    people: sections.PeopleConfig = sections.PeopleConfig()
    demo: sections.DemoConfig | None = None
    experiment: sections.ExperimentConfig | None = None
    kinds: list[sections.KindConfig] = []
    """The kinds of work that the organization knows. The code of those that are installed is imported beside
    the keys, so only what is named here is."""

    @model_validator(mode="after")
    def _has_an_endpoint(self) -> Self:
        if self.bus.router == endpoint.LOCAL:
            self.bus = self.bus.model_copy(update={"router": endpoint.local_socket(self.data_dir)})
        return self

    @model_validator(mode="after")
    def _has_walls(self) -> Self:
        # A site that was loaded and is validated again has them already.
        if built := [one for one in walls(self.rooms, self.lab) if one not in self.lab.furniture]:
            self.lab = self.lab.model_copy(update={"furniture": (*self.lab.furniture, *built)})
        return self

    @field_validator("kinds")
    @classmethod
    def _kinds_differ(cls, kinds: list[sections.KindConfig]) -> list[sections.KindConfig]:
        names = [kind.name for kind in kinds]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"listed twice: {', '.join(twice)}")
        return kinds

    @property
    def store_url(self) -> str:
        return self.store.url or (self.data_dir.absolute() / "store").as_uri()

    @property
    def min_verdict_window_s(self) -> float:
        """The shortest verdict window, s of site time, in which an honest proof has its verdict: whoever does
        work for less may lose it because the oracle is slow. While it is awaited a robot may charge."""
        speeds = [] if self.clock.source == "wall" else [self.clock.speed, self.clock.idle_speed]
        return self.oracle.verdict_within_s * max([1.0, *(speed or FASTEST_CLOCK for speed in speeds)])

    @property
    def answer_s(self) -> float:
        """How long a process may need to give an assignment back, s of site time, which is the chain's, too.
        While one robot charges, another one may be given a task."""
        clock = self.clock
        waits = clock.source == "wall" or "bridge" in clock.holders
        speeds = [clock.speed, *([clock.idle_speed] if len(self.robots) > 1 else [])]
        return ANSWER_WALL_S * max([1.0, *(speed or FASTEST_CLOCK for speed in speeds if not waits)])

    def robot(self, name: str) -> RobotConfig:
        """The robot called `name`. Raises ConfigError."""
        return _called(name, "robot", self.robots)

    def bin(self, name: str) -> BinConfig:
        """The bin called `name`. Raises ConfigError."""
        return _called(name, "bin", self.bins)

    def dock(self, name: str) -> DockConfig:
        """The dock called `name`. Raises ConfigError."""
        return _called(name, "dock", self.docks)

    def place(self, name: str) -> PlaceConfig:
        """The place called `name`. Raises ConfigError."""
        return _called(name, "place", self.places)


Part = TypeVar("Part", RobotConfig, BinConfig, DockConfig, PlaceConfig)


def _called(name: str, what: str, parts: Sequence[Part]) -> Part:
    for part in parts:
        if part.name == name:
            return part
    known = {what: name, f"{what}s": [part.name for part in parts]}
    raise ConfigError(f"no such {what} on this site", **known)
