"""What the console says about a task before it costs anything."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from rodeo.bus.queries import Offer
from rodeo.commands.tasks import RegisterTask
from rodeo.kinds import kinds_of
from rodeo.site.config import Site
from services.console import posting
from tests.support.site import LAB
from tests.support.tasks import task


@pytest.fixture(scope="module")
def site() -> Site:
    return Site.load(LAB)


def problems(site: Site, request: RegisterTask) -> dict[str, str]:
    return posting.problems(site, kinds_of(site), request)


def cleaning(**fields: Any) -> RegisterTask:
    params = {"item_id": "item1", "x_m": 4.6, "y_m": 1.2, **fields.pop("params", {})}
    return RegisterTask(kind="waste_disposal", params=params, **{"reward_iec": Decimal(100), **fields})


def test_what_follows_from_the_item_need_not_be_given(site: Site) -> None:
    named = RegisterTask(kind="waste_disposal", params={"item_id": "item1"}, reward_iec=Decimal(100))
    assert problems(site, named) == {}
    unknown = RegisterTask(kind="waste_disposal", params={"item_id": "item99"}, reward_iec=Decimal(100))
    assert "params.item_id" in problems(site, unknown)


def charging(**params: Any) -> RegisterTask:
    values = {
        "robot": "panther1",
        "dock": "dock1",
        "soc_from": 0.4,
        "soc_target": 0.9,
        "energy_wh": 420.0,
        **params,
    }
    return RegisterTask(kind="battery_charging", params=values, reward_iec=Decimal(200))


def test_what_can_be_done_here_is_not_objected_to(site: Site) -> None:
    assert problems(site, cleaning()) == {}
    assert problems(site, charging()) == {}
    assert problems(site, RegisterTask(kind="window_cleaning", reward_iec=Decimal(0))) == {}


@pytest.mark.parametrize(
    ("request_", "field"),
    [
        (cleaning(params={"item_id": "item99"}), "params.item_id"),
        (cleaning(params={"x_m": 7.1}), "params.x_m"),
        (cleaning(params={"y_m": -0.01}), "params.x_m"),
        (cleaning(params={"x_m": 3.2, "y_m": 2.9}), "params.x_m"),
        (cleaning(params={"x_m": 5.2, "y_m": 4.45}), "params.x_m"),
        (cleaning(params={"x_m": "4.6"}), "params.x_m"),
        (cleaning(params={"x_m": float("nan")}), "params.x_m"),
        (cleaning(params={"x_m": True}), "params.x_m"),
        (cleaning(reward_iec=Decimal(0)), "reward_iec"),
        (cleaning(execution_window_s=5), "execution_window_s"),
        (charging(robot="panther9"), "params.robot"),
        (charging(dock="dock9"), "params.dock"),
        (charging(soc_from=0.9, soc_target=0.9), "params.soc_target"),
        (charging(soc_target=1.5), "params.soc_target"),
        (charging(soc_from=None), "params.soc_target"),
        (charging(energy_wh=None), "params.energy_wh"),
        (charging(energy_wh=0), "params.energy_wh"),
    ],
)
def test_what_cannot_be_done_here_is_named_by_its_field(
    site: Site, request_: RegisterTask, field: str
) -> None:
    assert list(problems(site, request_)) == [field]


def test_who_stands_in_the_way_is_named(site: Site) -> None:
    assert problems(site, cleaning(params={"x_m": 3.2, "y_m": 2.9})) == {"params.x_m": "desk2 stands there"}


def test_a_site_without_robots_and_items_says_so(site: Site) -> None:
    bare = site.model_copy(update={"robots": [], "items": []})
    assert problems(bare, cleaning())["params.item_id"] == "this site has no item"
    assert problems(bare, charging())["params.robot"] == "this site has no robot"


def offer(number: int, provider: str, **fields: Any) -> Offer:
    """With what the form reads of it."""
    common = {"id": number, "provider": provider, "provider_name": None, "kind": "battery_charging"}
    common |= {"task_id": None}
    return Offer.model_construct(**{**common, "price_iec": Decimal(10 + number), "state": "active", **fields})


def test_a_provider_can_be_named_who_has_several_services_that_take_the_kind() -> None:
    one, other = f"0x{'1' * 40}", f"0x{'2' * 40}"
    services = [
        offer(1, one, provider_name="east"),
        offer(2, one, provider_name="east", state="paused"),
        offer(3, one, kind="waste_disposal"),
        offer(4, other, provider_name="west"),
        offer(5, other, state="retired"),
    ]
    assert posting.hireable(services, "battery_charging") == {
        one: "any of east (2 services)",
        "1": "1: east, 11 IEC",
        "2": "2: east, 12 IEC, paused",
        "4": "4: west, 14 IEC",
    }
    assert posting.hireable(services, None) == {}


def test_a_service_that_nobody_may_name_is_not_offered_for_it() -> None:
    assert posting.hireable([offer(1, f"0x{'1' * 40}", namers="nobody")], "battery_charging") == {}


def test_a_task_is_matched_only_with_a_service_that_is_free_fits_and_has_not_had_it() -> None:
    one, other = f"0x{'1' * 40}", f"0x{'2' * 40}"
    waits = task("open", kind="battery_charging", reward_iec="13", passed=[{"provider": other}])
    services = [
        offer(1, one, provider_name="east"),
        offer(2, one, task_id=7),
        offer(3, one, kind="waste_disposal"),
        offer(3, one, state="paused"),
        offer(4, one),
        offer(2, other),
    ]
    assert posting.fitting(waits, services) == {"1": "1: east, 11 IEC"}


@pytest.mark.parametrize(("value", "said"), [(f"0x{'1' * 40}", "provider"), ("12", "service_id")])
def test_what_is_chosen_is_what_the_request_says(value: str, said: str) -> None:
    request = cleaning(**posting.hired(value))
    named = {"provider": request.provider, "service_id": request.service_id}
    assert str(named.pop(said)) == value
    assert list(named.values()) == [None]
