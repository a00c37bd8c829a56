"""The replay of a recording shows what motion capture signed, and what the bin said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rodeo.evidence.attestation import attest
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import Recorder
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.chain import WitnessChain
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.poses import pack
from rodeo.witness.statement import Motion, Removal, Scope
from rodeo_testing.assignments import BIN, BINDING, MOCAP, ROBOT
from services.console.replay import track
from tests.support.site import LAB
from tests.unit.robot.fakes import ManualClock

SCOPE = Scope(chain_id=BINDING.chain_id, task_manager=BINDING.task_manager, organization=BINDING.organization)


def test_bodies_are_where_motion_capture_signed_them_and_strangers_move_nothing(tmp_path: Path) -> None:
    clock = ManualClock()
    clock.time_s = 1.8e9
    mocap, itrash = (
        WitnessChain(name, key, SCOPE, "sensor", Journal(tmp_path / name), HeadBook())
        for name, key in (("mocap", MOCAP), ("itrash", BIN))
    )
    path = tmp_path / "proof.mcap"
    with Recorder(path, BINDING, ROBOT, clock) as recorder:

        def see(signer: WitnessChain, x_m: float) -> Any:
            now_us = round(clock.time_s * 1e6)
            poses = pack(np.array([500_000]), np.array([[x_m, 1.0, 0.05]]), np.array([[1.0, 0.0, 0.0, 0.0]]))
            fields = {"start_us": now_us - 1_000_000, "end_us": now_us, "resting": {}}
            return signer.sign(Motion, clock.time_s, tracks={"item1": poses}, **fields)

        for second in range(10):
            clock.time_s += 1
            recorder.write_json("rodeo/attestation", see(mocap, 2.0 + 0.1 * second).model_dump())
        recorder.write_json("rodeo/attestation", see(itrash, 99.0).model_dump())
        recorder.write_json("rodeo/attestation", {"payload": {"type": "mocap.motion"}})
        taken = itrash.sign(
            Removal, clock.time_s, compartment="blue", weight_n=0.2, after_s=1.0, settled_s=2.0
        )
        recorder.write_json("rodeo/attestation", taken.model_dump())
        recorder.write_json("rodeo/attestation", attest({"type": "bin.drop"}, BIN).model_dump())
    Recorder.finish(path, BINDING, ROBOT, clock)
    shown = track(open_proof(path), Site.load(LAB))
    item = shown["items"]["item1"]
    assert (item["x"][0], item["x"][-1]) == (pytest.approx(2.0), pytest.approx(2.9))
    assert item["x"] == sorted(item["x"])
    assert "item2" not in shown["items"]
    assert "Bin: something was taken out of blue" in [mark["text"] for mark in shown["marks"]]


def test_the_last_pictures_of_the_bin_are_shown_and_nothing_that_is_no_picture(tmp_path: Path) -> None:
    clock = ManualClock()
    clock.time_s = 1.8e9
    path, name = tmp_path / "proof.mcap", topics.BIN_IMAGE.name(bin="itrash")
    with Recorder(path, BINDING, ROBOT, clock) as recorder:
        for data in (b"\xff\xd8\xff picture", b"<svg onload=alert(1)>", b"\x89PNG" + bytes(300_000)):
            clock.time_s += 1
            image = types.new(topics.BIN_IMAGE.type, format="jpeg")
            image.data = np.frombuffer(data, np.uint8)
            stamp_ns = round(clock.time_s * 1e9)
            recorder.write_ros(name, topics.BIN_IMAGE.type, types.serialize(image), stamp_ns, stamp_ns)
    Recorder.finish(path, BINDING, ROBOT, clock)
    (picture,) = track(open_proof(path), Site.load(LAB))["pictures"]
    assert picture["from"] == "itrash's camera"
    assert picture["src"].startswith("data:image/jpeg;base64,/9j/")
