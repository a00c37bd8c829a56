"""Rewards that rise while a task waits."""

from __future__ import annotations

from decimal import Decimal

from rodeo.money.rewards import Rise


def test_a_reward_rises_by_its_part_and_never_above_the_highest() -> None:
    rise, rewards = Rise(up_to_iec=Decimal(120), by=0.1), [Decimal(100)]
    while (higher := rise.after(rewards[-1])) is not None:
        rewards.append(higher)
    assert rewards == [100, 110, 120]


def test_a_reward_that_is_next_to_nothing_rises_all_the_same() -> None:
    assert Rise(up_to_iec=Decimal(1)).after(Decimal(0)) == Decimal("0.01")
