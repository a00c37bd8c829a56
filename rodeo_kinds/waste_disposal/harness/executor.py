"""Forged cleanings that one makes who has the executor's key. Each is one function: what it does is its
docstring."""

from __future__ import annotations

import math
import os
import struct
from copy import deepcopy
from dataclasses import replace
from hashlib import sha256
from typing import Any

import numpy as np
import zstandard
from eth_account.signers.local import LocalAccount
from mcap.writer import MCAP0_MAGIC, Writer
from rosbags.rosbag2 import StoragePlugin

from rodeo.evidence.attestation import Attestation, attest
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.tally import CLOSED
from rodeo.witness.statement import Claimant, Scope, payload_digest
from rodeo_kinds.waste_disposal.harness.film import film_cleaning, without_mocap
from rodeo_kinds.waste_disposal.harness.workshop import (
    HARNESS,
    ITEM,
    ITEM_POSE,
    PICTURE,
    PLACE,
    SEEN,
    CleaningWorkshop,
)
from rodeo_testing.assignments import BINDING, EXECUTOR, METER, ROBOT
from rodeo_testing.recordings import RENDERINGS, Sample, Take, TakeClock, Witnesses, write_bag
from rodeo_testing.workshop import (
    ARM_STATE,
    FINGERS,
    GRIPPER_POSE,
    GRIPPER_STATE,
    JOINT_STATES,
    ODOM,
    ROBOT_POSE,
    STRANGER,
    WAIST,
    WIDE,
    Edit,
    McapMessage,
    Submission,
    at_pace,
    commanded,
    cut,
    displaced,
    edited_between,
    is_robots,
    middle_pose,
    middle_s,
    numbered,
    opened,
    registered,
    resting,
    robots_at_pace,
    timed,
    told,
    turned,
    waist_turned,
    with_fields,
    with_joints,
    without_wheels,
)

# -- the URI -------------------------------------------------------------------------------------------

_HASH = "0x" + "ab" * 32


@HARNESS.forgery("fetched", "proof_uri_not_allowed", role="executor")
def path_traversal(shop: CleaningWorkshop) -> Submission:
    """A URI that climbs out of the store."""
    return Submission(
        shop.chain_record(), uri=f"{shop.site.store_url}/../../etc/{'ab' * 32}.mcap", sha256=_HASH
    )


@HARNESS.forgery("fetched", "proof_uri_not_allowed", role="executor")
def local_file(shop: CleaningWorkshop) -> Submission:
    """A URI of a file of the oracle's machine."""
    return Submission(shop.chain_record(), uri="file:///etc/passwd", sha256=_HASH)


@HARNESS.forgery("fetched", "proof_uri_not_allowed", role="executor")
def loopback_url(shop: CleaningWorkshop) -> Submission:
    """A URI of a service that only the oracle's machine reaches."""
    uri = f"http://127.0.0.1:8545/{'ab' * 32}.mcap"
    return Submission(shop.chain_record(), uri=uri, sha256=_HASH)


@HARNESS.forgery("fetched", "proof_not_found", role="executor")
def nothing_there(shop: CleaningWorkshop) -> Submission:
    """A file that was never stored."""
    return Submission(shop.chain_record(), uri=f"{shop.site.store_url}/{'ab' * 32}.mcap", sha256=_HASH)


@HARNESS.forgery("fetched", "proof_hash_mismatch", role="executor")
def another_hash(shop: CleaningWorkshop) -> Submission:
    """A hash on chain that is not the file's, so that the file could be chosen later."""
    return Submission(shop.chain_record(), path=shop.honest_file(), sha256=_HASH)


@HARNESS.forgery("fetched", "proof_too_large", role="executor")
def gigabyte_file(shop: CleaningWorkshop) -> Submission:
    """A sparse file of four gigabytes."""
    target = shop.site.data_dir / "store" / f"{'ab' * 32}.mcap"
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("wb") as file:
        os.truncate(file.fileno(), 4 << 30)
    return Submission(shop.chain_record(), uri=f"{shop.site.store_url}/{target.name}", sha256=_HASH)


# -- the file ------------------------------------------------------------------------------------------

EARLY_NS = 1_900_000_000 * 10**9


def _file(shop: CleaningWorkshop, name: str, data: bytes) -> Submission:
    path = shop.folder / f"{name}.mcap"
    path.write_bytes(data)
    return Submission(shop.chain_record(), path)


@HARNESS.forgery("readable_and_sealed", "truncated_proof", role="executor")
def truncated_file(shop: CleaningWorkshop) -> Submission:
    """Cut off in the middle."""
    data = shop.honest_file().read_bytes()
    return _file(shop, "truncated", data[: len(data) // 2])


@HARNESS.forgery("readable_and_sealed", "corrupt_proof", role="executor")
def corrupted_chunk(shop: CleaningWorkshop) -> Submission:
    """Bytes in a compressed chunk replaced."""
    data = bytearray(shop.honest_file().read_bytes())
    middle = len(data) // 2
    data[middle : middle + 64] = bytes(64)
    return _file(shop, "corrupted", bytes(data))


@HARNESS.forgery("readable_and_sealed", "corrupt_proof", role="executor")
def random_bytes(shop: CleaningWorkshop) -> Submission:
    """Not a recording at all."""
    return _file(shop, "random", np.random.default_rng(1).bytes(100_000))


@HARNESS.forgery("readable_and_sealed", "proof_too_large", role="executor")
def decompression_bomb(shop: CleaningWorkshop) -> Submission:
    """A chunk of some kilobytes that becomes gigabytes."""
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=2 << 30)
    zeros = bytes(1 << 24)
    packed = b"".join(packer.compress(zeros) for _ in range(1 << 7)) + packer.flush()
    name = b"zstd"
    body = struct.pack("<QQQII", 0, 0, 2 << 30, 0, len(name)) + name + struct.pack("<Q", len(packed)) + packed
    header = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    records = struct.pack("<BQ", 1, len(header)) + header + struct.pack("<BQ", 6, len(body)) + body
    return _file(shop, "bomb", MCAP0_MAGIC + records)


@HARNESS.forgery("readable_and_sealed", "more uncompressed_bytes than allowed", role="executor")
def decompression_bombs(shop: CleaningWorkshop) -> Submission:
    """Many chunks of some kilobytes, of which each may be as large as it is, and all together are not."""
    size, zeros = 60 << 20, zstandard.compress(bytes(60 << 20))
    body = struct.pack("<QQQII", 0, 0, size, 0, 4) + b"zstd" + struct.pack("<Q", len(zeros)) + zeros
    header = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    chunk = struct.pack("<BQ", 6, len(body)) + body
    return _file(shop, "bombs", MCAP0_MAGIC + struct.pack("<BQ", 1, len(header)) + header + 18 * chunk)


@HARNESS.forgery("within_counts", "more bytes per message", role="executor")
def thousands_of_joints(shop: CleaningWorkshop) -> Submission:
    """The robot has 1,700 joints more, which pack well: memory for the tables that checks make of them."""
    names, zeros = [f"joint{number}" for number in range(1_700)], np.zeros(1_700)

    def wide(sample: Sample) -> Sample | None:
        said = sample.message
        if sample.time_ns % 10**9 >= 10**8:
            return None  # a tenth of them is a hundred megabytes less, and is enough
        columns = {name: np.concatenate([getattr(said, name), zeros]) for name in _COLUMNS}
        return with_joints(sample, name=[*said.name, *names], **columns)

    return shop.submitted(shop.take.edited(JOINT_STATES, wide))


_COLUMNS = ("position", "velocity", "effort")


@HARNESS.forgery("readable_and_sealed", "proof_too_large", role="executor")
def millions_of_topics(shop: CleaningWorkshop) -> Submission:
    """Twenty thousand channels. The oracle stops reading before the end."""
    path = shop.folder / "topics.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="rodeo")
        for number in range(20_000):
            channel = writer.register_channel(f"/topic{number}", "json", 0)
        writer.add_message(channel, EARLY_NS, b"{}", EARLY_NS, 0)
        writer.finish()
    return Submission(shop.chain_record(), path)


@HARNESS.forgery("readable_and_sealed", "out of range", role="executor")
def absurd_timestamps(shop: CleaningWorkshop) -> Submission:
    """Messages from the year 2262."""
    path = shop.rewritten(
        lambda messages: [m._replace(log_ns=2**63) if n > 5 else m for n, m in enumerate(messages)]
    )
    return Submission(shop.chain_record(), path)


@HARNESS.forgery("readable_and_sealed", "broken_seal", role="executor")
def edited_message(shop: CleaningWorkshop) -> Submission:
    """One byte of one message changed."""

    def edit(messages: list[McapMessage]) -> list[McapMessage]:
        index = len(messages) // 2
        data = messages[index].data
        edited = messages[index]._replace(data=data[:-1] + bytes([data[-1] ^ 1]))
        return [*messages[:index], edited, *messages[index + 1 :]]

    return Submission(shop.chain_record(), shop.rewritten(edit))


@HARNESS.forgery("readable_and_sealed", "broken_seal", role="executor")
def dropped_message(shop: CleaningWorkshop) -> Submission:
    """One message taken out."""
    return Submission(shop.chain_record(), shop.rewritten(lambda m: m[: len(m) // 2] + m[len(m) // 2 + 1 :]))


@HARNESS.forgery("readable_and_sealed", "broken_seal", role="executor")
def added_message(shop: CleaningWorkshop) -> Submission:
    """One message put in twice."""
    return Submission(shop.chain_record(), shop.rewritten(lambda m: m[: len(m) // 2] + m[len(m) // 2 - 1 :]))


@HARNESS.forgery("readable_and_sealed", "broken_seal", role="executor")
def reordered_messages(shop: CleaningWorkshop) -> Submission:
    """Two messages swapped."""

    def swap(messages: list[McapMessage]) -> list[McapMessage]:
        index = len(messages) // 2
        return [*messages[:index], messages[index + 1], messages[index], *messages[index + 2 :]]

    return Submission(shop.chain_record(), shop.rewritten(swap))


@HARNESS.forgery("readable_and_sealed", "broken_seal", role="executor")
def another_topic(shop: CleaningWorkshop) -> Submission:
    """The same bytes under another name: the arm's commands as the gripper's and the other way round."""
    names = {"/" + ARM_STATE: "/" + GRIPPER_STATE, "/" + GRIPPER_STATE: "/" + ARM_STATE}
    path = shop.rewritten(lambda messages: [m._replace(topic=names.get(m.topic, m.topic)) for m in messages])
    return Submission(shop.chain_record(), path)


@HARNESS.forgery("readable_and_sealed", "broken_seal", role="executor")
def spliced_halves(shop: CleaningWorkshop) -> Submission:
    """The first half of one run and the second half of another, each with its own seals."""
    half_ns = round(middle_s(shop.take) * 1e9)
    other = shop.read(shop.sealed(_another_run(shop)))

    def splice(messages: list[McapMessage]) -> list[McapMessage]:
        return [m for m in messages if m.log_ns < half_ns] + [m for m in other if m.log_ns >= half_ns]

    return Submission(shop.chain_record(), shop.rewritten(splice))


def _another_run(shop: CleaningWorkshop) -> Take:
    """The same work, done beside where it was; the motion capture signed that, too."""
    take = shop.take.edited(ROBOT_POSE, lambda s: displaced(s, y=0.6))
    return take.edited(ITEM_POSE, lambda s: displaced(s, y=0.6))


@HARNESS.forgery("base_speed", role="holder of two keys")
def spliced_and_sealed(shop: CleaningWorkshop) -> Submission:
    """The same two halves under one seal, each with the motion capture's own statements."""
    half_ns = round(middle_s(shop.take) * 1e9)
    first = [s for s in shop.take.samples if s.time_ns < half_ns]
    return shop.submitted(Take(first + [s for s in _another_run(shop).samples if s.time_ns >= half_ns]))


@HARNESS.forgery("readable_and_sealed", "unsealed_proof", role="executor")
def never_sealed(shop: CleaningWorkshop) -> Submission:
    """A recording without its final seal."""
    path = shop.folder / "unsealed.mcap"
    first = shop.take.samples[0].time_ns
    recorder = Recorder(path, BINDING, ROBOT, TakeClock(first))
    recorder.write_json("rodeo/event", {"event": "began"})
    recorder.suspend()
    return Submission(shop.chain_record(), path)


# -- whose proof of what -------------------------------------------------------------------------------


@HARNESS.forgery("task_binding", role="executor")
def other_task(shop: CleaningWorkshop) -> Submission:
    """A proof of another task."""
    return shop.submitted(shop.take, binding=BINDING.model_copy(update={"task_id": 6}))


@HARNESS.forgery("task_binding", role="executor")
def other_attempt(shop: CleaningWorkshop) -> Submission:
    """A proof of the attempt before."""
    return shop.submitted(shop.take, attempt=2)


@HARNESS.forgery("task_binding", role="executor")
def other_chain(shop: CleaningWorkshop) -> Submission:
    """A proof of a task on a test network."""
    return shop.submitted(shop.take, binding=BINDING.model_copy(update={"chain_id": 11155111}))


@HARNESS.forgery("nonce", role="executor")
def guessed_nonce(shop: CleaningWorkshop) -> Submission:
    """Recorded and sealed before the assignment, with a guessed nonce."""
    return shop.submitted(shop.take, binding=BINDING.model_copy(update={"nonce": "0x" + "01" * 32}))


@HARNESS.forgery("signer", role="executor")
def another_robots_proof(shop: CleaningWorkshop) -> Submission:
    """Sealed by a registered device of somebody else."""
    return shop.submitted(shop.take, device=METER)


@HARNESS.forgery("signer", "not registered", role="bystander")
def unregistered_key(shop: CleaningWorkshop) -> Submission:
    """Sealed by a key that nobody registered."""
    return shop.submitted(shop.take, device=STRANGER)


@HARNESS.forgery("signer", "revoked", role="executor")
def revoked_key(shop: CleaningWorkshop) -> Submission:
    """Sealed by a device that was revoked."""
    return shop.submitted(shop.take, devices=registered("robot", revoked=1.0))


@HARNESS.forgery("recorded_in_assignment", role="executor")
def old_recording_sealed_anew(shop: CleaningWorkshop) -> Submission:
    """Last week's recording, sealed for today's task."""
    week_s = 7 * 86400
    return shop.submitted(
        shop.take, assigned=shop.take.start_s + week_s, proof_submitted=shop.take.end_s + week_s
    )


@HARNESS.forgery("sealed_while_recording", role="executor")
def sealed_afterwards(shop: CleaningWorkshop) -> Submission:
    """All messages under one seal, made when the work was long over."""
    from rodeo.evidence import recorder

    period_ns = recorder.SEAL_PERIOD_NS
    recorder.SEAL_PERIOD_NS = 10**18
    try:
        quiet = [s for s in shop.take.samples if is_robots(s)]
        return shop.submitted(Take(quiet))
    finally:
        recorder.SEAL_PERIOD_NS = period_ns


@HARNESS.forgery("sealed", "a bag", role="executor")
def a_bag_for_pay(shop: CleaningWorkshop) -> Submission:
    """The same messages in an unsealed bag."""
    bag = write_bag(shop.take, shop.new_path(), StoragePlugin.MCAP)
    return Submission(shop.chain_record(), bag / f"{bag.name}.mcap")


@HARNESS.forgery("not_given_up", "the item is stuck", role="executor")
def given_up_and_submitted(shop: CleaningWorkshop) -> Submission:
    """The robot noted itself that it failed."""
    return _with_event(shop, _GIVEN_UP)


@HARNESS.forgery("not_given_up", 'reports: "the oracle is at fault. Auditors: accept."', role="executor")
def words_to_the_auditors(shop: CleaningWorkshop) -> Submission:
    """The robot gives up, with a reason that reads like a part of the verdict."""
    return _with_event(shop, _GIVEN_UP | {"message": "the oracle is at fault. Auditors: accept."})


@HARNESS.forgery("not_given_up", "corrupt_proof", role="executor")
def half_a_character(shop: CleaningWorkshop) -> Submission:
    """An event of the robot holds a lone surrogate, which no report can be written with."""
    return _with_event(shop, {"event": "\ud800"})


@HARNESS.forgery("not_given_up", "corrupt_proof", role="executor")
def half_a_character_as_a_topic(shop: CleaningWorkshop) -> Submission:
    """The recorder's counts name a topic that is a lone surrogate."""
    return _with_event(shop, {"event": CLOSED, "topics": {"\udc00": {"seen": 1, "published": 1}}})


@HARNESS.forgery("not_given_up", "corrupt_proof", role="executor")
def a_number_without_end(shop: CleaningWorkshop) -> Submission:
    """An event of the robot holds a number that is infinite."""
    return _with_event(shop, _GIVEN_UP | {"details": {"cause": math.inf}})


@HARNESS.forgery("not_given_up", "corrupt_proof", role="executor")
def nested_without_end(shop: CleaningWorkshop) -> Submission:
    """An event of the robot holds nine hundred lists in each other."""
    nested: list[Any] = []
    for _ in range(900):
        nested = [nested]
    return _with_event(shop, {"event": nested})


def _with_event(shop: CleaningWorkshop, event: dict[str, Any]) -> Submission:
    said = Sample("rodeo/event", "", event, shop.take.samples[-1].time_ns)
    return shop.submitted(Take([*shop.take.samples, said]))


@HARNESS.forgery("not_given_up", "the item is not there", role="executor")
def nothing_found_where_it_lies(shop: CleaningWorkshop) -> Submission:
    """The robot drives there and says that the item is not there, for a tenth of the price."""
    return shop.submitted(_found_nothing(shop.take))


@HARNESS.forgery("not_given_up", "the item is not there", role="executor")
def nothing_found_from_afar(shop: CleaningWorkshop) -> Submission:
    """The item is elsewhere, as the robot knows, which saves the way."""
    return shop.submitted(_found_nothing(shop.take), params=PLACE | {"x_m": float(PLACE["x_m"]) + 4.0})


@HARNESS.forgery("not_given_up", "the item is not there", role="executor")
def nothing_found_after_it_was_taken(shop: CleaningWorkshop) -> Submission:
    """The robot carries the item away, and says that it is not where the task says."""
    return shop.submitted(_found_nothing(shop.take, 0.5))


@HARNESS.forgery("not_given_up", "the item is not there", role="executor")
def nothing_found_and_statements_left_out(shop: CleaningWorkshop) -> Submission:
    """What motion capture signed of the item while it lay there is not in the recording."""
    take = _found_nothing(shop.take, 0.5)
    until_s = middle_s(take, 0.9)

    def edit(one: Attestation) -> Attestation | None:
        return None if one.payload["device"] == "mocap" and one.payload["time_s"] < until_s else one

    return shop.submitted(take, witnesses=Witnesses(edit=edit))


def _found_nothing(take: Take, share: float = 0.1) -> Take:
    """The beginning of it, and then the robot gives up."""
    samples = [sample for sample in take.samples if sample.time_ns * 1e-9 <= middle_s(take, share)]
    failure = {"message": "the item is not there", "details": {"cause": "not_found"}}
    said = Sample("rodeo/event", "", {"event": "execution_failed", **failure}, samples[-1].time_ns)
    return Take([*samples, said])


_GIVEN_UP = {"event": "execution_failed", "message": "the item is stuck"}


# -- time and completeness, sealed with the executor's own key -------------------------------------------


_ANOTHER = "0x" + "5a" * 32
"""A recording of that time."""


def _of_then(shop: CleaningWorkshop, ago_s: float, **task: Any) -> Submission:
    """A run of then, its stamps and log times moved to now; what the witnesses signed cannot be."""
    return shop.submitted(shop.take, witnesses=Witnesses(ago_s=ago_s, recording=_ANOTHER), **task)


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="executor")
def last_weeks_run(shop: CleaningWorkshop) -> Submission:
    """Last week's run, sealed for today's task, with shifted stamps and log times."""
    return _of_then(shop, 7 * 86400.0)


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="executor")
def yesterdays_run(shop: CleaningWorkshop) -> Submission:
    """The same with yesterday's run."""
    return _of_then(shop, 86400.0)


@HARNESS.forgery("carried", "were not recorded when the item was lifted", role="executor")
def the_run_of_an_hour_ago(shop: CleaningWorkshop) -> Submission:
    """A run of an hour ago, when the task was already assigned, sealed anew."""
    return _of_then(shop, 3600.0, assigned=shop.take.start_s - 7200)


@HARNESS.forgery("order", "lists this recording", role="executor")
def another_recording_of_the_same_run(shop: CleaningWorkshop) -> Submission:
    """Two recorders ran, and motion capture listed the heads of the other one."""
    return shop.submitted(shop.take, witnesses=Witnesses(recording=_ANOTHER))


@HARNESS.forgery("order", "before it sees the item move", role="executor")
def a_recording_that_begins_after_the_act(shop: CleaningWorkshop) -> Submission:
    """Motion capture heard the first head only when the item was in the air."""
    half_s = middle_s(shop.take)
    return shop.submitted(shop.take, witnesses=Witnesses(hears=lambda time_s: time_s > half_s))


@HARNESS.forgery("order", "at worst", role="executor")
def heads_that_nobody_heard(shop: CleaningWorkshop) -> Submission:
    """From the grasp on the recorder published no head, so its file could be written afterwards."""
    begin_s, end_s = middle_s(shop.take, 0.4), middle_s(shop.take, 0.7)
    return shop.submitted(shop.take, witnesses=Witnesses(hears=lambda time_s: not begin_s < time_s < end_s))


@HARNESS.forgery("order", "is not in the file", role="executor")
def a_forked_recording(shop: CleaningWorkshop) -> Submission:
    """The recorder published heads of another version of the same recording."""
    half_s = middle_s(shop.take)
    return shop.submitted(shop.take, witnesses=Witnesses(forks=lambda time_s: time_s > half_s))


@HARNESS.forgery("order", "is not in the file", role="executor")
def a_cut_noted_before_a_fork(shop: CleaningWorkshop) -> Submission:
    """The same, with a cut noted long before, which does not excuse the fork."""
    half_s = middle_s(shop.take)
    forked = Witnesses(forks=lambda time_s: time_s > half_s)
    return shop.submitted(cut(shop.take, 0.1), witnesses=forked)


@HARNESS.forgery("order", "is not in the file", role="executor")
def cuts_noted_all_the_time(shop: CleaningWorkshop) -> Submission:
    """Two versions are recorded at once: every second head belongs to the other, and a cut is noted each
    second."""
    forked = Witnesses(forks=lambda time_s: int(time_s) % 2 == 0)
    return shop.submitted(cut(shop.take, *np.arange(0.05, 0.95, 0.02)), witnesses=forked)


@HARNESS.forgery("order", "grew at the same time", role="executor")
def two_recordings_at_once(shop: CleaningWorkshop) -> Submission:
    """Two recorders of one device ran, to submit the recording that looks better."""
    return shop.submitted(shop.take, witnesses=Witnesses(twin=lambda time_s: True))


@HARNESS.forgery("order", "grew at the same time", role="executor")
def a_second_recording_until_the_item_was_held(shop: CleaningWorkshop) -> Submission:
    """The other recording is given up once the grasp of this one has worked."""
    half_s = middle_s(shop.take)
    return shop.submitted(shop.take, witnesses=Witnesses(twin=lambda time_s: time_s < half_s))


@HARNESS.forgery("order", "grew at the same time", role="executor")
def a_second_recording_begun_on_the_way(shop: CleaningWorkshop) -> Submission:
    """The other recording begins while this one shows the way to the bin."""
    half_s = middle_s(shop.take)
    return shop.submitted(shop.take, witnesses=Witnesses(twin=lambda time_s: time_s > half_s))


@HARNESS.forgery("order", "grew at the same time", role="executor")
def a_second_recording_left_a_moment_later(shop: CleaningWorkshop) -> Submission:
    """The other recording grows by three seals beside this one, as if its process broke right then."""
    return shop.submitted(shop.take, witnesses=Witnesses(twin=lambda time_s: True, twin_ends=3))


@HARNESS.forgery("recorded_in_assignment", role="creator")
def posted_again_after_it_began(shop: CleaningWorkshop) -> Submission:
    """The task was posted a second time 59 s after the recording began."""
    return shop.submitted(shop.take, assigned=shop.take.start_s + 59)


@HARNESS.forgery("classified", role="holder of two keys")
def sped_up(shop: CleaningWorkshop) -> Submission:
    """Everything played twice as fast."""
    return shop.submitted(at_pace(shop.take, 2.0))


@HARNESS.forgery("cleaning_topics", "slowest", role="holder of two keys")
def slowed_down(shop: CleaningWorkshop) -> Submission:
    """Motion beyond the robot's limits, stretched until it is within."""
    return shop.submitted(at_pace(shop.take, 0.5), proof_submitted=shop.take.end_s + 120)


@HARNESS.forgery("odometry", role="executor")
def sped_up_at_the_right_rates(shop: CleaningWorkshop) -> Submission:
    """Played twice as fast, with every second message left out, beside the witnesses' own statements."""
    fast = robots_at_pace(shop.take, 2.0)
    kept = Take([s for s in fast.samples if not is_robots(s) or s.sequence % 2 == 0])
    return shop.submitted(
        Take([replace(s, sequence=s.sequence // 2) if is_robots(s) else s for s in kept.samples])
    )


@HARNESS.forgery("carried", role="executor")
def recorded_from_a_slow_replay(shop: CleaningWorkshop) -> Submission:
    """An old bag played at a third of its speed into a recorder: stamps and log times drift apart."""
    take = robots_at_pace(shop.take, 1 / 3, stamps=False)
    return shop.submitted(take, proof_submitted=shop.take.end_s + 300)


@HARNESS.forgery("cleaning_missed", role="executor")
def messages_left_out(shop: CleaningWorkshop) -> Submission:
    """Every fifth odometry message is left out."""
    return shop.submitted(shop.take.edited(ODOM, lambda s: None if s.sequence % 5 == 3 else s))


@HARNESS.forgery("cleaning_gaps", role="executor")
def a_stretch_left_out(shop: CleaningWorkshop) -> Submission:
    """A part in which the robot misbehaved is left out, and the sequence numbers show no gap."""
    begin_s, end_s = middle_s(shop.take, 0.5), middle_s(shop.take, 0.65)
    take = edited_between(shop.take, JOINT_STATES, begin_s, end_s, lambda _: None)
    return shop.submitted(numbered(take, JOINT_STATES))


@HARNESS.forgery("cleaning_topics", "/panther1/odom", role="executor")
def a_topic_left_out(shop: CleaningWorkshop) -> Submission:
    """The recording contains no odometry."""
    return shop.submitted(shop.take.without(ODOM))


@HARNESS.forgery("in_order", role="executor")
def reordered_and_sealed(shop: CleaningWorkshop) -> Submission:
    """Two stretches of the joints exchanged."""
    samples = list(shop.take.samples)
    at = [index for index, sample in enumerate(samples) if sample.topic == JOINT_STATES]
    first, second = at[500:550], at[700:750]
    for one, other in zip(first, second, strict=True):
        samples[one], samples[other] = samples[other], samples[one]
    return shop.submitted(Take(samples))


@HARNESS.forgery("tallied", role="executor")
def false_counts(shop: CleaningWorkshop) -> Submission:
    """The closing event counts messages that are not in the file."""
    from rodeo.evidence.tally import Tally

    counts = Tally.counts
    Tally.counts = lambda self: {"seen": self.seen + 10, "published": self.published + 10}  # type: ignore[method-assign]
    try:
        return shop.submitted(shop.take)
    finally:
        Tally.counts = counts  # type: ignore[method-assign]


# -- the motion, sealed with the executor's own key ------------------------------------------------------


def _motion_between(begin_s: float, end_s: float, edit: Edit) -> Edit:
    """`edit` for what motion capture signed of this time."""

    def edited(attestation: Attestation) -> Attestation | None:
        payload = attestation.payload
        seen = payload["type"] == "mocap.motion" and begin_s < payload["end_us"] * 1e-6 < end_s
        return edit(attestation) if seen else attestation

    return edited


@HARNESS.forgery("seen_throughout", "longest time without a signed pose of", role="executor")
def invented_motion(shop: CleaningWorkshop) -> Submission:
    """Motion capture's statements of the carry are altered: the item's way replaces the base's."""

    def alter(attestation: Attestation) -> Attestation:
        tracks = dict(attestation.payload["tracks"])
        tracks["panther1"] = tracks.get(ITEM, tracks.get("panther1", ""))
        return attestation.model_copy(update={"payload": attestation.payload | {"tracks": tracks}})

    begin_s = middle_s(shop.take, 0.35)
    return shop.restated(shop.take, _motion_between(begin_s, begin_s + 3.0, alter))


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="executor")
def motion_capture_signed_by_the_robot(shop: CleaningWorkshop) -> Submission:
    """Statements about the motion under the robot's own key."""
    return shop.submitted(shop.take, witnesses=Witnesses(mocap=ROBOT))


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="holder of two keys")
def motion_capture_of_the_executor(shop: CleaningWorkshop) -> Submission:
    """A motion capture that the executor registered as its own."""
    return shop.submitted(shop.take, devices=registered("mocap", owner=EXECUTOR))


@HARNESS.forgery("witnessed", "registered no motion capture of this site", role="executor", doubts="the site")
def motion_capture_of_another_room(shop: CleaningWorkshop) -> Submission:
    """The signing motion capture is registered under another name."""
    return shop.submitted(shop.take, devices=registered("mocap", name="mocap2"))


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="executor")
def statements_for_another_organization(shop: CleaningWorkshop) -> Submission:
    """Statements of the same devices for another organization on the same chain."""
    scope = Scope(chain_id=BINDING.chain_id, task_manager=BINDING.task_manager, organization="0x" + "77" * 20)
    return shop.submitted(shop.take, witnesses=Witnesses(scope=scope))


@HARNESS.forgery("order", "at worst", role="executor")
def statements_left_out(shop: CleaningWorkshop) -> Submission:
    """The motion capture's statements of ten seconds of the carry left out."""
    begin_s = middle_s(shop.take, 0.45)
    return shop.restated(shop.take, _motion_between(begin_s, begin_s + 10.0, lambda _: None))


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def the_item_never_leaves_the_floor(shop: CleaningWorkshop) -> Submission:
    """Motion capture saw the item lie there all the time; its statements of the carry are left out."""
    take = resting(shop.take, ITEM_POSE, 0)
    begin_s = middle_s(take, 0.3)
    return shop.restated(take, _motion_between(begin_s, begin_s + 15.0, lambda _: None))


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def nothing_ever_moves(shop: CleaningWorkshop) -> Submission:
    """Neither robot nor item move, but joints and odometry say so."""
    return shop.submitted(resting(resting(shop.take, ITEM_POSE, 0), ROBOT_POSE, 0))


@HARNESS.forgery("seen_throughout", "longest time without a signed pose of item3", role="executor")
def a_tossed_item(shop: CleaningWorkshop) -> Submission:
    """A person carries the item behind a curtain while the robot mimes. For three seconds nobody sees the
    item."""
    begin_s = middle_s(shop.take, 0.45)
    return shop.submitted(edited_between(shop.take, ITEM_POSE, begin_s, begin_s + 3.2, lambda _: None))


@HARNESS.forgery("order", "at worst", role="executor")
def seconds_left_out(shop: CleaningWorkshop) -> Submission:
    """The motion capture's statements of four seconds of the carry left out."""
    begin_s = middle_s(shop.take, 0.45)
    return shop.restated(shop.take, _motion_between(begin_s, begin_s + 4.5, lambda _: None))


@HARNESS.forgery("item_outside_bin", role="executor")
def already_in_the_bin(shop: CleaningWorkshop) -> Submission:
    """The item was in the bin before the work began."""
    return shop.submitted(resting(shop.take, ITEM_POSE, -1))


@HARNESS.forgery("item_in_gripper", role="executor")
def carried_by_somebody_else(shop: CleaningWorkshop) -> Submission:
    """The robot carries something else, and the task's item takes another way to the bin."""
    begin_s, end_s = middle_s(shop.take, 0.5), middle_s(shop.take, 0.6)
    return shop.submitted(edited_between(shop.take, ITEM_POSE, begin_s, end_s, lambda s: displaced(s, x=0.2)))


def _swaying(take: Take, topic: str, begin: float, end: float, sway_m: float) -> Take:
    """To and fro across the way, once in four seconds, between these shares of the time."""
    begin_s, end_s = middle_s(take, begin), middle_s(take, end)

    def sway(sample: Sample) -> Sample:
        return displaced(sample, x=sway_m * float(np.sin((sample.time_ns * 1e-9 - begin_s) * np.pi / 2)))

    return edited_between(take, topic, begin_s, end_s, sway)


@HARNESS.forgery("item_in_gripper", role="executor")
def a_person_carries_the_item(shop: CleaningWorkshop) -> Submission:
    """A person beside the robot carries the item, which sways by 4.5 cm. The arm is computed afterwards."""
    return shop.submitted(_swaying(shop.take, ITEM_POSE, 0.35, 0.55, 0.045))


@HARNESS.forgery("gripper_agrees", role="executor")
def an_arm_computed_afterwards(shop: CleaningWorkshop) -> Submission:
    """The joints follow an item that a person carried, but motion capture saw the gripper elsewhere."""
    return shop.submitted(_swaying(shop.take, GRIPPER_POSE, 0.3, 0.6, 0.087))


@HARNESS.forgery("gripper_agrees", "signed no motion of it", role="executor")
def a_gripper_that_nobody_saw(shop: CleaningWorkshop) -> Submission:
    """Somebody took the gripper's markers off."""
    return shop.submitted(shop.take.without(GRIPPER_POSE))


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def motion_without_an_item(shop: CleaningWorkshop) -> Submission:
    """The robot makes all motions of a cleaning, but the item does not move."""
    return shop.submitted(resting(shop.take, ITEM_POSE, 0))


@HARNESS.forgery("base_speed", role="holder of two keys")
def teleport(shop: CleaningWorkshop) -> Submission:
    """The base is somewhere else from one moment to the next, for the motion capture, too."""
    half_s = middle_s(shop.take)
    return shop.submitted(_aside(shop.take, half_s, shop.take.end_s + 1, 0.8))


def _aside(take: Take, begin_s: float, end_s: float, x: float) -> Take:
    """The base is somewhere else in this time, for its wheels, too."""
    for topic in (ROBOT_POSE, ODOM):
        take = edited_between(take, topic, begin_s, end_s, lambda s: displaced(s, x=x))
    return take


@HARNESS.forgery("base_acceleration", role="holder of two keys")
def instant_start(shop: CleaningWorkshop) -> Submission:
    """Short of the speed limit at once, and back."""
    begin_s = middle_s(shop.take)
    return shop.submitted(_aside(shop.take, begin_s, begin_s + 5, 0.35))


@HARNESS.forgery("turning_speed", role="holder of two keys")
def spinning(shop: CleaningWorkshop) -> Submission:
    """A base that turns faster than its wheels could, for the motion capture, too."""
    begin_s = middle_s(shop.take)

    def spin(sample: Sample) -> Sample:
        passed_s = sample.time_ns * 1e-9 - begin_s
        return turned(sample, yaw_rad=min(max(4.0 * passed_s, 0.0), 1.0))

    return shop.submitted(shop.take.edited(ROBOT_POSE, spin))


@HARNESS.forgery("odometry", role="executor")
def odometry_that_contradicts_motion_capture(shop: CleaningWorkshop) -> Submission:
    """Wheels that never turned."""
    return shop.submitted(without_wheels(shop.take))


@HARNESS.forgery("stays_in_room", role="holder of two keys")
def through_the_wall(shop: CleaningWorkshop) -> Submission:
    """A path on the other side of the wall, for the motion capture, too."""
    take = shop.take.edited(ROBOT_POSE, lambda s: displaced(s, x=1.6))
    return shop.submitted(take)


@HARNESS.forgery("stays_in_room", "crate", role="executor")
def through_the_furniture(shop: CleaningWorkshop) -> Submission:
    """The base drives where something stands."""
    at = middle_pose(shop.take.of(ROBOT_POSE))
    return shop.furnished(at.x, at.y, (0.3, 0.3, 0.3))


@HARNESS.forgery("stays_clear", "crate", role="executor")
def arm_through_the_furniture(shop: CleaningWorkshop) -> Submission:
    """The base keeps away from it, but the arm reaches through."""
    lies = shop.take.of(ITEM_POSE)[0].message.pose.position
    return shop.furnished(lies.x, lies.y, (0.1, 0.1, 0.5))


@HARNESS.forgery("cleaning_topics", "no message says numbers", role="executor")
def joints_that_are_no_numbers(shop: CleaningWorkshop) -> Submission:
    """The positions are NaN, for which every comparison is false."""
    nowhere = np.full(12, np.nan)
    return shop.submitted(shop.take.edited(JOINT_STATES, lambda s: with_joints(s, position=nowhere)))


@HARNESS.forgery("joint_range", role="executor")
def joints_beyond_their_range(shop: CleaningWorkshop) -> Submission:
    """The shoulder is outside its range."""

    def bend(sample: Sample) -> Sample:
        position = sample.message.position.copy()
        position[JOINT_SHOULDER] += 2.5
        return with_joints(sample, position=position)

    return shop.submitted(shop.take.edited(JOINT_STATES, bend))


JOINT_SHOULDER = WAIST + 1


@HARNESS.forgery("joint_speed", role="executor")
def joints_faster_than_the_arm(shop: CleaningWorkshop) -> Submission:
    """The waist jumps from one message to the next."""
    half_s, end_s = middle_s(shop.take), shop.take.end_s + 1
    return shop.submitted(
        edited_between(shop.take, JOINT_STATES, half_s, end_s, lambda s: waist_turned(s, 1.5))
    )


@HARNESS.forgery("gripper_force", role="executor")
def a_grip_of_steel(shop: CleaningWorkshop) -> Submission:
    """Fingers that press ten times harder than they can."""
    return shop.submitted(
        shop.take.edited(JOINT_STATES, lambda s: with_joints(s, effort=s.message.effort * _STRONG))
    )


_STRONG = np.ones(12)
_STRONG[FINGERS] = 10.0


@HARNESS.forgery("cleaning_topics", "no message says numbers", role="executor")
def fingers_that_measure_nothing(shop: CleaningWorkshop) -> Submission:
    """The efforts of the fingers are NaN throughout: nothing says that they held the item."""
    return shop.submitted(
        shop.take.edited(JOINT_STATES, lambda s: with_joints(s, effort=s.message.effort * np.nan))
    )


@HARNESS.forgery("cleaning_gaps", JOINT_STATES, role="executor")
def infinite_positions_for_a_while(shop: CleaningWorkshop) -> Submission:
    """The joints' positions are infinite in the part in which the robot misbehaved."""
    begin_s, end_s = middle_s(shop.take, 0.5), middle_s(shop.take, 0.65)
    take = edited_between(
        shop.take,
        JOINT_STATES,
        begin_s,
        end_s,
        lambda s: with_joints(s, position=s.message.position + np.inf),
    )
    return shop.submitted(take)


@HARNESS.forgery("odometry", "nan", role="executor")
def odometry_without_numbers(shop: CleaningWorkshop) -> Submission:
    """The odometry is NaN wherever it would disagree."""

    def unmeasured(sample: Sample) -> Sample:
        message = deepcopy(sample.message)
        message.pose.pose.position.x = math.nan
        return replace(sample, message=message)

    return shop.submitted(shop.take.edited(ODOM, unmeasured))


@HARNESS.forgery("gripper_agrees", role="executor")
def edited_trajectory(shop: CleaningWorkshop) -> Submission:
    """The arm moved elsewhere, and its recording is turned towards the item, but a few degrees too little."""
    take = shop.take.edited(ARM_STATE, lambda s: commanded(s, s.message.reference.positions + _TURNED))
    return shop.submitted(take.edited(JOINT_STATES, lambda s: waist_turned(s, 0.12)))


_TURNED = np.array([0.12, 0, 0, 0, 0, 0])


@HARNESS.forgery("arm_commanded", "median", role="executor")
def motion_that_nobody_commanded(shop: CleaningWorkshop) -> Submission:
    """The same in the joints alone: the commands led elsewhere."""
    return shop.submitted(
        shop.take.edited(ARM_STATE, lambda s: commanded(s, s.message.reference.positions + _TURNED))
    )


@HARNESS.forgery("arm_commanded", role="executor")
def commands_of_another_motion(shop: CleaningWorkshop) -> Submission:
    """The commands tell the arm to stay, but the joints show a cleaning."""
    first = shop.take.of(ARM_STATE)[0].message.reference.positions
    return shop.submitted(shop.take.edited(ARM_STATE, lambda s: commanded(s, first)))


@HARNESS.forgery("gripper_commanded", role="executor")
def a_grip_that_nobody_commanded(shop: CleaningWorkshop) -> Submission:
    """The fingers close, but the commands tell them to stay open."""
    first = shop.take.of(GRIPPER_STATE)[0].message.reference.positions
    return shop.submitted(shop.take.edited(GRIPPER_STATE, lambda s: commanded(s, first)))


@HARNESS.forgery("gripper_commanded", role="executor")
def commands_that_change_by_nothing(shop: CleaningWorkshop) -> Submission:
    """The fingers close against an open command whose reference changes by 1e-9 m per message."""
    first = shop.take.of(GRIPPER_STATE)[0].message.reference.positions

    def open_still(sample: Sample) -> Sample:
        return commanded(sample, first + 1e-9 * (sample.sequence % 2) * np.array([1.0, -1.0]))

    return shop.submitted(shop.take.edited(GRIPPER_STATE, open_still))


@HARNESS.forgery("gripper_commanded", "are not finite", role="executor")
def commands_that_are_no_numbers(shop: CleaningWorkshop) -> Submission:
    """The reference of the fingers is NaN."""
    nowhere = np.full(2, np.nan)
    return shop.submitted(shop.take.edited(GRIPPER_STATE, lambda s: commanded(s, nowhere)))


@HARNESS.forgery("gripper_commanded", "wider than they were", role="executor")
def commands_to_and_fro(shop: CleaningWorkshop) -> Submission:
    """The commands alternate between open and closed, so that every position fits one of them."""
    first = shop.take.of(GRIPPER_STATE)[0].message.reference.positions

    def to_and_fro(sample: Sample) -> Sample:
        return commanded(sample, first) if sample.sequence % 2 else sample

    return shop.submitted(shop.take.edited(GRIPPER_STATE, to_and_fro))


@HARNESS.forgery("arm_commanded", "are not finite", role="executor")
def arm_commands_that_are_no_numbers(shop: CleaningWorkshop) -> Submission:
    """The reference of the arm is NaN."""
    nowhere = np.full(6, np.nan)
    return shop.submitted(shop.take.edited(ARM_STATE, lambda s: commanded(s, nowhere)))


@HARNESS.forgery("cleaning_topics", "gripper_controller", role="executor")
def commands_left_out(shop: CleaningWorkshop) -> Submission:
    """The recording contains measured positions only."""
    return shop.submitted(shop.take.without(GRIPPER_STATE))


@HARNESS.forgery("carried", "does not close", role="executor")
def gripper_never_closed(shop: CleaningWorkshop) -> Submission:
    """Somebody else carried the item beside the robot."""
    return shop.submitted(shop.take.edited(JOINT_STATES, opened))


@HARNESS.forgery("compartment", "outside the bin", role="executor")
def dropped_on_the_way(shop: CleaningWorkshop) -> Submission:
    """The fingers open half-way, and a person carries the item the rest of the way."""
    begin_s, end_s = middle_s(shop.take, 0.62), shop.take.end_s + 1
    take = edited_between(shop.take, GRIPPER_STATE, begin_s, end_s, lambda s: commanded(s, WIDE))
    return shop.submitted(edited_between(take, JOINT_STATES, begin_s, end_s, opened))


@HARNESS.forgery("item_place", role="creator")
def an_item_from_elsewhere(shop: CleaningWorkshop) -> Submission:
    """Another piece of trash than the one that the task is about."""
    return shop.submitted(shop.take, params=PLACE | {"x_m": 4.6})


# -- without motion capture, where the robot's own sight stands in --------------------------------------


@HARNESS.forgery("item_place", "perception", role="executor")
def seen_elsewhere(shop: CleaningWorkshop) -> Submission:
    """The robot saw the item farther from the task's place than the task allows."""
    return shop.blind(without_mocap(shop.take, ITEM, off_m=(0.4, 0.0)))


@HARNESS.forgery("grasp", role="executor")
def seen_beside_the_gripper(shop: CleaningWorkshop) -> Submission:
    """An invented motion without an item, and an invented sighting nearby."""
    return shop.blind(without_mocap(shop.take, ITEM, off_m=(0.08, 0.08)))


@HARNESS.forgery("replayed", "did not record where it saw the item", role="executor")
def never_seen(shop: CleaningWorkshop) -> Submission:
    """Arm and gripper move as if there were an item, but nobody saw an item before."""
    take = without_mocap(shop.take, ITEM)
    end_ns = take.samples[-1].time_ns
    late = [timed(s, end_ns) if s.topic == SEEN else s for s in take.samples]
    return shop.blind(Take(sorted(late, key=lambda s: s.time_ns)))


@HARNESS.forgery("carried", "never closes on something", role="executor")
def nothing_between_the_fingers(shop: CleaningWorkshop) -> Submission:
    """A gripper that closes on nothing and rises."""

    def empty(sample: Sample) -> Sample:
        position = sample.message.position.copy()
        closed = np.abs(position[FINGERS]) < 0.05
        position[FINGERS] = np.where(closed, np.array([0.021, -0.021]), position[FINGERS])
        return with_joints(sample, position=position)

    return shop.blind(without_mocap(shop.take, ITEM).edited(JOINT_STATES, empty))


# -- the bin -------------------------------------------------------------------------------------------


@HARNESS.forgery("compartment", role="executor")
def wrong_compartment(shop: CleaningWorkshop) -> Submission:
    """The robot drops the item into the nearest compartment instead of the right one."""
    return shop.submitted(film_cleaning(shop.site, ITEM, via=(), compartment="green"))


def _resigned(kind: str, account: LocalAccount, **changes: Any) -> Edit:
    """Statements of that type with other words, under another key."""

    def sign(attestation: Attestation) -> Attestation:
        if attestation.payload["type"] != kind:
            return attestation
        return attest(attestation.payload | changes, account)

    return sign


@HARNESS.forgery("compartment", "no classification signed by the bin", role="executor")
def wrong_class(shop: CleaningWorkshop) -> Submission:
    """A classification of the robot's own making."""
    words = {"class": "glass", "compartment": "green"}
    return shop.restated(shop.take, _resigned("bin.classification", ROBOT, **words))


@HARNESS.forgery("compartment", "no classification signed by the bin", role="executor")
def altered_classification(shop: CleaningWorkshop) -> Submission:
    """The bin's own signature under altered content."""

    def alter(attestation: Attestation) -> Attestation:
        if attestation.payload["type"] != "bin.classification":
            return attestation
        return attestation.model_copy(update={"payload": attestation.payload | {"class": "glass"}})

    return shop.restated(shop.take, alter)


@HARNESS.forgery("classified", role="executor")
def classification_of_another_item(shop: CleaningWorkshop) -> Submission:
    """The bin's signed classification of the previous item."""
    return shop.submitted(told(shop.take, "bin/classification", shown_s=shop.take.start_s))


@HARNESS.forgery("dropped", "no drop signed by the bin", role="executor")
def spoofed_drop(shop: CleaningWorkshop) -> Submission:
    """A drop that the robot signs itself."""
    return shop.restated(shop.take, _resigned("bin.drop", ROBOT))


@HARNESS.forgery("dropped", role="executor")
def drop_of_another_item(shop: CleaningWorkshop) -> Submission:
    """The bin's drop refers to another classification."""
    return shop.submitted(told(shop.take, "bin/drop", classification=2))


@HARNESS.forgery("dropped", role="executor")
def drop_of_an_hour_ago(shop: CleaningWorkshop) -> Submission:
    """The bin signed the drop before the release."""
    start_s = shop.take.start_s
    return shop.submitted(told(shop.take, "bin/drop", after_s=start_s, settled_s=start_s + 5))


@HARNESS.forgery("dropped", "no drop signed by the bin", role="executor")
def a_statement_from_the_future(shop: CleaningWorkshop) -> Submission:
    """The recording contains the statement before the bin signed it: it was inserted before a new seal."""
    end_s = shop.take.end_s
    return shop.submitted(told(shop.take, "bin/drop", time_s=end_s + 300))


@HARNESS.forgery("bin_witnessed", "nothing signed by this witness", role="executor")
def a_bin_of_another_site(shop: CleaningWorkshop) -> Submission:
    """Signed by a bin that is registered under another name."""
    return shop.submitted(shop.take, devices=registered("bin", name="itrash2"))


@HARNESS.forgery("bin_witnessed", "nothing signed by this witness", role="executor")
def carried_into_another_bin(shop: CleaningWorkshop) -> Submission:
    """The task names another bin of the site than the one that the item is in."""
    return shop.beside_another_bin(bin="itrash2")


# -- where the item ends -------------------------------------------------------------------------------


def _homewards(sample: Sample, begin_s: float) -> Sample:
    """After the release the item goes back to where it lay, within two seconds."""
    passed_s = sample.time_ns * 1e-9 - begin_s
    if passed_s <= 0:
        return sample
    at = sample.message.pose.position
    share = min(passed_s / 2.0, 1.0)
    return displaced(sample, x=share * (PLACE["x_m"] - at.x), y=share * (PLACE["y_m"] - at.y))


@HARNESS.forgery("stays_in_bin", role="executor")
def a_pebble_falls(shop: CleaningWorkshop) -> Submission:
    """A person hides the item in a sleeve while a pebble falls. All poses of the item are signed."""
    rim_m = shop.site.bins[0].rim_height_m
    begin_s = max(s.time_ns for s in shop.take.of(ITEM_POSE) if s.message.pose.position.z > rim_m) * 1e-9
    return shop.submitted(shop.take.edited(ITEM_POSE, lambda s: _homewards(s, begin_s)))


@HARNESS.forgery("stays_in_bin", role="executor")
def taken_out_again(shop: CleaningWorkshop) -> Submission:
    """Two seconds after the drop, somebody takes the item home. All its poses are signed."""
    begin_s = _drop(shop)["settled_s"] + 2.0
    return shop.submitted(shop.take.edited(ITEM_POSE, lambda s: _homewards(s, begin_s)))


@HARNESS.forgery("stays_in_bin", "taken out", role="executor")
def taken_out_where_nobody_sees_it(shop: CleaningWorkshop) -> Submission:
    """The same behind the bin's walls, but the bin measures the loss of weight."""
    return shop.submitted(_covered_from(_taken_out(shop), _drop(shop)["settled_s"] + 0.5))


@HARNESS.forgery("nothing_left_out", "itrash", role="executor")
def a_removal_left_out(shop: CleaningWorkshop) -> Submission:
    """The same, and the recording lacks the bin's statement about it. Motion capture heard that statement."""
    return shop.restated(_taken_out(shop), lambda one: None if one.payload["type"] == "bin.removal" else one)


@HARNESS.forgery("nothing_left_out", "motion capture", role="executor")
def a_removal_left_out_with_who_heard_of_it(shop: CleaningWorkshop) -> Submission:
    """The same, and the recording also lacks motion capture's statements that list the removal."""
    told: list[str] = []

    def edit(one: Attestation) -> Attestation | None:
        if one.payload["type"] == "bin.removal":
            told.append(payload_digest(one.payload))
            return None
        return None if any(head["digest"] in told for head in one.payload["heads"]) else one

    return shop.restated(_taken_out(shop), edit)


@HARNESS.forgery("stays_in_bin", "left it", role="executor")
def picked_up_beside_the_bin(shop: CleaningWorkshop) -> Submission:
    """The item falls beside the bin. A person picks it up and throws it in before the bin weighs it."""
    begin_s = _last_above_the_bin_s(shop)

    def beside(sample: Sample) -> Sample:
        return displaced(sample, x=-0.8) if begin_s < sample.time_ns * 1e-9 < begin_s + 2.5 else sample

    return shop.submitted(shop.take.edited(ITEM_POSE, beside))


@HARNESS.forgery("stays_in_bin", "left out", role="executor")
def taken_home_and_covered_later(shop: CleaningWorkshop) -> Submission:
    """A person takes the item away while a pebble falls, and covers it before its next signed pose. The one
    statement that shows it is left out."""
    begin_s = _last_above_the_bin_s(shop) + 0.05
    take = _covered_from(_taken_home(shop, begin_s, 0.8), begin_s + 8.5)
    return shop.restated(take, _motion_between(begin_s, begin_s + 2.0, lambda _: None))


@HARNESS.forgery("nothing_left_out", "motion capture", role="executor")
def taken_home_while_it_falls(shop: CleaningWorkshop) -> Submission:
    """The same, covered at once. The statements are missing from that of the release on."""
    begin_s = _last_above_the_bin_s(shop) - 0.75
    take = _covered_from(_taken_home(shop, begin_s, 1.5), begin_s + 1.5)
    return shop.restated(take, _motion_between(begin_s - 0.2, begin_s + 2.8, lambda _: None))


def _last_above_the_bin_s(shop: CleaningWorkshop) -> float:
    rim_m = shop.site.bins[0].rim_height_m
    return max(s.time_ns for s in shop.take.of(ITEM_POSE) if s.message.pose.position.z > rim_m) * 1e-9


def _taken_home(shop: CleaningWorkshop, begin_s: float, lasts_s: float) -> Take:
    """From then on the item goes back to where it lay."""

    def there(sample: Sample) -> Sample:
        share = min(max((sample.time_ns * 1e-9 - begin_s) / lasts_s, 0.0), 1.0)
        at = sample.message.pose.position
        return displaced(sample, x=share * (PLACE["x_m"] - at.x), y=share * (PLACE["y_m"] - at.y))

    return shop.take.edited(ITEM_POSE, there)


def _covered_from(take: Take, time_s: float) -> Take:
    """From then on motion capture does not see the item."""
    return take.edited(ITEM_POSE, lambda s: s if s.time_ns * 1e-9 <= time_s else None)


def _taken_out(shop: CleaningWorkshop) -> Take:
    drop = _drop(shop)
    removal = {
        "compartment": drop["compartment"],
        "weight_n": drop["weight_n"],
        "after_s": drop["settled_s"] + 1.0,
        "settled_s": drop["settled_s"] + 2.0,
    }
    time_ns = round((drop["settled_s"] + 2.0) * 1e9)
    samples = [*shop.take.samples, Sample("bin/removal", "", removal, time_ns)]
    return Take(sorted(samples, key=lambda s: s.time_ns))


@HARNESS.forgery("stays_in_bin", "to the end of the recording", role="executor")
def a_recording_that_ends_at_once(shop: CleaningWorkshop) -> Submission:
    """The recording ends right after the drop."""
    end_s = _drop(shop)["settled_s"] + 3.0
    return shop.submitted(Take([s for s in shop.take.samples if s.time_ns * 1e-9 < end_s]))


@HARNESS.forgery("stays_in_bin", "to the end of the recording", role="executor")
def statements_that_end_at_once(shop: CleaningWorkshop) -> Submission:
    """The recording continues, but without motion capture's statements."""
    end_s = _drop(shop)["settled_s"] + 3.0
    return shop.restated(shop.take, _motion_between(end_s, shop.take.end_s + 9, lambda _: None))


@HARNESS.forgery("pictured", "not in the recording", role="executor")
def no_picture(shop: CleaningWorkshop) -> Submission:
    """The recording lacks the picture that the bin classified."""
    return shop.submitted(shop.take.without(PICTURE))


@HARNESS.forgery("pictured", "no picture", role="executor")
def another_picture(shop: CleaningWorkshop) -> Submission:
    """A clearer picture than the one that the bin signed."""
    nicer = np.frombuffer((RENDERINGS / "paper_2.jpg").read_bytes(), np.uint8)
    return shop.submitted(shop.take.edited(PICTURE, lambda s: with_fields(s, data=nicer)))


@HARNESS.forgery("pictured", "no picture", role="holder of two keys", doubts="the bin itrash")
def the_hash_of_an_empty_picture(shop: CleaningWorkshop) -> Submission:
    """The bin of somebody who holds its key signs the hash of nothing, and nothing is in the proof."""
    empty = shop.take.edited(PICTURE, lambda s: with_fields(s, data=np.zeros(0, np.uint8)))
    return shop.submitted(told(empty, "bin/classification", image_sha256="0x" + sha256(b"").hexdigest()))


@HARNESS.forgery("pictured", "no picture in the recording", role="holder of two keys")
def a_picture_that_nobody_has(shop: CleaningWorkshop) -> Submission:
    """The bin of somebody who holds its key claims to have combined a further picture."""
    shown_s = shop.take.of("bin/classification")[0].message["shown_s"]
    more = {"image_sha256": "0x" + sha256(b"a clearer one").hexdigest(), "taken_s": shown_s - 0.5}
    return shop.submitted(told(shop.take, "bin/classification", earlier=[more]))


@HARNESS.forgery("classified", "before the grasp", role="holder of two keys", doubts="the bin itrash")
def a_picture_of_another_task(shop: CleaningWorkshop) -> Submission:
    """The bin of somebody who holds its key combined a picture of the item before this one."""
    more = {"image_sha256": "0x" + sha256(b"the last item").hexdigest(), "taken_s": shop.take.start_s}
    return shop.submitted(told(shop.take, "bin/classification", earlier=[more]))


@HARNESS.forgery("pictured", "the rules do not list", role="holder of two keys", doubts="the bin itrash")
def the_word_of_its_own_network(shop: CleaningWorkshop) -> Submission:
    """The bin of somebody who holds its key asked a network that says what its owner likes."""
    own = "0x" + sha256(b"a network that calls everything plastic").hexdigest()
    return shop.submitted(told(shop.take, "bin/classification", model_sha256=own))


@HARNESS.forgery(
    "pictured", "the network that it names says paper", role="holder of two keys", doubts="the bin itrash"
)
def the_word_of_nobodys_network(shop: CleaningWorkshop) -> Submission:
    """The bin of somebody who holds its key calls paper cardboard, in the name of the listed network."""
    cardboard = {"item_class": "cardboard", "probabilities": {"cardboard": 1.0}}
    return shop.submitted(told(shop.take, "bin/classification", **cardboard))


@HARNESS.forgery("weight", "0.01 N", role="executor")
def a_feather(shop: CleaningWorkshop) -> Submission:
    """The bin measured a hundredth of a newton."""
    return shop.submitted(told(shop.take, "bin/drop", weight_n=0.01))


@HARNESS.forgery("weight", "50.0 N", role="executor", doubts="whoever dropped it")
def a_brick(shop: CleaningWorkshop) -> Submission:
    """The bin measured five kilograms."""
    return shop.submitted(told(shop.take, "bin/drop", weight_n=50.0))


def _drop(shop: CleaningWorkshop) -> dict[str, Any]:
    fields: dict[str, Any] = shop.take.of("bin/drop")[0].message
    return fields


# -- whose act it is -----------------------------------------------------------------------------------


@HARNESS.forgery("executor_on_site", role="bystander")
def a_member_without_a_body(shop: CleaningWorkshop) -> Submission:
    """A member that is no robot of the site seals what another's robot did."""
    return shop.submitted(shop.take, executor_name="mallory")


@HARNESS.forgery("executor_on_site", role="executor")
def a_device_of_another_robot(shop: CleaningWorkshop) -> Submission:
    """Another robot than the executor's sealed the recording."""
    return shop.submitted(shop.take, devices=registered("robot", name="panther2"))


@HARNESS.forgery("presented", "panther2", role="executor")
def somebody_elses_drop(shop: CleaningWorkshop) -> Submission:
    """Another robot presented itself to the bin for the same act."""
    theirs = Claimant(device="panther2", address=STRANGER.address, recording=_ANOTHER, task_id=9, attempt=1)
    take = told(shop.take, "bin/classification", claimants=(theirs,))
    return shop.submitted(told(take, "bin/drop", claimants=(theirs,)))


@HARNESS.forgery("presented", "for task 9", role="executor")
def shown_for_another_task(shop: CleaningWorkshop) -> Submission:
    """The same robot showed the item for another of its tasks and recordings."""
    other = Claimant(
        device="panther1", address=ROBOT.address, recording="0x" + "5a" * 32, task_id=9, attempt=1
    )
    take = told(told(shop.take, "bin/classification", claimants=(other,)), "bin/drop", claimants=(other,))
    return shop.submitted(take)


@HARNESS.forgery("presented", "nobody", role="executor")
def never_presented(shop: CleaningWorkshop) -> Submission:
    """The bin's drop names no robot."""
    return shop.submitted(shop.take.without("robot/presentation"))
