"""What a robot asks for its work."""

from __future__ import annotations

from decimal import Decimal

import pytest
from pydantic import ValidationError

from rodeo.money.pricing import CostPlus, Experience, Fixed, Learned, PricingConfig, Situation

HOUR_S = 3600.0


def test_a_fixed_price_is_the_kinds_unless_the_site_file_sets_another() -> None:
    now = Situation(list_iec=Decimal(100), energy_wh=50.0)
    assert Fixed().price(now) == 100
    assert Fixed(price_iec=Decimal(80)).price(now) == 80


def test_cost_plus_asks_what_energy_and_wear_cost_and_a_margin() -> None:
    pricing = CostPlus(method="cost_plus", margin=0.5, wear_iec_per_km=100.0)
    # 20 Wh at 0.5 IEC, 50 m at 100 + 300 IEC/km: 10 + 20 IEC, and half of that.
    now = Situation(list_iec=Decimal(100), energy_wh=20.0, way_km=0.05, iec_per_wh=0.5, care_iec_per_km=300.0)
    assert pricing.price(now) == Decimal("45.00")


def test_cost_plus_asks_the_kinds_price_before_anything_was_measured() -> None:
    assert CostPlus(method="cost_plus").price(Situation(list_iec=Decimal(100), iec_per_wh=1.0)) == 100


def test_learning_tries_each_price_and_then_keeps_to_what_brought_most() -> None:
    pricing = Learned(method="learned", prices_iec=(Decimal(60), Decimal(90), Decimal(120)))
    # The people of this test pay at most 90 IEC, four times in an hour.
    history: dict[Decimal, Experience] = {}
    asked = []
    for _ in range(300):
        price = pricing.price(Situation(list_iec=Decimal(100), history=history))
        asked.append(price)
        before = history.get(price, Experience())
        paid_iec = before.paid_iec + (4 * price if price <= 90 else 0)
        history[price] = Experience(before.offered_s + HOUR_S, paid_iec)
    assert asked[:3] == [120, 90, 60]
    assert asked[-100:].count(Decimal(90)) > 90


def test_a_change_that_is_too_small_is_left_out() -> None:
    pricing = CostPlus(method="cost_plus", min_change=0.05)
    assert not pricing.is_worth(Decimal("104.9"), Decimal(100))
    assert pricing.is_worth(Decimal(95), Decimal(100))
    assert not CostPlus(method="cost_plus", min_change=0).is_worth(Decimal(100), Decimal(100))


def test_the_site_file_says_it_for_a_robot_and_for_single_kinds() -> None:
    config = PricingConfig.model_validate(
        {"default": {"method": "fixed", "price_iec": 90}, "kinds": {"sweeping": {"method": "cost_plus"}}}
    )
    assert config.of("waste_disposal") == Fixed(price_iec=Decimal(90))
    assert config.of("sweeping") == CostPlus(method="cost_plus")
    with pytest.raises(ValidationError):
        PricingConfig.model_validate({"default": {"method": "learned", "prices_iec": [90]}})
