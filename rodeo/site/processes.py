"""The table of processes: what a site is made of. Launcher, status, compose and systemd files follow it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rodeo.site.config import Site
from rodeo.site.minds import AGENT, job_beside
from rodeo.site.names import (
    bin_process,
    bridge_process,
    dock_process,
    oracle_names,
    oracle_process,
    robot_process,
)
from rodeo.site.providers import MOTION_CAPTURE, SIMULATOR, provided_by, wants_simulator
from rodeo.site.topics import RECORDER


@dataclass(frozen=True)
class ProcessEntry:
    name: str
    module: str
    """Started as `python -m <module> --site FILE <arguments>`."""
    job: str
    arguments: tuple[str, ...] = ()


PROCESSES: tuple[ProcessEntry, ...] = (
    ProcessEntry("router", "deploy.router", "the Zenoh router of the bus"),
    ProcessEntry("chain", "deploy.chain", "the shared chain: eth-tester or anvil"),
    ProcessEntry("bridge", "services.bridge", "signs, sends and indexes for the others"),
    ProcessEntry("oracle", "services.oracle", "verifies proofs and posts verdicts"),
    ProcessEntry("itrash", "services.itrash", "the smart bin"),
    ProcessEntry("charger", "services.charger", "the dock's energy meter"),
    ProcessEntry("console", "services.console", "the web page where people run the organization"),
    ProcessEntry("ros_dao", "services.ros_dao", "the organization as ROS 2 services, for one owner's nodes"),
    ProcessEntry(SIMULATOR, "services.robot_sim", "what is simulated of lab and robots, and the clock"),
    ProcessEntry(MOTION_CAPTURE, "services.mocap", "publishes and signs what motion capture sees"),
    ProcessEntry(AGENT, "services.robot_agent", "the robot's mind"),
    ProcessEntry(RECORDER, "services.robot_recorder", "records what the robot's mind, a ROS 2 node, does"),
)


def ros_process(site: Site, owner: str) -> str:
    """Name of the process that speaks ROS 2 for the participants of `owner`."""
    return "ros_dao" if len(site.ros) == 1 else f"ros_dao.{owner}"


def processes_of(site: Site) -> list[ProcessEntry]:
    """The processes that `site` needs: no chain where it is elsewhere, no simulator where nothing is
    simulated, and one for each bridge, oracle, bin, dock, robot and owner of ROS 2 nodes."""
    own: dict[str, list[ProcessEntry]] = {
        "bridge": [
            BY_NAME["bridge"],
            *_named("bridge", "bridge", {one.name: bridge_process(site, one.name) for one in site.bridges}),
        ],
        "oracle": _each(
            "oracle", "oracle", {name: oracle_process(site, name) for name in oracle_names(site)}
        ),
        "itrash": _each("itrash", "bin", {one.name: bin_process(site, one.name) for one in site.bins}),
        "ros_dao": _each("ros_dao", "owner", {one.owner: ros_process(site, one.owner) for one in site.ros}),
        "charger": _each("charger", "dock", {one.name: dock_process(site, one.name) for one in site.docks}),
        **{job: _each(job, "robot", robots_with(site, job)) for job in (AGENT, RECORDER)},
    }
    if site.chain.backend == "external":
        own["chain"] = []
    if not wants_simulator(site):
        own[SIMULATOR] = []
    if not provided_by(site, MOTION_CAPTURE, "mocap"):
        own[MOTION_CAPTURE] = []
    return [entry for process in PROCESSES for entry in own.get(process.name, [process])]


def robots_with(site: Site, job: str) -> dict[str, str]:
    """Robot -> its process, of those whose key an AGENT has, or a RECORDER."""
    return {one.name: robot_process(site, one.name) for one in site.robots if job_beside(one.mind) == job}


def _each(job: str, option: str, names: dict[str, str]) -> list[ProcessEntry]:
    """A process for each name. Where there is only one of its kind, its command needs no option."""
    if list(names.values()) == [job]:
        return [BY_NAME[job]]
    return _named(job, option, names)


def _named(job: str, option: str, names: dict[str, str]) -> list[ProcessEntry]:
    return [
        replace(BY_NAME[job], name=process, arguments=(f"--{option}", name))
        for name, process in names.items()
    ]


BY_NAME: dict[str, ProcessEntry] = {process.name: process for process in PROCESSES}
assert len(BY_NAME) == len(PROCESSES), "process names must be unique"
