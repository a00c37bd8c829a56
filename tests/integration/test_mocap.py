"""The lab's motion capture signs what it publishes: from the simulated lab over the bus into a recording."""

from __future__ import annotations

import threading
from pathlib import Path

from rodeo import topics, wallets
from rodeo.clock import SimClock
from rodeo.evidence import Recorder, open_proof
from rodeo.ros2 import Node
from services.oracle.witness import signed
from services.robot_agent.recording import Recording
from tests.support.assignments import BINDING, ROBOT
from tests.support.site import RunningSite, write_site

STATEMENTS = 3


def test_a_recording_holds_poses_that_the_motion_capture_signed(tmp_path: Path) -> None:
    running = RunningSite(write_site(tmp_path))
    try:
        running.start("router", "robot_sim")
        site, bus = running.site, running.bus
        clock = SimClock(bus.session, site.bus.domain_id)
        assert clock.wait_ready(threading.Event(), 60)
        said, enough = [], threading.Event()

        def on_statement(_key: str, _attestation: object) -> None:
            said.append(1)
            if len(said) > STATEMENTS:
                enough.set()

        node = Node(bus.session, "recorder", "", site.bus.domain_id, clock)
        path = tmp_path / "proof.mcap"
        recording = Recording(path, BINDING, ROBOT, clock, node, site, "panther1", ["item1"], bus)
        key = topics.MOCAP_ATTESTATION.name(org=site.org, body="item1")
        bus.subscribe_json(key, on_statement)
        assert enough.wait(60), running.log("robot_sim")
        recording.suspend()
        clock.close()
    finally:
        running.stop()
    Recorder.finish(path, BINDING, ROBOT, clock)
    proof = open_proof(path)
    device = wallets.load(site, "mocap-device").address.lower()
    for body in ("panther1", "item1"):
        poses = proof.topics[f"/mocap/{body}/pose"]
        assert not signed(poses, body, proof.attestations(), {ROBOT.address.lower()}).any()
        covered = signed(poses, body, proof.attestations(), {device})
        # All but the poses before the first whole statement and after the last.
        assert covered.sum() >= 50 * (STATEMENTS - 1), (body, len(covered), covered.sum())
        first, last = covered.argmax(), len(covered) - covered[::-1].argmax()
        assert covered[first:last].all()
