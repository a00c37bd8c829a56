"""A clock that jumps hears at once when a verdict will be due: real sessions on a real router."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh

from rodeo.bus.messages import Task
from rodeo.bus.session import Bus
from rodeo.runtime.sim_clock import SimClock
from rodeo.site.config import Site
from rodeo_testing.waiting import wait_until
from services.oracle.away import MissingProofs, ProofAway, due_s
from services.oracle.rules import PATIENCE, Judging
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.services.robot_sim.test_holders import NEVER, Mind, Simulator

WINDOW_S = 3600.0


@pytest.fixture
def site(tmp_path: Path) -> Site:
    """A site whose clock waits for the oracle only."""
    site = Site.load(LAB)
    clock = site.clock.model_copy(update={"holders": ["oracle"]})
    return site.model_copy(update={"clock": clock, "data_dir": tmp_path})


Oracle = tuple[Callable[[threading.Event], None], Callable[[Task], object], float]
"""What runs in its thread, what begins the wait for a verdict, and its share of the patience."""


def leaving(site: Site, _bus: Bus, clock: SimClock) -> Oracle:
    judging = Judging(site, clock, lambda *_: None, lambda *_: True)
    judging.begin({"waste_disposal": "0x" + "11" * 32})
    return judging.run, judging.leave, PATIENCE


def seeking(site: Site, bus: Bus, clock: SimClock) -> Oracle:
    folder = site.data_dir / "proofs"
    missing = MissingProofs(site, bus, clock, folder, lambda *_: None, lambda *_: True, list)
    return (
        lambda stop: missing.run(stop, lambda: None),
        lambda one: missing.seek(one, ProofAway("lost", one, "store")),
        1.0,
    )


@pytest.mark.parametrize("begin", [leaving, seeking])
def test_a_clock_that_jumps_does_not_pass_a_verdict_that_was_just_begun_to_be_waited_for(
    begin: Callable[[Site, Bus, SimClock], Oracle], connect: Callable[[], zenoh.Session], site: Site
) -> None:
    simulator = Simulator(connect(), site, connect())
    simulator.wait_to_pass()  # nobody is there
    oracle = Mind(connect(), site, "oracle")
    while not oracle.clock.wait_ready(NEVER, 0.1):
        simulator.tell_time()
    run, wait_for_verdict, patience = begin(site, Bus(oracle.session), oracle.clock)
    stop = threading.Event()
    thread = threading.Thread(target=run, args=(stop,))
    thread.start()
    try:
        wait_until(lambda: any(one.hold.resting for one in simulator.holders.roster.seen.values()))
        sha256 = "22" * 32
        known = {
            "verdict_deadline": simulator.now_ns_ * 1e-9 + WINDOW_S,
            "rules_sha256": "0x" + sha256,
            "proof_sha256": "0x" + sha256,
            "proof_uri": f"{site.store_url}/{sha256}.mcap",
        }
        one = task("submitted").model_copy(update=known)
        with oracle.clock.acting():
            wait_for_verdict(one)
        simulator.holders.sent()
        simulator.wait_to_pass()
        due = due_s(one, site, patience)
        assert due is not None
        assert simulator.holders.next_ns == math.ceil(due * 1e9)
    finally:
        stop.set()
        thread.join()
