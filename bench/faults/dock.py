"""Faults while a robot is charged: dock, battery and time are played, everything else is real."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

from bench.faults.case import BASE, Case, Script, add, case
from bench.faults.disks import FULL, full
from bench.faults.files import give_up_chain, halve
from bench.faults.lab import Lab, need
from bench.faults.net import Link
from rodeo.dao import Participant
from rodeo_testing.dock import Buyer, Hardware
from tests.support.site import free_port

DOCK = (*BASE, "charger")
HALF_WH = 40.0
ORDER = {"robot": "panther1", "dock": "dock1", "soc_from": 0.5, "soc_target": 0.6, "energy_wh": 100.0}


class Charge:
    """One order, from the plug to the payment."""

    def __init__(self, lab: Lab) -> None:
        self.lab = lab
        self.hardware = Hardware(lab)
        self.hardware.fast, self.hardware.target_soc = False, 0.6
        self.buyer = Buyer(lab, self.hardware)

    def begin(self) -> None:
        """Buy, dock, and charge until it is half done."""
        lab = self.lab
        lab.order("charge", "panther1", kind="battery_charging", reward_iec="200", params=ORDER)
        lab.assigned("charge")
        self.buyer.begin(Participant(lab.bus, lab.site.org, "panther1").task(lab.asked["charge"]))
        self.hardware.docked = True
        lab.wait(lambda: self.hardware.energy_wh > HALF_WH, "nothing is delivered")

    def finish(self) -> None:
        """Until the proof is there; judge it as an oracle would."""
        self.hardware.fast = True
        lab = self.lab
        task_id = lab.asked["charge"]
        lab.wait(lambda: lab.state(f"task/{task_id}")["state"] == "submitted", "no proof of the charge came")
        lab.judge("charge")
        task = lab.wait_ended("charge")
        need(task["state"] == "settled", f"the charge is {task['state']}: {task['reason']}")

    def close(self) -> None:
        self.buyer.close()
        self.hardware.close()


@contextmanager
def charging(lab: Lab) -> Iterator[Charge]:
    """A site whose robot is being charged."""
    lab.up("router")
    charge = Charge(lab)
    try:
        lab.start()
        charge.begin()
        lab.mark()
        yield charge
    finally:
        charge.close()


def _killed(*names: str) -> Script:
    def script(lab: Lab) -> Iterator[None]:
        with charging(lab) as charge:
            lab.kill(*names)
            yield
            yield
            charge.finish()

    return script


def _frozen(name: str) -> Script:
    def script(lab: Lab) -> Iterator[None]:
        with charging(lab) as charge:
            yield from lab.frozen(name)
            charge.finish()

    return script


for _names in (("charger",), ("router",), ("chain", "bridge")):
    add(
        Case(
            name=f"killed_{'_and_'.join(_names)}_while_charging",
            area="dock",
            breaks=f"SIGKILL to {', '.join(_names)} while a robot is charged",
            script=_killed(*_names),
            processes=DOCK,
            works=False,
        )
    )

for _name in ("charger", "bridge"):
    add(
        Case(
            name=f"frozen_{_name}_while_charging",
            area="dock",
            breaks=f"the {_name} hangs (SIGSTOP) for 8 s while a robot is charged",
            script=_frozen(_name),
            processes=DOCK,
            works=False,
            held_s=8.0,
        )
    )


@case(
    "nothing gets through between charger and router for 20 s while a robot is charged",
    processes=DOCK,
    extra=f'bus.router = "tcp/127.0.0.1:{free_port()}"\nbus.open = true\n',
    works=False,
    held_s=20.0,
)
def charger_cut_from_the_bus(lab: Lab) -> Iterator[None]:
    link = lab.enter(Link(int(lab.site.bus.router.rpartition(":")[2])))
    lab.sites["charger"] = lab.variant("cut", f'bus.router = "tcp/127.0.0.1:{link.port}"\n', data=False)
    with charging(lab) as charge:
        link.cut()
        yield
        link.heal()
        yield
        charge.finish()


@case(
    "the disk with the charger's folder is full while a robot is charged",
    said=FULL,
    processes=DOCK,
    small_disk="charger",
    works=False,
    held_s=6.0,
)
def disk_full_charger(lab: Lab) -> Iterator[None]:
    with charging(lab) as charge:
        yield from full(lab)
        charge.finish()


@case("the charger's job is cut while a robot is charged", said=r"job\.json", processes=DOCK, works=False)
def charger_job_cut(lab: Lab) -> Iterator[None]:
    with charging(lab) as charge:
        lab.down("charger")
        path = lab.data / "charger" / "job.json"
        whole = halve(path)
        lab.up("charger")
        yield
        path.write_bytes(whole)
        lab.restart_if_down("charger")
        yield
        charge.finish()


@case(
    "the chain is given up and a new one begun: the service is offered again",
    processes=DOCK,
    works=False,
    asks=False,
)
def new_chain_under_the_charger(lab: Lab) -> Iterator[None]:
    lab.up("router")
    hardware = lab.enter(closing(Hardware(lab)))
    hardware.fast = False
    lab.start()
    give_up_chain(lab)
    yield
    yield
    lab.wait(
        lambda: any(one["kind"] == "battery_charging" for one in lab.state("services")["services"]),
        "the charger does not offer its service on the new chain",
    )
