"""The table of processes: what a site is made of. Launcher, status, compose and systemd files follow it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from rodeo.site import endpoint
from rodeo.site.file import SiteFile
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
from rodeo.text.site_problems import Place, close


@dataclass(frozen=True)
class ProcessEntry:
    name: str
    module: str
    """Started as `python -m <module> --site FILE <arguments>`."""
    job: str
    arguments: tuple[str, ...] = ()
    opens_keys: bool = False
    """It opens a keystore: that of a wallet, a device or a person."""

    @property
    def extra(self) -> str:
        """The extra of the package that installs what it imports."""
        return self.name.partition(".")[0].replace("_", "-")


PROCESSES: tuple[ProcessEntry, ...] = (
    ProcessEntry("router", "deploy.router", "the Zenoh router of the bus"),
    ProcessEntry("chain", "deploy.chain", "the shared chain: eth-tester or anvil"),
    ProcessEntry("bridge", "services.bridge", "signs, sends and indexes for the others", opens_keys=True),
    ProcessEntry("oracle", "services.oracle", "verifies proofs and posts verdicts", opens_keys=True),
    ProcessEntry("itrash", "services.itrash", "the smart bin", opens_keys=True),
    ProcessEntry("charger", "services.charger", "the dock's energy meter", opens_keys=True),
    ProcessEntry(
        "console", "services.console", "the web page where people run the organization", opens_keys=True
    ),
    ProcessEntry("ros_dao", "services.ros_dao", "the organization as ROS 2 services, for one owner's nodes"),
    ProcessEntry(SIMULATOR, "services.robot_sim", "what is simulated of lab and robots, and the clock"),
    ProcessEntry(
        MOTION_CAPTURE, "services.mocap", "publishes and signs what motion capture sees", opens_keys=True
    ),
    ProcessEntry(AGENT, "services.robot_agent", "the robot's mind", opens_keys=True),
    ProcessEntry(
        RECORDER,
        "services.robot_recorder",
        "records what the robot's mind, a ROS 2 node, does",
        opens_keys=True,
    ),
)


def ros_process(site: SiteFile, owner: str) -> str:
    """Name of the process that speaks ROS 2 for the participants of `owner`."""
    return "ros_dao" if len(site.ros) == 1 else f"ros_dao.{owner}"


def processes_of(site: SiteFile) -> list[ProcessEntry]:
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


def hosts_of(site: SiteFile) -> dict[str, list[ProcessEntry]]:
    """Computer -> its processes, in the table's order; one without a name has all where the site file names
    none."""
    if not site.hosts:
        return {"": processes_of(site)}
    return {
        host: [one for one in processes_of(site) if one.name in names] for host, names in site.hosts.items()
    }


def host_faults(site: SiteFile) -> Iterator[tuple[Place, str]]:
    """What is wrong with the computers that the site file names."""
    known = [one.name for one in processes_of(site)] if site.hosts else []
    hosts: dict[str, str] = {}
    for host, names in site.hosts.items():
        for number, name in enumerate(names):
            place: Place = ("hosts", host, number)
            if name not in known:
                yield place, f"this site has no process {name}{close(name, known)}"
            elif name in hosts:
                yield place, f"{name} is on {hosts[name]} already"
            hosts.setdefault(name, host)
    if missing := [name for name in known if name not in hosts]:
        yield ("hosts",), f"on no computer: {', '.join(missing)}"
    if len(site.hosts) > 1 and endpoint.is_local(site.bus.router):
        yield ("hosts",), 'a socket reaches one computer only: set bus.router = "tls/<address>:<port>"'


def robots_with(site: SiteFile, job: str) -> dict[str, str]:
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
