"""The table of processes: what a site is made of. Launcher, status, compose and systemd files follow it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rodeo.config import Site, agent_process


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
    ProcessEntry("robot_sim", "services.robot_sim", "the simulated lab and robots"),
    ProcessEntry("robot_agent", "services.robot_agent", "the robot's mind"),
)


def processes_of(site: Site) -> list[ProcessEntry]:
    """The processes that `site` needs: no chain where it is elsewhere, a mind for each robot."""
    external = site.chain.backend == "external"
    wanted = [process for process in PROCESSES if not (external and process.name == "chain")]
    if len(site.robots) == 1:
        return wanted
    agent = BY_NAME["robot_agent"]
    minds = [
        replace(agent, name=agent_process(site, robot.name), arguments=("--robot", robot.name))
        for robot in site.robots
    ]
    return [process for process in wanted if process is not agent] + minds


BY_NAME: dict[str, ProcessEntry] = {process.name: process for process in PROCESSES}
assert len(BY_NAME) == len(PROCESSES), "process names must be unique"
