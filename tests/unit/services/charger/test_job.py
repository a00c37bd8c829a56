"""What the charger remembers: the job in its file, the register in the recording itself."""

from __future__ import annotations

from pathlib import Path

import pytest
from eth_account import Account

from rodeo.evidence import Binding, Recorder, attest
from rodeo.evidence.recorder import ATTESTATION_CHANNEL, EVENT_CHANNEL
from rodeo.ros2.types import new, serialize
from services.charger.job import Job, JobBroken, recover
from services.charger.meter import Meter, Register

ACCOUNT = Account.create()
BINDING = Binding(
    chain_id=1,
    task_manager="0x" + "11" * 20,
    organization="0x" + "34" * 20,
    device="dock1",
    task_id=7,
    attempt=1,
    executor="0x" + "22" * 20,
    nonce="0x" + "33" * 32,
)
START_S = 1_800_000_000


class FixedClock:
    def now_ns(self) -> int:
        return START_S * 10**9

    def now_s(self) -> float:
        return float(START_S)

    def wait_until(self, time_s: float, stop: object = None) -> bool:
        return True


def record(path: Path, readings: int) -> Register:
    """A recording of 9 A at 40 V that is cut off after `readings`; the register at that moment."""
    recorder = Recorder(path, BINDING, ACCOUNT, FixedClock())
    meter = Meter("dock1", 7, 1, Register(), 10)
    for second in range(readings):
        stamp = new("builtin_interfaces/msg/Time", sec=START_S + second)
        header = new("std_msgs/msg/Header", stamp=stamp)
        cdr = serialize(
            new("sensor_msgs/msg/BatteryState", header=header, voltage=40.0, current=9.0, present=True)
        )
        time_ns = (START_S + second) * 10**9
        recorder.write_ros("dock1/output", "sensor_msgs/msg/BatteryState", cdr, time_ns, time_ns)
        statement = meter.reading(START_S + second, 40.0, 9.0)
        if statement is not None:
            signed = attest(statement.model_dump(), ACCOUNT)
            recorder.write_json(ATTESTATION_CHANNEL, signed.model_dump())
    recorder.suspend()
    return meter.register


@pytest.mark.parametrize("readings", [1, 9, 10, 25])
def test_the_register_is_recovered_from_the_recording(tmp_path: Path, readings: int) -> None:
    kept = record(tmp_path / "task.mcap", readings)
    recovered = recover(tmp_path / "task.mcap", "/dock1/output").register
    assert recovered.energy_wh == pytest.approx(kept.energy_wh)
    assert recovered.model_copy(update={"energy_wh": 0.0}) == kept.model_copy(update={"energy_wh": 0.0})


def test_the_last_contract_event_is_recovered_too(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "task.mcap", BINDING, ACCOUNT, FixedClock())
    for event in ({"event": "assignment"}, {"seq": 5, "name": "TaskAssigned"}, {"event": "note"}):
        recorder.write_json(EVENT_CHANNEL, event)
    recorder.suspend()
    assert recover(tmp_path / "task.mcap", "/dock1/output").events_seq == 5


def test_a_recording_cut_in_the_middle_gives_the_register_of_what_is_left(tmp_path: Path) -> None:
    path = tmp_path / "task.mcap"
    record(path, 100)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    recovered = recover(path, "/dock1/output").register
    assert recovered.last is not None
    counted_s = recovered.last.time_s - START_S
    assert 10 < counted_s < 90
    assert recovered.energy_wh == pytest.approx(360.0 * counted_s / 3600)


def test_no_file_is_no_job_and_a_broken_one_an_error(tmp_path: Path) -> None:
    assert Job.load(tmp_path / "job.json") is None
    (tmp_path / "job.json").write_text('{"task": {}}')
    with pytest.raises(JobBroken) as broken:
        Job.load(tmp_path / "job.json")
    assert broken.value.details["path"].endswith("job.json")
