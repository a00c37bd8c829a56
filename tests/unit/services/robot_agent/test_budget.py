"""How long something may be done in each hour."""

from __future__ import annotations

from services.robot_agent.budget import HourlyBudget

HOUR_S = 3600.0


def test_it_is_used_up_once_so_much_was_used_and_new_in_the_next_hour() -> None:
    budget = HourlyBudget(30.0)
    assert not budget.is_used_up(10.0)
    budget.use(10.0, 20.0)
    assert not budget.is_used_up(40.0)
    budget.use(40.0, 15.0)
    assert budget.is_used_up(60.0)
    assert budget.renewed_s(60.0) == HOUR_S
    assert not budget.is_used_up(HOUR_S)


def test_the_whole_hour_is_no_limit() -> None:
    budget = HourlyBudget(HOUR_S)
    budget.use(0.0, 2 * HOUR_S)
    assert not budget.is_used_up(1.0)


def test_nothing_is_allowed_where_the_limit_is_nothing() -> None:
    assert HourlyBudget(0.0).is_used_up(1.0)
