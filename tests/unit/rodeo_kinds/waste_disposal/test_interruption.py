"""What the recording of an interrupted attempt says was done for good."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rodeo.evidence.attestation import attest
from rodeo.evidence.recorder import Recorder
from rodeo.robot.recording import stated
from rodeo.witness.statement import Drop
from rodeo_kinds.waste_disposal.behaviour import release_in, tells_of_disposal
from rodeo_testing.assignments import BINDING, ROBOT
from tests.unit.robot.fakes import BIN, ManualClock, payload_of

START_S = 1.8e9


def fell(time_s: float, seq: int = 1) -> dict[str, Any]:
    return attest(payload_of(Drop, seq, BIN, about_s=time_s), BIN).model_dump()


def test_a_release_is_as_late_as_it_was_last_noted(tmp_path: Path) -> None:
    path, clock = tmp_path / "recording.mcap", ManualClock()
    clock.time_s = START_S
    with Recorder(path, BINDING, ROBOT, clock) as recorder:
        recorder.write_json("rodeo/attestation", fell(START_S))
    assert release_in(path) is None

    for _ in range(2):  # the fingers did not open the first time
        clock.time_s += 10
        with Recorder.resume(path, BINDING, ROBOT, clock) as recorder:
            recorder.write_json("rodeo/event", {"event": "releasing", "item": "item1", "bin": "itrash"})
    assert release_in(path) == (START_S + 20, "itrash")


def test_only_what_fell_after_the_release_is_this_items_drop_whenever_it_was_told(tmp_path: Path) -> None:
    path, clock = tmp_path / "recording.mcap", ManualClock()
    clock.time_s = START_S
    with Recorder(path, BINDING, ROBOT, clock) as recorder:
        recorder.write_json("rodeo/event", {"event": "releasing", "item": "item1", "bin": "itrash"})
        recorder.write_json("rodeo/attestation", fell(START_S - 10))
        recorder.write_json("rodeo/attestation", {"payload": {"body": "item1", "time_s": START_S + 3}})
    assert not tells_of_disposal(path, START_S, "itrash", 0.0)

    with Recorder.resume(path, BINDING, ROBOT, clock) as recorder:
        recorder.write_json("rodeo/attestation", fell(START_S - 1, 2))
        recorder.write_json("rodeo/attestation", fell(START_S + 2, 3))
    assert not tells_of_disposal(path, START_S, "itrash", 10.0)

    clock.time_s = START_S + 12.5
    with Recorder.resume(path, BINDING, ROBOT, clock):
        pass
    assert tells_of_disposal(path, START_S, "itrash", 10.0)
    assert not tells_of_disposal(path, START_S, "another", 10.0)
    assert stated(path) == {BIN.address: 3}
