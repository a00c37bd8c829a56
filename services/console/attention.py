"""What waits for a person, and what robots are doing: what the overview begins with."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rodeo.access.accounts import User
from rodeo.access.roles import Role
from rodeo.bus.queries import Committee, Organization
from rodeo.display.formatting import count, iec, kind, process
from rodeo.site.config import Site
from rodeo.site.names import robot_process
from rodeo.text.strict_json import Json
from services.console.glance import Summary
from services.console.heartbeats import ProcessState

_NEAR_M = 1.5
"""A robot that is no farther away is at a place."""
_BELOW = "#processes"
"""The overview's table of them."""
_BY_STATE = {
    "active": "members vote until {until}",
    "succeeded": "it was accepted, and can be queued",
    "ready": "anybody may have it carried out",
}
"""Proposals that wait for somebody."""


@dataclass(frozen=True)
class Need:
    """Something that waits for a person, and where that person does something about it."""

    text: str
    href: str
    alarm: bool = False


@dataclass(frozen=True)
class Seen:
    """What is known, and who looks at it."""

    site: Site
    summary: Summary
    processes: list[ProcessState]
    user: User
    charging: str | None
    """The kind of work that charges a robot."""
    moment: Callable[[float | None], str]
    """Site time in words."""


def needs(seen: Seen) -> list[Need]:
    """All of them, alarms first."""
    return sorted((one for find in _FINDERS for one in find(seen)), key=lambda one: not one.alarm)


def _processes(seen: Seen) -> Iterator[Need]:
    robots = {robot_process(seen.site, one.name): one.name for one in seen.site.robots}
    for one in seen.processes:
        name, href = robots.get(one.name) or process(one.name), "/operator" if one.name in robots else _BELOW
        if one.state in ("lost", "not ready"):
            yield Need(f"{name} is {one.state}: {one.doing}", href, alarm=True)
        elif one.state == "silent" and one.name in robots:
            yield Need(f"{name} was never heard", href, alarm=True)
        elif one.state == "ready":
            for warning in one.warnings:
                yield Need(f"{name} warns: {warning}", href)
    silent = [process(one.name) for one in seen.processes if one.state == "silent" and one.name not in robots]
    if silent:
        yield Need(f"Never heard: {', '.join(silent)}", _BELOW)


def _tasks(seen: Seen) -> Iterator[Need]:
    """Rulings that are challenged, and proofs that wait for auditors."""
    for task in seen.summary.cases:
        name, dispute = f"Task {task.id} ({kind(task.kind)})", task.dispute
        if dispute is not None and dispute.challenger is not None and not dispute.settled:
            waits = f"its ruling is challenged, and judges decide until {seen.moment(dispute.until)}"
            yield Need(f"{name}: {waits}", f"/tasks/{task.id}")
        elif task.judge == "auditor" or task.passed_on or task.judge_removed:
            until = task.standing.until if task.standing is not None else task.verdict_deadline
            href = "/work" if seen.user.has(Role.AUDITOR) else f"/tasks/{task.id}"
            what = "an auditor rules" if task.state == "submitted" else "an auditor can still rule"
            yield Need(f"{name}: {what} until {seen.moment(until)}", href)


def _proposals(seen: Seen) -> Iterator[Need]:
    """Those on which this person has not voted, and those that somebody has to take further."""
    for one in seen.summary.proposals:
        if one.state not in _BY_STATE or seen.user.participant in [each.voter_name for each in one.ballots]:
            continue
        waits = _BY_STATE[one.state].format(until=seen.moment(one.vote_end_s))
        yield Need(f"Proposal {one.number} (“{one.description[:60]}”): {waits}", "/proposals")


def _balances(seen: Seen) -> Iterator[Need]:
    """Wallets that cannot pay what they will have to, and judges whose votes do not count."""
    offers = [one for one in seen.summary.services if one.state == "active"]
    charges = [one.price_iec for one in offers if one.kind == seen.charging]
    robots = {one.name for one in seen.site.robots}
    for wallet in seen.summary.wallets:
        has = f"{wallet.name} has {iec(wallet.balance_iec)}"
        if wallet.name in robots and charges and wallet.balance_iec < min(charges):
            yield Need(f"{has}: too little for a charge ({iec(min(charges))})", "/treasury", alarm=True)
        elif wallet.name == "organization" and offers:
            least = min(one.price_iec for one in offers)
            if wallet.balance_iec < least:
                yield Need(f"{has}: too little for a task ({iec(least)})", "/treasury", alarm=True)
    organization = seen.summary.organization
    benches: list[Organization | Committee] = [] if organization is None else [organization]
    benches += [] if organization is None else organization.committees
    short = [
        one.name or str(one.seat)
        for bench in benches
        for one in bench.judges
        if one.stake_iec < bench.stake_needed(one)
    ]
    if short:
        yield Need(f"Judges whose stake is too low to judge: {', '.join(short)}", "/services")


def _things(seen: Seen) -> Iterator[Need]:
    """Things on the floor of which nobody has said whether a robot should take them."""
    waiting = [one for one in seen.summary.seen if one.state == "open"]
    if waiting and seen.user.has(Role.OPERATOR):
        yield Need(f"Robots have seen {count(len(waiting), 'thing')} on the floor", "#seen")


_FINDERS = (_processes, _tasks, _things, _proposals, _balances)


@dataclass(frozen=True)
class RobotState:
    """One robot as a line of a table."""

    name: str
    mind: ProcessState
    soc: float | None
    place: str


def robots(site: Site, lab: Json, processes: list[ProcessState], seen: Json) -> list[RobotState]:
    """`lab` is `scene.lab(site)`, and `seen` are `Live.map`'s robots."""
    by_name = {one.name: one for one in processes}
    found = []
    for robot in site.robots:
        mind = by_name.get(robot_process(site, robot.name)) or ProcessState(robot.name, "", "silent")
        at = seen.get(robot.name, {})
        soc = mind.soc if mind.soc is not None else at.get("soc")
        where = place(lab, at["x"], at["y"]) if "x" in at else "not seen"
        found.append(RobotState(robot.name, mind, soc, where))
    return found


def place(lab: Json, x_m: float, y_m: float) -> str:
    """Where that is, in words that change rarely."""
    named = [one for group in ("docks", "bins", "places", "furniture") for one in lab[group]]
    named = [one for one in named if one.get("kind") != "wall"]
    near = min(named, key=lambda one: math.hypot(one["x"] - x_m, one["y"] - y_m), default=None)
    if near is not None and math.hypot(near["x"] - x_m, near["y"] - y_m) <= _NEAR_M:
        return f"near {near['name']}"
    return f"{x_m:.0f} m east, {y_m:.0f} m north"
