"""The YAML file that says what is relayed between which names."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from rodeo_ros1.errors import ConfigError
from rodeo_ros1.layouts import Layouts

_FORMS = {"topics": "msg", "services": "srv", "actions": "action"}
_LISTS = [f"{what}_to_{side}" for what in _FORMS for side in ("ros1", "ros2")]
_SETTINGS = {"router": str, "domain_id": int, "namespace": str, "tls": dict, "participants": list}
_OF_AN_ENTRY = {"ros1": str, "ros2": str, "type": str}
_OPTIONS = {
    "topics": {"latched": bool, "depth": int, "on_demand": bool},
    "services": {"timeout_s": (int, float)},
    "actions": {},
}
_MOST_DEPTH = 1000
_COMMANDS, _READS = ("services_to_ros2", "actions_to_ros2"), "get_"
_WORK = ("register_service", "update_service", "accept_task", "abandon_task", "submit_proof")
"""Commands that every node in the ROS 1 graph may give for a participant; any other where it is named."""


@dataclass(frozen=True)
class Entry:
    """One topic, service or action."""

    ros1: str
    """Its name in the ROS 1 graph."""
    ros2: str
    """Its name in ROS 2, without the leading slash."""
    type: str
    """Its full name in ROS 2, such as nav_msgs/msg/Odometry."""
    latched: bool = False
    """A late subscriber gets the last `depth` messages of the topic."""
    depth: int = 1
    on_demand: bool = False
    """A topic to ROS 2 is converted only while somebody subscribes there."""
    timeout_s: float = 40.0
    """Time that the other side of a service may take."""


@dataclass(frozen=True)
class Tls:
    """The certificate that the relay shows, and the authority that signed the router's."""

    ca: str
    certificate: str
    key: str


@dataclass(frozen=True)
class Config:
    router: str
    domain_id: int
    namespace: str
    """Where the relay's node is in the graph of ROS 2."""
    tls: Tls | None
    entries: dict[str, list[Entry]] = field(default_factory=dict)
    """`topics_to_ros1` and so on -> what is relayed."""


def load(path: str, layouts: Layouts) -> Config:
    """Raises ConfigError that names what is wrong."""
    try:
        said = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    known = {**_SETTINGS, **dict.fromkeys(_LISTS, list)}
    _check("the file", said, known, {"router"})
    entries: dict[str, list[Entry]] = {}
    for name in _LISTS:
        what = name.split("_")[0]
        listed = said.get(name, [])
        entries[name] = [_entry(f"{name}[{i}]", what, one, layouts) for i, one in enumerate(listed)]
    for participant in said.get("participants", []):
        _add_participant(participant, entries, layouts)
    _check_names(entries)
    domain_id = said.get("domain_id", 0)
    if not 0 <= domain_id <= 232:
        raise ConfigError("domain_id is 0 to 232")
    return Config(
        router=said["router"],
        domain_id=domain_id,
        namespace=said.get("namespace", "").strip("/"),
        tls=_tls(Path(path).parent, said["tls"]) if "tls" in said else None,
        entries=entries,
    )


def _check(where: str, said: Any, known: dict[str, Any], needed: Any) -> None:
    if not isinstance(said, dict):
        raise ConfigError(f"{where} is no mapping")
    for name, value in said.items():
        if name not in known:
            raise ConfigError("{}: unknown {!r}; known: {}".format(where, name, ", ".join(sorted(known))))
        # A truth value counts as a number in Python, and not here.
        if not isinstance(value, known[name]) or (isinstance(value, bool) and known[name] is not bool):
            raise ConfigError(f"{where}: {name} cannot be {value!r}")
    missing = sorted(set(needed) - set(said))
    if missing:
        raise ConfigError("{} lacks {}".format(where, ", ".join(missing)))


def _tls(folder: Path, said: dict[str, Any]) -> Tls:
    names = ("ca", "certificate", "key")
    _check("tls", said, dict.fromkeys(names, str), names)
    paths = [folder / said[name] for name in names]
    for path in paths:
        if not path.is_file():
            raise ConfigError(f"tls: there is no {path}")
    return Tls(*[str(path) for path in paths])


def _entry(where: str, what: str, said: Any, layouts: Layouts) -> Entry:
    _check(where, said, {**_OF_AN_ENTRY, **_OPTIONS[what]}, _OF_AN_ENTRY)
    if not 1 <= said.get("depth", 1) <= _MOST_DEPTH:
        raise ConfigError(f"{where}: depth is 1 to {_MOST_DEPTH}")
    if not 0 < said.get("timeout_s", 1) < float("inf"):
        raise ConfigError(f"{where}: timeout_s is a time")
    try:
        typename = layouts.full_name(said["type"], _FORMS[what])
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
    named = {"ros1": _name(where, said["ros1"]), "ros2": _name(where, said["ros2"]).lstrip("/")}
    return Entry(**{**said, **named, "type": typename})


def _name(where: str, name: str) -> str:
    parts = name.strip("/").split("/")
    if not all(part.replace("_", "a").isalnum() and part.isascii() for part in parts):
        raise ConfigError(f"{where}: {name!r} is no name in ROS")
    return name


def _add_participant(participant: Any, entries: dict[str, list[Entry]], layouts: Layouts) -> None:
    """What `ros_dao` has for one participant, under the same names in ROS 1: what nodes read and work needs.

    Nobody has to show who they are in a ROS 1 graph: what spends, judges or votes has to be named.
    """
    said = participant if isinstance(participant, dict) else {"name": participant}
    name = said.get("name")
    if not isinstance(name, str) or _name("participants", name).strip("/").count("/") != 1:
        raise ConfigError(f"participants: {participant!r} is not <organization>/<participant>")
    _check("participants", said, {"name": str, "commands": list}, {"name"})
    named = said.get("commands", [])
    known = [one for group in _COMMANDS for one in layouts.organization[group] if not one.startswith(_READS)]
    unknown = [one for one in named if one not in known]
    if unknown:
        raise ConfigError(
            "participants: {} has no command {!r}; known: {}".format(
                name, unknown[0], ", ".join(sorted(known))
            )
        )
    for group, offered in layouts.organization.items():
        for one, typename in offered.items():
            if group in _COMMANDS and not one.startswith(_READS) and one not in (*_WORK, *named):
                continue
            place = "{}/{}".format(name.strip("/"), one)
            entry = Entry("/" + place, place, typename, latched=group == "topics_to_ros1")
            entries[group].append(entry)


def _check_names(entries: dict[str, list[Entry]]) -> None:
    """Check that no name occurs twice: a topic that is relayed both ways would loop, and a service with two
    entries would answer twice."""
    for what in _FORMS:
        for side in ("ros1", "ros2"):
            groups = [entries[f"{what}_to_{one}"] for one in ("ros1", "ros2")]
            names = [getattr(entry, side).strip("/") for group in groups for entry in group]
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ConfigError("{} has {} more than once in {}".format(what, ", ".join(twice), side))
