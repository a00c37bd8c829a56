"""The classes that the robot's ROS 1 has for messages, services and actions."""

from __future__ import annotations

import importlib
from typing import Any

from rodeo_ros1.errors import ConfigError


def message_class(package: str, name: str) -> Any:
    """Raises ConfigError where the package is not installed."""
    return _class(package, "msg", name)


def service_class(package: str, name: str) -> Any:
    """Raises ConfigError where the package is not installed."""
    return _class(package, "srv", name)


def _class(package: str, kind: str, name: str) -> Any:
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            "this ROS 1 has no {}/{}: install ros-noetic-{}".format(package, name, package.replace("_", "-"))
        ) from error
