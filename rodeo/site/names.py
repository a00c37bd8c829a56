"""Names of a site's processes and wallets, who votes, and how long its cases last."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rodeo.errors import ConfigError
from rodeo.lab.config import gripper_body
from rodeo.site.file import Part, SiteFile
from rodeo.site.minds import job_beside
from rodeo.site.sections import interface_of
from rodeo.site.topics import BODY, NODE

ORACLE = "oracle"
"""Wallet and process of a site's only oracle."""

BRIDGE = "bridge"
"""Process that is the site's own bridge."""


def robot_process(site: SiteFile, robot: str) -> str:
    """Name of the process that has the key of the robot's device: its mind, or the recorder beside that."""
    return _process(job_beside(site.robot(robot).mind), site.robots, robot)


def bin_process(site: SiteFile, name: str) -> str:
    """Name of the process that is the bin called `name`."""
    return _process("itrash", site.bins, name)


def dock_process(site: SiteFile, name: str) -> str:
    """Name of the process that is the meter of the dock called `name`."""
    return _process("charger", site.docks, name)


def tracked(site: SiteFile) -> list[str]:
    """Names of the bodies that motion capture follows."""
    robots = [robot.name for robot in site.robots]
    armed = [robot.name for robot in site.robots if interface_of(robot).arm]
    grippers = [gripper_body(name) for name in armed] if site.lab.mocap_gripper else []
    return [*(item.id for item in site.items), *robots, *grippers]


def oracle_names(site: SiteFile) -> list[str]:
    """The wallets of those who judge recordings."""
    return [one.name for one in site.oracles] or [ORACLE]


def oracle_process(site: SiteFile, name: str) -> str:
    """Name of the process that is the oracle called `name`."""
    return f"{ORACLE}.{name}" if site.oracles else ORACLE


def bridge_names(site: SiteFile) -> list[str]:
    """The site's own bridge first, then its [[bridges]]."""
    return [BRIDGE, *(one.name for one in site.bridges)]


def bridge_process(site: SiteFile, name: str) -> str:
    """Name of the process that is the bridge called `name`. Raises ConfigError."""
    if name not in (known := bridge_names(site)):
        raise ConfigError("no such bridge on this site", bridge=name, bridges=known)
    return BRIDGE if name == BRIDGE else f"{BRIDGE}.{name}"


def bridge_wallets(site: SiteFile) -> dict[str, list[str]]:
    """Process of each bridge, the site's own first -> the participants whose wallets it manages."""
    others = {
        bridge_process(site, one.name): oracle_names(site) if one.wallets is None else one.wallets
        for one in site.bridges
    }
    taken = {name for names in others.values() for name in names}
    everybody = ["organization", *(robot.name for robot in site.robots), *oracle_names(site)]
    everybody += [participant.name for participant in site.participants]
    return {BRIDGE: [name for name in everybody if name not in taken], **others}


MIN_VERDICT_WINDOW_S = 60
"""What every judge wants at least (`termsFor` in the contracts)."""
MAX_CASE_S = 30 * 24 * 3600
"""The longest case, verdict and audit window together, that every judge takes."""


def min_verdict_window_s(site: SiteFile) -> int:
    """The shortest verdict window, s. Where rulings can be challenged there is time for the oracles, and for
    all challenges after them."""
    if site.disputes is None:
        return MIN_VERDICT_WINDOW_S
    oracles_s = max(MIN_VERDICT_WINDOW_S, math.ceil(site.oracle.verdict_within_s))
    return site.disputes.longest_s + oracles_s


def panel(site: SiteFile) -> int:
    """How many oracles may vote at once."""
    return site.oracle.panel or len(site.oracles)


def votes_needed(site: SiteFile, kind: str) -> int:
    """How many oracles have to agree on a proof of `kind`."""
    said = next((one.votes for one in site.kinds if one.name == kind), None)
    return said or panel(site) // 2 + 1


def _process(job: str, parts: Sequence[Part], name: str) -> str:
    """Plain `job` where there is only one."""
    return job if len(parts) == 1 else f"{job}.{name}"


def body_identity(robot: str) -> str:
    """The body of `robot` on the bus, simulated or real: the name in its certificate."""
    return f"{BODY}.{robot}"


def node_identity(participant: str) -> str:
    """The ROS 2 nodes of `participant` on the bus: the name in their certificate."""
    return f"{NODE}.{participant}"
