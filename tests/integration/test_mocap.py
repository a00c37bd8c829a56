"""The lab's motion capture signs what it sees: from the simulated lab over the bus into a recording."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rodeo.bus.session import Request
from rodeo.evidence.attestation import verify_attestation
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.recording import RecordedRobot, Recording
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo.signing import wallets
from rodeo.site import topics
from rodeo.witness.motion import track
from rodeo.witness.statement import Motion, parse
from rodeo_testing import answers
from rodeo_testing.assignments import BINDING, ROBOT
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long


class Office:
    """Answers as the bridge does: for which organization one signs, and which devices there are."""

    def __init__(self, running: RunningSite) -> None:
        self._mocap = wallets.load(running.site, "mocap-device").address
        for what, answer in (("chain", self._chain), ("devices", self._devices)):
            running.bus.serve(topics.STATE.name(org=running.site.org, what=what), answer)

    def _chain(self, _request: Request) -> dict[str, Any]:
        signed = {"TaskManager": BINDING.task_manager, "Organization": BINDING.organization}
        return answers.chain(chain_id=BINDING.chain_id, contracts=answers.CONTRACTS | signed)

    def _devices(self, _request: Request) -> dict[str, Any]:
        registered = (("robot", "panther1", ROBOT.address), ("mocap", "mocap", self._mocap))
        return {
            "devices": [
                {
                    "role": role,
                    "name": name,
                    "address": address,
                    "owner": BINDING.organization,
                    "registered": 0.0,
                    "revoked": None,
                    "revoked_because": None,
                }
                for role, name, address in registered
            ]
        }


def test_a_recording_holds_what_motion_capture_saw_under_the_heads_that_it_heard(tmp_path: Path) -> None:
    with RunningSite(write_site(tmp_path, extra="clock.speed = 10")) as running:
        running.start("router")
        Office(running)
        running.start("robot_sim")
        site, bus = running.site, running.bus
        clock = SimClock(bus.session, site.bus.domain_id)
        assert clock.wait_ready(threading.Event(), 60)
        node = Node(bus.session, "recorder", "", site.bus.domain_id, clock)
        path = tmp_path / "proof.mcap"
        robot = RecordedRobot(site, "panther1", ROBOT, bus, clock, Interrupts())
        recording = Recording(path, BINDING, node, robot, topics.ROBOT_STATE)
        recording.await_witness("item1")
        ended_s = clock.now_s()
        recording.catch_up()
        own = recording.claimant.recording
        recording.suspend()
        Recorder.finish(path, BINDING, ROBOT, clock)
        clock.close()
    proof = open_proof(path)
    assert not [topic for topic in proof.topics if topic.startswith("/mocap/")]
    attestations = proof.attestations()
    device = wallets.load(site, "mocap-device").address
    assert {verify_attestation(one) for one in attestations} == {device}
    said = sorted((parse(one.payload) for one in attestations), key=lambda one: one.seq)
    motion = [one for one in said if isinstance(one, Motion)]
    assert [one.seq for one in motion] == list(range(motion[0].seq, motion[0].seq + len(motion)))
    assert own in {head.chain for one in motion for head in one.heads}
    assert motion[-1].end_us * 1e-6 >= ended_s
    for body, place in (("item1", site.items[0].pose), ("panther1", site.robots[0].pose)):
        seen = track(motion, body)
        assert seen is not None
        assert np.hypot(*(seen.position_m[-1, :2] - [place.x_m, place.y_m])) == pytest.approx(0.0, abs=0.05)
