"""The generated table `interfaces.json`: layouts and hashes of ROS 2's types, and their names in ROS 1."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rodeo_ros1.errors import ConfigError

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of a field's type: a number or text, a structure, an array of a fixed length, a sequence."""


class Layouts:
    """The table, read."""

    def __init__(self, table: dict[str, Any]) -> None:
        self._types = table["types"]
        self._ros1_names = table["ros1_names"]
        self._renamed = table["renamed"]
        self.organization = {form: dict(names) for form, names in table["organization"].items()}
        """Names below `/<organization>/<participant>/`: list of a configuration -> name -> type."""

    @classmethod
    def load(cls) -> Layouts:
        return cls(json.loads(Path(__file__).with_name("interfaces.json").read_text(encoding="utf-8")))

    def fields(self, typename: str) -> list[tuple[str, tuple[int, Any]]]:
        return self._entry(typename)[1]

    def hash_of(self, typename: str) -> str:
        return self._entry(typename)[0]

    def _entry(self, typename: str) -> Any:
        try:
            return self._types[typename]
        except KeyError:
            raise ConfigError(f"no layout of {typename}: the relay does not know this type") from None

    def full_name(self, short: str, kind: str) -> str:
        """`nav_msgs/Odometry` -> `nav_msgs/msg/Odometry`, also from a name of ROS 1. Raises ConfigError."""
        parts = short.split("/")
        name = f"{parts[0]}/{kind}/{parts[1]}" if len(parts) == 2 else short
        ros2 = {ros1: known for known, ros1 in self._ros1_names.items()}.get(short, name)
        if ros2.split("/")[1:2] != [kind]:
            raise ConfigError(
                "{} is no {}".format(short, {"msg": "message", "srv": "service"}.get(kind, kind))
            )
        self._entry(ros2 + {"msg": "", "srv": "_Request", "action": "_Goal"}[kind])
        return ros2

    def ros1_name(self, typename: str) -> tuple[str, str]:
        """Package and name in ROS 1 of a message, a service or an action."""
        package, _, name = typename.split("/")
        package, name = self._ros1_names.get(typename, f"{package}/{name}").split("/")
        return package, name

    def ros1_field(self, typename: str, field: str) -> str:
        """The name that the field has in ROS 1, if ROS 1 has it at all."""
        return str(self._renamed.get(typename, {}).get(field, field))


def dds_type(typename: str) -> str:
    """`std_msgs/msg/String` -> `std_msgs::msg::dds_::String_`, the type in keys."""
    return "{}::{}::dds_::{}_".format(*typename.split("/"))
