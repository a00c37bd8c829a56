"""What the robot does next, from its situation. A pure function: the whole policy can be read here."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from rodeo.bus.messages import Task
from rodeo.robot.errors import TaskFailed
from rodeo.site.config import Site
from rodeo.site.sections import AgentConfig


class Intent(StrEnum):
    WORK = "work"
    DOCK = "dock"
    BUY_CHARGE = "buy charge"
    AWAIT_CHARGE = "await charge"
    """A charge is bought and nobody has taken the task yet."""
    EXPLORE = "explore"
    REST = "rest"
    OFF = "off"
    """Switched off until its working hours begin."""


@dataclass(frozen=True)
class Situation:
    soc: float
    assignment: Task | None
    """The task to do next."""
    charge: Task | None
    """The robot's own charging task, if one is live."""
    battery_suffices: bool = True
    """Whether the battery lasts for the assignment, or else for one kind of work, and the way home."""
    able: frozenset[str] = frozenset()
    """Kinds of work for which the battery lasts, whatever the task; empty with an assignment."""
    begun: bool = False
    """Work on the assignment has begun."""
    paused: bool = False
    charge_ordered: bool = False
    off_duty: bool = False
    """The robot's working hours are over."""
    explored_enough: bool = False
    """It has explored for as long as it may in this hour."""


def require_time_for_verdict(task: Task, site: Site) -> None:
    """Before work is done for it: raises TaskFailed when an honest proof might not be judged in time, and so
    not be paid, because the task's verdict window is too short for the oracle."""
    if task.verdict_window_s < site.min_verdict_window_s:
        raise TaskFailed(
            "the task's verdict window is too short",
            verdict_window_s=task.verdict_window_s,
            needs_s=site.min_verdict_window_s,
        )


def require_time_for_work(task: Task, duration_s: float, now_s: float) -> None:
    """Before the task is accepted, and while it can be given back without a penalty: raises TaskFailed when
    the work is expected to take longer than is left. Later the robot tries: the penalty is due either way."""
    if task.execution_deadline is None:
        return
    left_s = task.execution_deadline - now_s
    free = not task.accepted or now_s <= task.grace_ends_s
    if free and duration_s > left_s:
        raise TaskFailed(
            "the task's execution window is too short", left_s=round(left_s), needs_s=round(duration_s)
        )


def takes_work(now: Situation) -> bool:
    """Whether the robot's service should be open to new tasks."""
    charging = now.charge is not None and now.charge.state != "submitted"
    return not (now.off_duty or now.paused or now.charge_ordered or charging) and now.battery_suffices


def decide(now: Situation, agent: AgentConfig) -> Intent:
    """What the robot does next."""
    return reasoned(now, agent)[0]


def reasoned(now: Situation, agent: AgentConfig) -> tuple[Intent, str]:
    """What the robot does next, and why.

    Outside its working hours a robot ends what it was given before: an assignment, a charge that began.
    """
    waits = now.assignment is not None and (now.begun or not now.paused)
    can_work = waits and now.battery_suffices
    charge_state = now.charge.state if now.charge is not None else None
    full = now.soc >= agent.charge_target
    if charge_state == "assigned" and not (full and can_work):
        return Intent.DOCK, "a dock has taken the charging task"
    if can_work and not (now.charge_ordered and not now.begun):
        return Intent.WORK, "a task is assigned and the battery lasts for it"
    low = now.soc < agent.charge_below or waits
    wanted = now.charge_ordered or (low and (waits or not (now.paused or now.off_duty)))
    if wanted and charge_state is None:
        if now.charge_ordered:
            return Intent.BUY_CHARGE, "an operator ordered a charge"
        if waits:
            return Intent.BUY_CHARGE, "a task is assigned and the battery does not last for it"
        return Intent.BUY_CHARGE, f"the battery is below {agent.charge_below:.0%}"
    if now.off_duty:
        return Intent.OFF, "its working hours are over"
    if charge_state == "open":
        return Intent.AWAIT_CHARGE, "no dock has taken the charging task yet"
    if now.paused:
        return Intent.REST, "an operator paused it, or there is no room on its disk"
    if low:
        return Intent.REST, "the battery is low and its charge is not settled yet"
    if not agent.explore_when_idle:
        return Intent.REST, "no task is assigned, and it does not explore"
    if now.explored_enough:
        return Intent.REST, f"it has explored {agent.explore_min_per_h:g} min in this hour"
    return Intent.EXPLORE, "no task is assigned"
