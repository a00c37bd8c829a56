from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
from array import array
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from rodeo.evidence.errors import BrokenSeal, RecorderFailed, RecordingExists, RecordingSealed, UnsealedProof
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import UNREADABLE, Recorder
from rodeo.evidence.seal import Binding
from rodeo.evidence.tally import Tally
from rodeo_testing.waiting import HANG_S
from tests.unit.evidence.conftest import START_NS, TICK_NS, HandClock, drive, joint_state, odometry


def test_messages_come_back_byte_for_byte(recorded: Callable[..., Path]) -> None:
    proof = open_proof(recorded(50))
    column = proof.topics["/panther1/odom"]
    assert list(column.data) == [odometry(index) for index in range(50)]
    assert list(column.log_ns) == [START_NS + index * TICK_NS for index in range(50)]
    assert list(column.publish_ns) == [START_NS + index * TICK_NS - 5 for index in range(50)]
    assert list(column.sequence) == list(range(50))


def test_any_mcap_reader_reads_every_topic(recorded: Callable[..., Path]) -> None:
    with recorded(20).open("rb") as file:
        messages = list(make_reader(file, validate_crcs=True).iter_messages())
    topics = {channel.topic for _, channel, _ in messages}
    assert topics == {"/panther1/odom", "/panther1/joint_states", "rodeo/event", "rodeo/seal"}
    schema = next(s for s, channel, _ in messages if channel.topic == "/panther1/odom")
    assert schema is not None
    assert (schema.name, schema.encoding) == ("nav_msgs/msg/Odometry", "ros2msg")


def test_rosbags_reads_and_decodes_it(recorded: Callable[..., Path]) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(recorded(20)) as reader:
        connections = [c for c in reader.connections if c.topic == "/panther1/odom"]
        messages = [store.deserialize_cdr(data, c.msgtype) for c, _, data in reader.messages(connections)]
    assert [message.pose.pose.position.x for message in messages] == pytest.approx(
        [0.01 * index for index in range(20)]
    )


def test_rosbags_reads_every_topic(recorded: Callable[..., Path]) -> None:
    path = recorded(20)
    with Reader(path) as reader:
        found = Counter((connection.topic, data) for connection, _, data in reader.messages())
    with path.open("rb") as file:
        expected = Counter((c.topic, message.data) for _, c, message in make_reader(file).iter_messages())
    assert found == expected


def test_a_seal_covers_at_most_a_second(recorded: Callable[..., Path]) -> None:
    proof = open_proof(recorded(500))
    assert proof.longest_unsealed_ns <= 1e9
    assert proof.seals >= 11  # opening, one for each of ten seconds, final


def test_an_event_is_sealed_at_once(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    for index in range(5):
        recorder.write_json("rodeo/event", {"index": index})
    assert open_proof(recorder.close().path).seals == 7  # opening, one for each event, final


def test_json_is_stamped_by_the_clock(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    clock.time_ns += 7
    recorder.write_json("rodeo/event", {"name": "TaskAssigned"})
    proof = open_proof(recorder.close().path)
    assert proof.events()[0] == {"name": "TaskAssigned"}
    assert proof.topics["rodeo/event"].log_ns[0] == START_NS + 7


@pytest.mark.parametrize(
    "odd", ["\ud800", math.nan, 10**5000, object()], ids=["half", "nan", "huge", "other"]
)
@pytest.mark.parametrize("channel", ["rodeo/event", "rodeo/attestation"])
def test_what_readers_refuse_is_left_out_with_a_note(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock, channel: str, odd: object
) -> None:
    """Others wrote it: who records it must not lose the file by it."""
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    recorder.write_json(channel, {"name": "TaskRegistered", "args": {"params": odd}})
    recorder.write_json(channel, {"name": "TaskAssigned"})
    proof = open_proof(recorder.close().path)
    assert proof.json(channel)[-1 if channel == "rodeo/attestation" else 1] == {"name": "TaskAssigned"}
    note = proof.events()[0]
    assert (note["event"], note["channel"], note["name"]) == (UNREADABLE, channel, "TaskRegistered")


def test_the_hash_is_that_of_the_file(recorded: Callable[..., Path], tmp_path: Path) -> None:
    path = recorded(10)
    assert (
        open_proof(path).sha256 == "0x" + subprocess.check_output(["sha256sum", path], text=True).split()[0]
    )


def test_threads_may_write_at_once(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)

    def write(name: str) -> None:
        for index in range(300):
            now_ns = START_NS + index * TICK_NS
            recorder.write_ros(name, "sensor_msgs/msg/JointState", joint_state(index), now_ns, now_ns, index)

    threads = [threading.Thread(target=write, args=(f"robot{number}/joint_states",)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    proof = open_proof(recorder.close().path)
    assert [proof.count(f"/robot{number}/joint_states") for number in range(4)] == [300] * 4


def test_it_ends_with_what_was_seen_of_what_was_published(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    drive(recorder, 7, 20)
    drive(recorder, 25, 30)  # five were lost
    drive(recorder, 1, 4)  # the publisher started anew
    last = open_proof(recorder.close().path).events()[-1]
    counts = {"seen": 21, "published": 26}
    topics = {"/panther1/odom": counts, "/panther1/joint_states": counts}
    assert last == {"event": "recording_closed", "topics": topics}


@pytest.mark.parametrize("sequences", [[], [5], [7, 8, 9, 12], [3, 4, 1, 2, 2, 2**32 - 1, 0, 1]])
def test_counting_at_once_is_counting_one_by_one(sequences: list[int]) -> None:
    tally = Tally()
    for sequence in sequences:
        tally.add(sequence)
    assert Tally.of(array("I", sequences)).counts() == tally.counts()


def test_a_recording_is_never_overwritten(
    recorded: Callable[..., Path], binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    path = recorded(10)
    with pytest.raises(RecordingExists):
        Recorder(path, binding, device, clock)


def test_nothing_is_added_after_closing(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    recorder.close()
    with pytest.raises(RecordingSealed):
        recorder.write_json("rodeo/event", {})
    with pytest.raises(RecordingSealed):
        Recorder.resume(tmp_path / "proof.mcap", binding, device, clock)


def test_a_full_disk_is_told_to_the_next_caller(
    tmp_path: Path,
    binding: Binding,
    device: LocalAccount,
    clock: HandClock,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)

    def fail(_writer: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rodeo.evidence.writer.McapWriter.flush", fail)
    with pytest.raises(RecorderFailed) as caught:
        drive(recorder, 0, 60)  # the writing thread may have failed before the last of them
        recorder.close()
    assert isinstance(caught.value.__cause__, OSError)


def test_a_failing_writer_makes_close_fail(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    recorder = Recorder(tmp_path / "proof.mcap", binding, device, clock)
    recorder.write_ros("x", "no_such/msg/Type", b"", START_NS, START_NS)
    with pytest.raises(RecorderFailed) as caught:
        recorder.close()
    assert "no_such/msg/Type" in str(caught.value.__cause__)


def test_suspended_recordings_continue(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    path = tmp_path / "proof.mcap"
    with Recorder(path, binding, device, clock) as recorder:
        drive(recorder, 0, 120)
    with pytest.raises(UnsealedProof):
        open_proof(path)
    recorder = Recorder.resume(path, binding, device, clock)
    drive(recorder, 200, 300)
    recorder.close()
    proof = open_proof(path)
    assert list(proof.topics["/panther1/odom"].sequence) == [*range(120), *range(200, 300)]
    assert [event["event"] for event in proof.events()] == ["recording_resumed", "recording_closed"]


def test_a_stopped_recording_survives_a_kill_before_it_is_sealed(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    path, killed = tmp_path / "proof.mcap", tmp_path / "killed.mcap"
    recorder = Recorder(path, binding, device, clock)
    drive(recorder, 0, 123)
    recorder.stop()
    with pytest.raises(RecordingSealed):
        drive(recorder, 123, 124)
    killed.write_bytes(path.read_bytes())
    recorder.close()
    Recorder.finish(killed, binding, device, clock)
    assert list(open_proof(path)) == list(open_proof(killed))
    assert open_proof(path).count("/panther1/odom") == 123


def test_a_few_messages_are_signed_once_nothing_follows(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    sealed, path = threading.Semaphore(0), tmp_path / "proof.mcap"
    with Recorder(path, binding, device, clock, lambda _data: sealed.release()) as recorder:
        assert sealed.acquire(timeout=HANG_S)  # the opening seal
        drive(recorder, 0, 2)
        assert sealed.acquire(timeout=HANG_S)


def test_a_suspended_recording_is_finished_as_it_is(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    path = tmp_path / "proof.mcap"
    with Recorder(path, binding, device, clock) as recorder:
        drive(recorder, 0, 120)
    clock.time_ns += 3600 * 10**9
    sealed = Recorder.finish(path, binding, device, clock)
    proof = open_proof(path)
    assert list(proof.topics["/panther1/odom"].sequence) == [*range(120)]
    assert [event["event"] for event in proof.events()] == ["recording_closed"]
    assert proof.end_ns - proof.start_ns < 10 * 10**9
    assert sealed.path == path
    with pytest.raises(RecordingSealed):
        Recorder.finish(path, binding, device, clock)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.999])
def test_a_cut_file_keeps_every_complete_chunk(
    recorded: Callable[..., Path],
    binding: Binding,
    device: LocalAccount,
    clock: HandClock,
    share: float,
) -> None:
    path = recorded(1000)
    whole = open_proof(path).topics["/panther1/odom"].data
    os.truncate(path, int(path.stat().st_size * share))
    recorder = Recorder.resume(path, binding, device, clock)
    recorder.close()
    kept = open_proof(path).topics["/panther1/odom"].data
    assert list(kept) == whole[: len(kept)]
    assert len(kept) >= (min(share, 0.8) - 0.1) * 1000  # the index at the end is not messages


@pytest.mark.long
def test_a_killed_process_loses_at_most_one_seal_period(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    path = tmp_path / "proof.mcap"
    program = f"""
import json, threading
from eth_account import Account
from pathlib import Path
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from tests.unit.evidence.conftest import START_NS, TICK_NS, HandClock, drive
sealed = threading.Event()
def on_seal(data):
    if int(json.loads(data)["payload"]["time_ns"]) >= START_NS + 950 * TICK_NS:
        sealed.set()
recorder = Recorder(Path({str(path)!r}), Binding.model_validate_json({binding.model_dump_json()!r}),
                    Account.from_key({device.key.hex()!r}), HandClock(), on_seal)
drive(recorder, 0, 1001)
sealed.wait()
print("written", flush=True)
threading.Event().wait()
"""
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "written\n"
    child.send_signal(signal.SIGKILL)
    child.wait()
    recorder = Recorder.resume(path, binding, device, clock)
    recorder.close()
    assert open_proof(path).count("/panther1/odom") >= 1001 - 51


def test_only_its_own_assignment_and_signer_resume_it(
    tmp_path: Path, binding: Binding, device: LocalAccount, clock: HandClock
) -> None:
    path = tmp_path / "proof.mcap"
    with Recorder(path, binding, device, clock) as recorder:
        drive(recorder, 0, 60)
    with pytest.raises(BrokenSeal):
        Recorder.resume(path, binding.model_copy(update={"attempt": 2}), device, clock)
    with pytest.raises(BrokenSeal):
        Recorder.resume(path, binding, Account.create(), clock)
    Recorder.resume(path, binding, device, clock).close()
