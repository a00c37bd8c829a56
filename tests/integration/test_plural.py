"""Two bins, two docks, two robots: work is done at the second bin, and both docks charge at the same time."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from typing import Any

import pytest

from rodeo.evidence.proof import open_proof
from rodeo.evidence.store import Store
from rodeo.site.config import Site
from rodeo.site.processes import processes_of
from rodeo.witness.statement import Drop, parse
from rodeo_testing.waiting import HANG_S
from tests.support.live import LiveDao, living
from tests.support.site import LAB, NewSite

pytestmark = pytest.mark.long

PLURAL = LAB.with_name("plural.toml").read_text()
SITE = f"""clock.speed = 20
clock.idle_speed = 400
agent.explore_when_idle = false

{PLURAL[PLURAL.index("[lab]") :].replace("http_port = 809", "http_port = 0 # ")}
[[robots]]
name = "panther1"
pose = {{ x_m = 1.4, y_m = 1.3 }}
battery = {{ soc = 0.8 }}

[[robots]]
name = "panther2"
pose = {{ x_m = 3.6, y_m = 4.1 }}
battery = {{ soc = 0.8 }}

[[participants]]
name = "seller"
kinds = ["battery_charging"]
"""


def assert_paid_by_the_rates(charge: dict[str, Any]) -> None:
    """In one charge from 80 % to 95 %, which lies in one or two hours, all energy costs one of two rates."""
    ordered_kwh = Decimal(str(charge["params"]["energy_wh"])) / 1000
    paid_iec = Decimal(charge["paid_iec"])
    assert Decimal("0.7") * ordered_kwh * 120 < paid_iec < Decimal("1.1") * ordered_kwh * 180
    assert paid_iec < Decimal(charge["reward_iec"]) == Decimal(charge["price_iec"])


@pytest.fixture
def organization(new_site: NewSite) -> Iterator[LiveDao]:
    path = new_site(SITE)
    names = [process.name for process in processes_of(Site.load(path)) if process.name != "console"]
    with living(path, *names, wait_s=300.0) as organization:
        yield organization


def test_a_task_names_the_second_bin_and_two_docks_charge_at_once(organization: LiveDao) -> None:
    running = organization.running
    params = {"item_id": "item1", "x_m": 4.6, "y_m": 1.2, "bin": "bin_east"}
    cleaning = organization.clean("item1", params=params)
    organization.wait_for_event("TaskSettled", cleaning)
    task = organization.task(cleaning)
    worker = task["executor_name"]
    logs = running.log(f"robot_agent.{worker}") + running.log("itrash.bin_east")
    assert (task["attempt"], task["verdict"]) == (1, "accepted"), f"{task}\n{logs}"
    proof = open_proof(Store(running.site).fetch(task["proof_uri"], task["proof_sha256"]))
    said = [parse(one.payload) for one in proof.attestations()]
    assert {one.device for one in said if isinstance(one, Drop)} == {"bin_east"}

    # Who sells charges without a dock is cheaper, has waited longer, and gets none of them.
    key = f"rodeo/{running.site.org}/wallet/seller/register_service"
    cheap = running.bus.query(key, {"kind": "battery_charging", "price_iec": "1"}, timeout_s=HANG_S)
    # The second robot orders where nobody charges yet.
    robots, docks = [one.name for one in running.site.robots], []
    hired: set[int] = set()
    charges = list(range(cleaning + 1, cleaning + 1 + len(robots)))
    for charge_id, robot in zip(charges, robots, strict=True):
        running.bus.query(f"rodeo/{running.site.org}/robot/{robot}/charge")
        organization.wait_for_event("TaskAssigned", charge_id)
    for charge_id, robot in zip(charges, robots, strict=True):
        organization.wait_for_event("TaskSettled", charge_id)
        charge = organization.task(charge_id)
        assert (charge["kind"], charge["params"]["robot"]) == ("battery_charging", robot)
        assert charge["service_id"] == charge["requested_service_id"] != cheap["service_id"]
        assert charge["executor_name"] == "organization"
        hired.add(charge["service_id"])
        docks.append(charge["params"]["dock"])
        assert charge["verdict"] == "accepted", f"{charge}\n{running.log(f'charger.{docks[-1]}')}"
        assert_paid_by_the_rates(charge)
        proof = open_proof(Store(running.site).fetch(charge["proof_uri"], charge["proof_sha256"]))
        assert proof.binding is not None and proof.binding.device == docks[-1]
    assert sorted(docks) == ["dock_east", "dock_west"] and len(hired) == 2
    told = [(event.name, event.task_id) for event in organization.events]
    assert max(told.index(("TaskAssigned", one)) for one in charges) < min(
        told.index(("ProofSubmitted", one)) for one in charges
    )
