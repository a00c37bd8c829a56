"""Names of participants in ROS 2, `/<organization>/<participant>/...`, and why some of them cannot be."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rodeo.site.topics import TOPICS, Plane


def ros_name(name: str) -> str:
    """An organization or a participant in names of ROS, which take no hyphens."""
    return name.replace("-", "_")


def unusable(name: str) -> str:
    """Why ROS 2 takes no such name, as a sentence; empty if it does."""
    if "__" in ros_name(name):
        return f"ROS 2 takes no name with two underscores in a row, and {name} is {ros_name(name)} there"
    return ""


def collisions(participants: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Place in the list, and why, of each participant that has the name of one before it."""
    seen: dict[str, str] = {}
    for number, name in enumerate(participants):
        first = seen.get(ros_name(name))
        if first == name:
            yield number, f"{name} is listed twice"
        elif first is not None:
            yield number, f"{name} and {first} are both {ros_name(name)} in ROS 2"
        seen.setdefault(ros_name(name), name)


def taken(org: str, namespaces: Iterable[str], furniture: Iterable[str]) -> str:
    """Why the organization's names in ROS 2 would be those of a robot, a bin, a dock or the lab, as a
    sentence; empty if they are its own."""
    own = ros_name(org)
    for namespace in namespaces:
        if namespace.partition("/")[0] == own:
            return f"the organization {org} is {own} in ROS 2, like the namespace of a robot: rename one"
    fixed = {
        topic.key.partition("/")[0] for topic in TOPICS if topic.plane is Plane.ROBOT and "{" in topic.key
    }
    if own in {*furniture, *fixed}:
        return f"the organization {org} is {own} in ROS 2, a name that the lab itself uses there: rename one"
    return ""


def is_the_labs(org: str, participant: str) -> bool:
    """Whether a topic or service of the lab has the name of this participant's."""
    own = f"{ros_name(org)}/{ros_name(participant)}"
    return any(topic.plane is Plane.ROBOT and topic.key == own for topic in TOPICS)
