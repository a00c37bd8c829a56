"""What applies at which hour of the site's day."""

from __future__ import annotations

from decimal import Decimal

import pytest

from rodeo.charging.tariff import applying_between, hourly_mean_iec
from rodeo.site.sections import RateConfig

DAY_S = 20_000 * 86_400
RATES = [RateConfig(from_hour=hour, iec=Decimal(iec)) for hour, iec in ((22, 10), (6, 30), (12, 20))]


@pytest.mark.parametrize(
    ("from_h", "to_h", "found"),
    [
        (7.0, 7.5, {30}),
        (11.9, 12.1, {30, 20}),
        (5.0, 5.9, {10}),
        (23.5, 29.5, {10}),
        (21.0, 31.0, {20, 10, 30}),
        (3.0, 300.0, {10, 20, 30}),
        (13.0, 36.5, {10, 20, 30}),
        (12.0, 12.0, {20}),
    ],
)
def test_what_applies_at_some_time_between_two(from_h: float, to_h: float, found: set[int]) -> None:
    between = applying_between(RATES, DAY_S + from_h * 3600, DAY_S + to_h * 3600)
    assert {int(rate.iec) for rate in between} == found


def test_the_mean_of_a_day() -> None:
    assert hourly_mean_iec(RATES) == Decimal(8 * 10 + 6 * 30 + 10 * 20) / 24
