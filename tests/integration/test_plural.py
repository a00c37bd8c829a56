"""A site with two bins and two docks: work is done, proven and paid at the second of each."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rodeo.evidence import Store, open_proof
from rodeo.processes import processes_of
from rodeo.witness import Drop, parse
from tests.integration.test_agent import Organization
from tests.support.site import LAB, RunningSite, write_site

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
"""


@pytest.fixture
def organization(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Organization]:
    running = RunningSite(write_site(tmp_path_factory.mktemp("plural"), chain_backend, SITE))
    running.start("router", "chain")
    running.deploy_contracts()
    names = [process.name for process in processes_of(running.site)]
    running.start(*(name for name in names if name not in ("router", "chain", "console")))
    organization = Organization(running)
    yield organization
    organization.close()
    running.stop()


@pytest.mark.timeout(500)
def test_a_task_names_the_second_bin_and_a_charge_the_second_dock(organization: Organization) -> None:
    running = organization.running
    params = {"item_id": "item1", "x_m": 4.6, "y_m": 1.2, "bin": "bin_east"}
    cleaning = organization.post("item1", params=params)
    organization.wait_for_event("TaskSettled", cleaning)
    task = organization.task(cleaning)
    logs = running.log("robot_agent") + running.log("itrash.bin_east")
    assert (task["attempt"], task["verdict"]) == (1, "accepted"), f"{task}\n{logs}"
    proof = open_proof(Store(running.site).fetch(task["proof_uri"], task["proof_sha256"]))
    said = [parse(one.payload) for one in proof.attestations()]
    assert {one.device for one in said if isinstance(one, Drop)} == {"bin_east"}

    # From the bin in the east the dock there is the nearer one.
    running.bus.query(f"rodeo/{running.site.org}/robot/panther1/charge")
    organization.wait_for_event("TaskSettled", cleaning + 1)
    charge = organization.task(cleaning + 1)
    assert (charge["kind"], charge["params"]["dock"]) == ("battery_charging", "dock_east")
    assert charge["verdict"] == "accepted", f"{charge}\n{running.log('charger.dock_east')}"
    proof = open_proof(Store(running.site).fetch(charge["proof_uri"], charge["proof_sha256"]))
    assert proof.binding is not None and proof.binding.device == "dock_east"
