"""Faults of a whole site while its robot works, and of the simulator."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

from bench.faults.case import BASE, Case, Script, add, case
from bench.faults.disks import FULL
from bench.faults.files import give_up_chain, halve
from bench.faults.lab import Lab, need
from rodeo.errors import RemoteError
from rodeo.runtime.sim_clock import SimClock

WHOLE = (*BASE, "oracle", "itrash", "charger", "robot_sim", "robot_agent")
FAST = """clock.speed = 20
clock.idle_speed = 400
agent.explore_when_idle = false
agent.charge_below = 0.0
"""
_case_at_work = partial(case, processes=WHOLE, extra=FAST, asks=False)
"""A fault while the robot works. Its own task is what is asked for."""


def _working(lab: Lab) -> None:
    """A task of cleaning, and the robot in the middle of it."""
    lab.post("meanwhile", max_attempts=3, reward_iec="100")
    lab.wait_said("robot_agent: .*carrying item1")
    lab.mark()


def _paid(lab: Lab) -> None:
    task = lab.wait_ended("meanwhile")
    need(task["state"] == "settled", f"the task is {task['state']}: {task['reason']}")


def _killed(*names: str) -> Script:
    def script(lab: Lab) -> Iterator[None]:
        _working(lab)
        lab.kill(*names)
        yield
        yield
        _paid(lab)

    return script


for _names in (("robot_agent",), ("robot_sim",), ("itrash",), WHOLE):
    add(
        Case(
            name=f"killed_{'whole_site' if _names == WHOLE else _names[0]}_while_carrying",
            area="robot",
            breaks=f"SIGKILL to {', '.join(_names)} while the robot carries an item",
            script=_killed(*_names),
            processes=WHOLE,
            extra=FAST,
            asks=False,
        )
    )


@_case_at_work("the bridge hangs while the agent asks it who signs", held_s=8.0)
def frozen_bridge_while_carrying(lab: Lab) -> Iterator[None]:
    _working(lab)
    yield from lab.frozen("bridge")
    _paid(lab)
    need("not registered as a bin" not in lab.log("robot_agent"), "the bin's signer is called a stranger's")


@_case_at_work(
    "the disk with the agent's folder is full while the robot carries an item",
    said=FULL,
    small_disk="robot_agent",
    held_s=6.0,
)
def disk_full_agent(lab: Lab) -> Iterator[None]:
    _working(lab)
    pid = lab.pid("robot_agent")
    assert lab.disk is not None
    lab.disk.fill()
    yield
    need(lab.pid("robot_agent") == pid, "the agent ended and was started again")
    need("Traceback" not in lab.said(), "a traceback")
    lab.disk.free()
    yield
    lab.wait_ended("meanwhile")


@_case_at_work("the agent's journal of a task is cut", said=r"journal\.json")
def agent_journal_cut(lab: Lab) -> Iterator[None]:
    _working(lab)
    lab.down("robot_agent")
    (path,) = lab.data.glob("robot_agent/**/journal.json")
    whole = halve(path)
    lab.up("robot_agent")
    yield
    need("Traceback" not in lab.said(), "a traceback")
    if path.exists():
        path.write_bytes(whole)
    lab.restart_if_down("robot_agent")
    yield
    lab.wait_ended("meanwhile")


@_case_at_work("the second half of the agent's recording is cut off")
def recording_cut(lab: Lab) -> Iterator[None]:
    _working(lab)
    lab.down("robot_agent")
    for path in lab.data.glob("robot_agent/**/*.mcap"):
        with path.open("r+b") as file:
            file.truncate(path.stat().st_size // 2)
    lab.up("robot_agent")
    yield
    yield
    lab.wait_ended("meanwhile")


@_case_at_work("the chain is given up and a new one begun: its first task is done")
def new_chain_under_the_agent(lab: Lab) -> Iterator[None]:
    lab.post("on the old chain", reward_iec="100", params={"item_id": "item99", "x_m": 4.6, "y_m": 1.2})
    lab.wait_ended("on the old chain")
    give_up_chain(lab)
    yield
    yield
    lab.wait(
        lambda: any(one["kind"] == "waste_disposal" for one in lab.state("services")["services"]),
        "the agent does not offer its service on the new chain",
    )
    lab.post("meanwhile", reward_iec="100")
    _paid(lab)


# -- the simulator -----------------------------------------------------------------------------------------

SIMULATED = (*BASE, "robot_sim")


@case(
    "the simulator hangs (SIGSTOP) for 7 s at speed 1",
    said=r"clock .*behind|heartbeat stopped",
    processes=SIMULATED,
    extra="clock.speed = 1\nclock.idle_speed = 1\n",
    held_s=7.0,
)
def clock_behind(lab: Lab) -> Iterator[None]:
    yield from lab.frozen("robot_sim")
    clock = SimClock(lab.bus.session, lab.site.bus.domain_id)
    lab.wait(lambda: clock.wait_ready(lab.closing), "no clock")
    lab.wait(lambda: abs(time.time() - clock.now_s()) < 1.0, "the clock is not the wall's again")


@case("the simulator's world file is cut", said=r"world\.state", processes=SIMULATED)
def world_file_cut(lab: Lab) -> Iterator[None]:
    lab.down("robot_sim")
    path = lab.data / "robot_sim" / "world.state"
    whole = halve(path)
    lab.up("robot_sim")
    lab.wait_said(r"world\.state")
    need("another lab" not in lab.said(), "a cut file is called another lab")
    lab.wait(
        lambda: "restarting would not help" in lab.said() or lab.starts("robot_sim") > 1,
        "the launcher did not give robot_sim up",
    )
    need(lab.starts("robot_sim") <= 1, f"robot_sim was started {lab.starts('robot_sim')} times")
    yield
    path.write_bytes(whole)
    lab.restart_if_down("robot_sim")
    yield


@case(
    "a robot offers a kind of work that it cannot do", said=r"cannot|can not|does not do|unable", asks=False
)
def service_that_cannot_be_done(lab: Lab) -> Iterator[None]:
    lab.command(
        "organization", "allow_kind", kind="window_cleaning", judge="auditor", request_id="allow windows"
    )
    refused = ""
    try:
        lab.command(
            "panther1",
            "register_service",
            kind="window_cleaning",
            price_iec="5",
            request_id="windows",
        )
    except RemoteError as error:
        refused = f"{error.code}: {error}"
    need(refused, "a robot may offer to clean windows")
    lab.say(refused)
    yield
    yield
