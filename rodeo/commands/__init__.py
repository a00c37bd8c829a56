"""The organization's commands, one module a group: each is declared here and nowhere else.

`declare` says what belongs to a declaration, `desk` what its checks and calls are made from. What the bridge
does with a command is in `services.bridge`; messages and queries are in `rodeo.bus`.
"""

from rodeo.commands import (
    devices,
    governance,
    judging,
    organization,
    relaying,
    services,
    tasks,
    treasury,
)
from rodeo.commands.declare import COMMANDS, Command

__all__ = [
    "COMMANDS",
    "Command",
    "devices",
    "governance",
    "judging",
    "organization",
    "relaying",
    "services",
    "tasks",
    "treasury",
]
