"""Names of participants in ROS 2, `/<organization>/<participant>/...`, and why some of them cannot be."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Protocol

from rodeo.site.topics import NODE, TOPICS, Plane
from rodeo.text.site_problems import Place, close

_FIXED = {
    one.key.partition("/")[0]
    for one in TOPICS
    if one.plane is Plane.ROBOT and ("{" in one.key or "/" not in one.key)
}
"""First parts of the lab's own names in ROS 2 below which bodies and nodes write. Its single service is not
among them: `lab` is what an organization is called."""


def ros_name(name: str) -> str:
    """An organization or a participant in names of ROS, which take no hyphens."""
    return name.replace("-", "_")


class _Named(Protocol):
    @property
    def name(self) -> str: ...


class _Robot(_Named, Protocol):
    @property
    def namespace(self) -> str: ...

    @property
    def mind(self) -> str | None: ...


class _Owner(Protocol):
    @property
    def owner(self) -> str: ...

    @property
    def participants(self) -> list[str]: ...


def faults(
    org: str,
    owners: Sequence[_Owner],
    robots: Sequence[_Robot],
    participants: Sequence[_Named],
    furniture: Sequence[_Named],
) -> Iterator[tuple[Place, str]]:
    """Where a site file gives names that ROS 2 refuses, or that two would have there, and where `[[ros]]`
    lists participants whom no owner's process may command."""
    for number, robot in enumerate(robots):
        if robot.namespace.partition("/")[0] in _FIXED:
            where = ("robots", number, "name" if robot.namespace == robot.name else "namespace")
            yield where, f"the lab itself uses the name {robot.namespace} in ROS 2: write another namespace"
    spoken = _spoken(owners, robots)
    if spoken and (why := _unusable(org) or _taken(org, robots, furniture)):
        yield ("org",), why
    for number, one in enumerate(owners):
        if one.owner in [other.owner for other in owners[:number]]:
            yield ("ros", number, "owner"), f'two processes speak ROS 2 for "{one.owner}": write one table'
    known = [one.name for one in (*robots, *participants)]
    first: dict[str, str] = {}
    for place, name in spoken:
        same = first.get(ros_name(name))
        first.setdefault(ros_name(name), name)
        if why := _refused(org, name, known, same):
            yield place, why


_TOPIC = re.compile(r"[a-z][a-z0-9_]*(/([a-z0-9_]+|\{body\}))+")


def driver_fault(address: str, robots: Sequence[_Robot], others: Sequence[str]) -> str:
    """Why a driver of motion capture may not publish `address`, as a sentence; empty if it may. Who else may
    publish there, robots or `others`, could move what motion capture then signs."""
    if _TOPIC.fullmatch(address) is None:
        return 'write the topic of its driver, such as "vrpn_mocap/{body}/pose" or "vrpn_mocap/tf"'
    first = address.partition("/")[0]
    namespaces = [robot.namespace.partition("/")[0] for robot in robots]
    if first in {*namespaces, *map(ros_name, others), *_FIXED, "lab"}:
        return f"others may publish below {first}, too: remap the driver's topics to a name of their own"
    return ""


def _spoken(owners: Sequence[_Owner], robots: Sequence[_Robot]) -> list[tuple[Place, str]]:
    """Participants that have nodes, and where the file says so: those that owners list, and minds."""
    found: list[tuple[Place, str]] = [
        (("ros", number, "participants", entry), name)
        for number, one in enumerate(owners)
        for entry, name in enumerate(one.participants)
    ]
    for number, robot in enumerate(robots):
        mind = (robot.mind or "").removeprefix(f"{NODE}.")
        if mind and mind not in [name for _, name in found]:
            found.append((("robots", number, "mind"), mind))
    return found


def _refused(org: str, name: str, known: list[str], same: str | None) -> str:
    """Why no process may speak ROS 2 for the participant `name`; `same` has its name there already."""
    if name == "organization":
        return "the organization's own wallet takes no commands over ROS 2"
    if name not in known:
        return f"nobody on this site is called {name}{close(name, known)}"
    if same is not None:
        both = f"{name} and {same} are both {ros_name(name)} in ROS 2"
        return f"{name} is listed twice" if same == name else both
    own = f"{ros_name(org)}/{ros_name(name)}"
    if any(topic.plane is Plane.ROBOT and topic.key == own for topic in TOPICS):
        return f"the lab itself has a service of this name in ROS 2: rename {name}"
    return _unusable(name)


def _unusable(name: str) -> str:
    """Why ROS 2 takes no such name, as a sentence; empty if it does."""
    if "__" in ros_name(name):
        return f"ROS 2 takes no name with two underscores in a row, and {name} is {ros_name(name)} there"
    return ""


def _taken(org: str, robots: Sequence[_Robot], furniture: Sequence[_Named]) -> str:
    """Why the organization's names in ROS 2 would be those of a robot, a bin, a dock or the lab, as a
    sentence; empty if they are its own."""
    own = ros_name(org)
    if own in [robot.namespace.partition("/")[0] for robot in robots]:
        return f"the organization {org} is {own} in ROS 2, like the namespace of a robot: rename one"
    if own in {*(one.name for one in furniture), *_FIXED}:
        return f"the organization {org} is {own} in ROS 2, a name that the lab itself uses there: rename one"
    return ""
