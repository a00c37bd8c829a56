"""Decision: the robot's policy, row by row."""

from __future__ import annotations

import pytest

from rodeo.bus.messages import Task
from rodeo.robot.errors import TaskFailed
from rodeo.site.config import Site
from rodeo.site.sections import AgentConfig, ClockConfig
from services.robot_agent.decision import (
    Intent,
    Situation,
    decide,
    require_time_for_verdict,
    require_time_for_work,
    takes_work,
)
from tests.support.site import LAB
from tests.support.tasks import task

AGENT = AgentConfig(charge_below=0.5, charge_target=0.95, explore_when_idle=True)


JOB = task("assigned")


@pytest.mark.parametrize(
    ("soc", "assignment", "charge", "intent"),
    [
        (0.9, None, None, Intent.EXPLORE),
        (0.9, JOB, None, Intent.WORK),
        (0.4, JOB, None, Intent.WORK),  # enough energy: finish what was taken on first
        (0.4, None, None, Intent.BUY_CHARGE),
        (0.4, None, "open", Intent.AWAIT_CHARGE),
        (0.4, None, "assigned", Intent.DOCK),
        (0.4, JOB, "assigned", Intent.DOCK),
        (0.96, JOB, "assigned", Intent.WORK),  # full, and somebody waits
        (0.96, None, "assigned", Intent.DOCK),  # full, but the session is not over
        (0.96, None, "submitted", Intent.EXPLORE),
        (0.4, None, "submitted", Intent.REST),  # paid for less than hoped; do not buy two at once
    ],
)
def test_what_the_robot_does_next(
    soc: float, assignment: Task | None, charge: str | None, intent: Intent
) -> None:
    situation = Situation(soc, assignment, task(charge) if charge else None)
    assert decide(situation, AGENT) == intent


def test_a_robot_that_explored_enough_rests() -> None:
    assert decide(Situation(0.9, None, None, explored_enough=True), AGENT) == Intent.REST


def test_an_assignment_that_the_battery_does_not_last_for_waits_for_a_charge() -> None:
    assert decide(Situation(0.12, JOB, None, battery_suffices=False), AGENT) == Intent.BUY_CHARGE


def test_exploring_can_be_turned_off() -> None:
    stay = AGENT.model_copy(update={"explore_when_idle": False})
    assert decide(Situation(0.9, None, None), stay) == Intent.REST


@pytest.mark.parametrize(
    ("situation", "intent"),
    [
        (Situation(0.9, None, None, paused=True), Intent.REST),
        (Situation(0.4, None, None, paused=True), Intent.REST),  # it buys nothing by itself
        (Situation(0.9, JOB, None, paused=True), Intent.REST),
        (Situation(0.9, JOB, None, paused=True, begun=True), Intent.WORK),  # what is begun is finished
        (Situation(0.4, None, task("assigned"), paused=True), Intent.DOCK),  # so is a charge
        (Situation(0.4, None, None, paused=True, charge_ordered=True), Intent.BUY_CHARGE),
        (Situation(0.9, None, None, charge_ordered=True), Intent.BUY_CHARGE),
        (Situation(0.9, JOB, None, charge_ordered=True), Intent.BUY_CHARGE),
        (Situation(0.9, JOB, None, charge_ordered=True, begun=True), Intent.WORK),
    ],
)
def test_operators_orders_come_before_the_robots_own_plans(situation: Situation, intent: Intent) -> None:
    assert decide(situation, AGENT) == intent


def off_duty(
    soc: float = 0.9, assignment: Task | None = None, charge: str | None = None, **more: bool
) -> Situation:
    return Situation(soc, assignment, task(charge) if charge else None, off_duty=True, **more)


@pytest.mark.parametrize(
    ("situation", "intent"),
    [
        (off_duty(), Intent.OFF),
        (off_duty(0.3), Intent.OFF),  # it buys nothing by itself
        (off_duty(paused=True), Intent.OFF),
        (off_duty(assignment=JOB, begun=True), Intent.WORK),  # what is begun is finished
        (off_duty(assignment=JOB), Intent.WORK),  # so is what it was given while it took work
        (off_duty(assignment=JOB, paused=True), Intent.OFF),
        (off_duty(0.12, JOB, battery_suffices=False), Intent.BUY_CHARGE),
        (off_duty(0.12, JOB, "open", battery_suffices=False), Intent.OFF),  # until somebody takes the charge
        (off_duty(0.4, charge="open"), Intent.OFF),
        (off_duty(0.4, charge="assigned"), Intent.DOCK),
        (off_duty(0.96, charge="assigned"), Intent.DOCK),
        (off_duty(charge_ordered=True), Intent.BUY_CHARGE),  # a person asks for it
    ],
)
def test_outside_its_working_hours_a_robot_ends_what_it_was_given_and_is_off(
    situation: Situation, intent: Intent
) -> None:
    assert decide(situation, AGENT) == intent


@pytest.mark.parametrize(
    ("situation", "open_to_work"),
    [
        (Situation(0.9, None, None), True),
        (Situation(0.3, None, None, battery_suffices=False), False),
        (Situation(0.9, None, None, paused=True), False),
        (off_duty(), False),
        (off_duty(assignment=JOB, begun=True), False),
        (Situation(0.9, None, None, charge_ordered=True), False),
        (Situation(0.6, None, task("open")), False),
        (Situation(0.6, None, task("assigned")), False),
        (Situation(0.9, None, task("submitted")), True),
    ],
)
def test_the_service_is_open_only_while_the_robot_can_do_what_it_offers(
    situation: Situation, open_to_work: bool
) -> None:
    assert takes_work(situation) == open_to_work


@pytest.mark.parametrize(
    ("clock", "needs_s"),
    [
        (ClockConfig(source="wall", speed=1), 240.0),
        (ClockConfig(speed=10), 2400.0),
        (ClockConfig(speed=0.5), 240.0),
        (ClockConfig(speed=10, idle_speed=400), 96_000.0),  # while it is judged, somebody may charge
        (ClockConfig(speed=10, idle_speed=0), 12_000.0),
        (ClockConfig(source="wall", speed=10, idle_speed=400), 240.0),
        (ClockConfig(speed=0), 12_000.0),  # as fast as the machine allows
    ],
)
def test_no_work_is_done_for_a_verdict_that_may_come_too_late(clock: ClockConfig, needs_s: float) -> None:
    site = Site.load(LAB).model_copy(update={"clock": clock})
    assert site.min_verdict_window_s == needs_s
    require_time_for_verdict(JOB.model_copy(update={"verdict_window_s": needs_s}), site)
    with pytest.raises(TaskFailed) as refused:
        require_time_for_verdict(JOB.model_copy(update={"verdict_window_s": needs_s - 1}), site)
    assert refused.value.details == {"verdict_window_s": needs_s - 1, "needs_s": needs_s}


def test_a_window_that_is_too_short_for_the_work_is_refused_while_that_costs_nothing() -> None:
    """Whoever posts such a task would have the penalties of every robot that takes it."""
    task = JOB.model_copy(update={"assigned": 1000.0, "execution_deadline": 1060.0, "grace_s": 20})
    require_time_for_work(task, 50.0, now_s=1005.0)
    with pytest.raises(TaskFailed) as refused:
        require_time_for_work(task, 90.0, now_s=1005.0)
    assert refused.value.details == {"left_s": 55, "needs_s": 90}
    agreed = task.model_copy(update={"accepted": True})
    require_time_for_work(agreed, 90.0, now_s=1021.0)  # from here on it can only try
    with pytest.raises(TaskFailed):
        require_time_for_work(agreed, 90.0, now_s=1020.0)
    with pytest.raises(TaskFailed):
        require_time_for_work(task, 90.0, now_s=1021.0)  # it has not agreed yet


def test_the_sites_own_tasks_leave_time_for_the_verdict() -> None:
    site = Site.load(LAB)
    assert site.economy.verdict_window_s >= site.min_verdict_window_s
