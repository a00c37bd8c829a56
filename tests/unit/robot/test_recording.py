"""Recording: every recorded topic of the table, as it came, and nothing of other items."""

from __future__ import annotations

import base64
import math
import threading
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, zenoh_config
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import UNREADABLE, Recorder
from rodeo.host.clock import WallClock
from rodeo.robot import recording as recording_module
from rodeo.robot.errors import NoAnswer
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.recording import (
    RecordedRobot,
    Recording,
    recorded_topics,
)
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import Plane
from rodeo.witness.chain import WitnessChain
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.poses import pack
from rodeo.witness.statement import Classification, Drop, Head, Header, Motion, Removal, Scope
from rodeo.witness.witness import unverified_seal
from rodeo_testing.assignments import BIN as BIN_KEY
from rodeo_testing.assignments import BINDING, MOCAP, ROBOT, devices
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import LAB, free_port
from tests.unit.robot.fakes import BIN, payload_of

SITE = Site.load(LAB)
PLACE = 4.5, 1.25
"""Where motion capture shows everything, x and y in m."""
SCOPE = Scope(chain_id=BINDING.chain_id, task_manager=BINDING.task_manager, organization=BINDING.organization)


RECORDS = (*topics.ROBOT_STATE, topics.BIN_LOAD)


def test_every_topic_that_is_asked_for_is_recorded_under_its_full_names() -> None:
    recorded = {name: topic.type for topic, name in recorded_topics(SITE, "panther1", RECORDS)}
    assert recorded["panther1/odom"] == "nav_msgs/msg/Odometry"
    assert {f"itrash/{name}/load" for name in SITE.bins[0].compartments} <= recorded.keys()
    assert {topic.type for topic in RECORDS} == set(recorded.values())
    assert not any("{" in name for name in recorded)


def test_all_bins_and_docks_are_recorded() -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    records = (topics.BIN_LOAD, topics.DOCK_OUTPUT, topics.BIN_IMAGE)
    names = {name for _, name in recorded_topics(site, "panther1", records)}
    assert {f"{bin_.name}/{name}/load" for bin_ in site.bins for name in bin_.compartments} <= names
    assert {"dock_west/output", "dock_east/output", "bin_east/camera/image/compressed"} <= names


def test_what_a_robot_tells_of_itself_may_be_recorded() -> None:
    assert all(topic.recorded and topic.plane is Plane.ROBOT for topic in topics.ROBOT_STATE)


class Lab:
    """Body, bridge, bin and motion capture on a bus of their own; `mocap` and `itrash` sign."""

    def __init__(self, folder: Path) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._router = zenoh.open(zenoh_config("router", listen=[self.endpoint]))
        self.bus = Bus.open(self.endpoint, timeout_s=HANG_S)
        self.clock = WallClock()
        self._node = Node(self.bus.session, "lab", "", 0, self.clock)
        self._said = [
            self._node.publisher(name, topic.type)
            for topic, name in recorded_topics(SITE, "panther1", RECORDS)
            if topic in (topics.ODOM, topics.JOINT_STATES)
        ]
        self._types = [topics.ODOM.type, topics.JOINT_STATES.type]
        self.mocap, self.itrash = (
            WitnessChain(name, key, SCOPE, "sensor", Journal(folder / f"{name}.jsonl"), HeadBook())
            for name, key in (("mocap", MOCAP), ("itrash", BIN_KEY))
        )
        self.heads: list[Head] = []
        self.lists_heads = True
        """Whether motion capture lists what it heard."""
        self.bus.serve(topics.STATE.name(org=SITE.org, what="devices"), self._devices)
        for chain in (self.mocap, self.itrash):
            key = topics.WITNESS_STATEMENTS.name(org=SITE.org, device=chain.device)
            self.bus.serve(key, lambda request, chain=chain: self._journal(request, chain))
        self.bus.subscribe_bytes(topics.SEAL.name(org=SITE.org, device="*"), self._on_seal)
        self.start_us = round(self.clock.now_s() * 1e6)

    @staticmethod
    def _devices(_request: Any) -> dict[str, Any]:
        return {"devices": [device.model_dump() for device in devices()]}

    @staticmethod
    def _journal(request: Any, chain: WitnessChain) -> dict[str, Any]:
        after = int(request.parameters["after"])
        return {"statements": [one.model_dump() for one in chain.after(after, 200)]}

    def _on_seal(self, _key: str, data: bytes) -> None:
        self.heads.append(unverified_seal(data).spoken.head)

    def move(self) -> None:
        """One message on each topic of the body."""
        sec, nanosec = divmod(self.clock.now_ns(), 10**9)
        for publisher, type_ in zip(self._said, self._types, strict=True):
            message = types.new(type_)
            if type_ == topics.ODOM.type:
                message.pose.pose.orientation.w = 1.0
            else:
                message.name, message.position = ["waist"], np.zeros(1)
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            publisher.publish(message)

    def watch(self, *bodies: str, tell: bool = True) -> Attestation:
        """The next statement of motion capture, up to now, with all heads that were heard."""
        for head in self.heads if self.lists_heads else ():
            self.mocap.heads.hear(head)
        end_us = round(self.clock.now_s() * 1e6)
        track = pack(np.zeros(1), np.array([[*PLACE, 0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]]))
        statement = self.mocap.sign(
            Motion,
            end_us * 1e-6,
            start_us=self.start_us,
            end_us=end_us,
            tracks=dict.fromkeys(bodies, track),
            resting={},
        )
        self.start_us = end_us
        if tell:
            self.tell(statement, "mocap")
        return statement

    def tell(self, statement: Attestation, device: str) -> None:
        self.bus.put_json(topics.WITNESS_STATEMENT.name(org=SITE.org, device=device), statement)

    def close(self) -> None:
        self.bus.close()
        self._router.close()


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    lab = Lab(tmp_path / "lab")
    yield lab
    lab.close()


class Session:
    """A recording in progress, made in a thread because it waits for the lab."""

    def __init__(self, lab: Lab, path: Path) -> None:
        self.lab, self.path = lab, path
        self.bus = Bus.open(lab.endpoint, timeout_s=HANG_S)
        self._made: list[Recording] = []
        self._thread = threading.Thread(target=self._make)
        self._thread.start()

    def _make(self) -> None:
        node = Node(self.bus.session, "recorder", "", 0, self.lab.clock)
        robot = RecordedRobot(SITE, "panther1", ROBOT, self.bus, self.lab.clock, Interrupts())
        self._made.append(Recording(self.path, BINDING, node, robot, RECORDS))

    @property
    def begun(self) -> bool:
        return bool(self._made)

    @property
    def recording(self) -> Recording:
        return self._made[0]

    def begin(self) -> Session:
        until(lambda: self.begun, self.lab.move, self.lab.watch)
        return self

    def end(self) -> list[Attestation]:
        """The statements in the file."""
        catching_up = threading.Thread(target=self.recording.catch_up)
        catching_up.start()
        until(lambda: not catching_up.is_alive(), self.lab.move, self.lab.watch)
        self.recording.suspend()
        self.bus.close()
        Recorder.finish(self.path, BINDING, ROBOT, self.lab.clock)
        self.proof = open_proof(self.path)
        return self.proof.attestations()


def until(true: Callable[[], bool], *meanwhile: Callable[[], Any]) -> None:
    """Wait until it is true, while something else runs."""

    def holds() -> bool:
        for go_on in meanwhile:
            go_on()
        return true()

    wait_until(holds)


def seqs(statements: list[Attestation], device: str) -> list[int]:
    return [one.payload["seq"] for one in statements if one.payload["device"] == device]


@pytest.fixture
def session(lab: Lab, tmp_path: Path) -> Session:
    return Session(lab, tmp_path / "recording.mcap")


def test_a_recording_begins_when_body_and_motion_capture_are_heard(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits, heard = Recording._await, list[int]()

    def counted(recording: Recording, done: Callable[[], bool], limit_s: float) -> bool:
        def look() -> bool:
            heard.append(len(recording._arrived.names))
            return done()

        return waits(recording, look, limit_s)

    monkeypatch.setattr(Recording, "_await", counted)
    monkeypatch.setattr(recording_module, "_SILENT_WALL_S", HANG_S)
    monkeypatch.setattr(recording_module, "_LOOK_S", 0.01)
    session = Session(lab, tmp_path / "recording.mcap")
    # It looked once more after the look that saw both topics of the body.
    until(lambda: session.begun or heard.count(2) >= 2, lab.move)
    assert not session.begun and not session.path.exists()
    session.begin()
    assert session.path.exists()
    session.end()


def test_each_seal_is_told_and_names_the_recording(lab: Lab, session: Session) -> None:
    session.begin()
    session.recording.note({"event": "something"})
    until(lambda: len(lab.heads) >= 2, lab.move)
    session.end()
    opening = session.recording.claimant.recording
    assert {head.chain for head in lab.heads} == {opening} == {session.proof.recording}
    known = {
        f"0x{digest}" if not digest.startswith("0x") else digest for digest in session.proof.seal_digests
    }
    assert {head.digest for head in lab.heads} <= known


def test_others_words_in_a_note_are_written_as_text(lab: Lab, session: Session) -> None:
    session.begin()
    session.recording.note({"event": "retry", "details": {"left_m": math.nan, "message": "a \ud800"}})
    args = {"params": "\ud800"}
    session.recording.event(
        DaoEvent(seq=1, name="Odd", block=1, log_index=0, tx_hash="0x", time_s=0.0, task_id=7, args=args)
    )
    session.end()
    noted = [one for one in session.proof.events() if one["event"] in ("retry", UNREADABLE)]
    assert noted[0]["details"] == {"left_m": "nan", "message": "a \\ud800"}
    assert noted[1]["name"] == "Odd"


def test_a_statement_that_was_lost_is_asked_for_again(lab: Lab, session: Session) -> None:
    session.begin()
    first = lab.watch()
    lost = [lab.watch(tell=False) for _ in range(3)]
    last = lab.watch()
    statements = session.end()
    for one in (first, *lost, last):
        assert one in statements
    numbers = seqs(statements, "mocap")
    assert sorted(numbers) == list(range(min(numbers), max(numbers) + 1))


def test_what_was_stated_last_is_asked_for_before_the_recording_ends(lab: Lab, session: Session) -> None:
    session.begin()
    lab.watch()
    shown = removal(lab, tell=True)
    until(lambda: "itrash" in written(session), lab.move)
    fallen = removal(lab, tell=False)
    statements = session.end()
    assert shown in statements and fallen in statements


def test_what_was_stated_while_nothing_was_recorded_is_in_the_recording_that_goes_on(
    lab: Lab, session: Session
) -> None:
    session.begin()
    lab.watch()
    removal(lab, tell=True)
    until(lambda: "itrash" in written(session), lab.move)
    session.recording.suspend()
    session.bus.close()
    missed = [lab.watch(tell=False), removal(lab, tell=False)]
    statements = Session(lab, session.path).begin().end()
    assert [one for one in missed if one not in statements] == []
    numbers = seqs(statements, "mocap")
    assert sorted(numbers) == list(range(min(numbers), max(numbers) + 1))


def removal(lab: Lab, tell: bool) -> Attestation:
    now_s = lab.clock.now_s()
    said = lab.itrash.sign(
        Removal, now_s, compartment="blue", weight_n=0.1, after_s=now_s - 1, settled_s=now_s
    )
    if tell:
        lab.tell(said, "itrash")
    return said


def written(session: Session) -> set[str]:
    return {name for _address, name, _through in session.recording._listener._door.known()}


def test_the_item_may_be_moved_once_motion_capture_lists_the_recording_and_shows_item_and_robot(
    lab: Lab, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.lists_heads = False
    session.begin()
    monkeypatch.setattr(recording_module, "_WITNESS_S", 0.3)
    until(lambda: bool(lab.heads), lab.move)
    lab.watch("item1")
    with pytest.raises(NoAnswer) as caught:
        session.recording.await_witness("item1")
    assert not caught.value.details["listed"]
    lab.lists_heads = True
    until(lambda: session.recording._arrived.is_listed, lab.watch)
    # A robot that was started again beside the item may grasp it before it moves its base.
    with pytest.raises(NoAnswer) as caught:
        session.recording.await_witness("item1")
    assert not caught.value.details["shown"]
    lab.watch("panther1")
    monkeypatch.setattr(recording_module, "_WITNESS_S", HANG_S)
    session.recording.await_witness("item1")
    assert session.recording.places == {"item1": pytest.approx(PLACE), "panther1": pytest.approx(PLACE)}
    monkeypatch.setattr(recording_module, "_WITNESS_S", 0.3)
    with pytest.raises(NoAnswer):
        session.recording.await_witness("item2")
    session.end()


def test_motion_capture_that_fell_silent_is_waited_for_until_it_tells_of_what_is_judged(
    lab: Lab, session: Session
) -> None:
    session.begin()
    lab.watch("item1")
    now_s = lab.clock.now_s()
    assert not session.recording.await_motion(now_s + 60.0, latest_s=now_s)
    until(lambda: session.recording._arrived.motion_ns > now_s * 1e9, lab.watch)
    assert session.recording.await_motion(now_s, latest_s=now_s)
    session.end()


def test_nonsense_is_left_out_and_told_of_at_the_end(lab: Lab, session: Session) -> None:
    session.begin()
    nonsense = lab.watch(tell=False).model_copy(update={"signature": "0x" + "11" * 65})
    for _ in range(5):
        lab.tell(nonsense, "mocap")
        lab.bus.put_json(topics.WITNESS_STATEMENT.name(org=SITE.org, device="mocap"), {"payload": 7})
    honest = lab.watch()
    assert honest in session.end()
    event = next(event for event in session.proof.events() if event.get("event") == "left_out")
    assert event["counts"]["statement:bad_signature"] == 5
    assert event["counts"]["statement:malformed"] == 5
    assert nonsense not in session.proof.attestations()


def test_all_pictures_that_the_bin_combined_are_in_the_recording(lab: Lab, session: Session) -> None:
    pictures = [b"\xff\xd8 the first", b"\xff\xd8 from another side"]
    by_hash = {"0x" + sha256(picture).hexdigest(): picture for picture in pictures}
    first, last = by_hash
    lab.bus.serve(
        topics.BIN_PICTURE.name(org=SITE.org, bin="itrash"),
        lambda asked: {"data_base64": base64.b64encode(by_hash[asked.parameters["sha256"]]).decode()},
    )
    session.begin()
    now_s = lab.clock.now_s()
    more = {
        "image_sha256": last, "claimants": [session.recording.claimant.model_dump()], "shown_s": now_s,
        "earlier": [{"image_sha256": first, "taken_s": now_s - 1}],
    }  # fmt: skip
    fields = payload_of(Classification, 1, BIN, **more)
    own = {key: fields[key] for key in fields if key not in Header.model_fields and key != "type"}
    lab.tell(lab.itrash.sign(Classification, now_s, **own), "itrash")
    lab.move()
    session.end()
    kept = session.proof.topics["/" + topics.BIN_IMAGE.name(bin="itrash")].data
    assert [types.deserialize(one, topics.BIN_IMAGE.type).data.tobytes() for one in kept] == pictures[::-1]


def test_the_picture_of_what_fell_is_in_the_recording_however_many_were_taken_before(
    lab: Lab, session: Session
) -> None:
    pictures = [b"\xff\xd8 picture %d" % number for number in range(50)]
    by_hash = {"0x" + sha256(picture).hexdigest(): picture for picture in pictures}
    lab.bus.serve(
        topics.BIN_PICTURE.name(org=SITE.org, bin="itrash"),
        lambda asked: {"data_base64": base64.b64encode(by_hash[asked.parameters["sha256"]]).decode()},
    )
    session.begin()
    named = [session.recording.claimant.model_dump()]

    def tell(model: type[Classification | Drop], **more: Any) -> None:
        fields = payload_of(model, 1, BIN, about_s=lab.clock.now_s(), claimants=named, **more)
        own = {key: fields[key] for key in fields if key not in Header.model_fields and key != "type"}
        lab.tell(lab.itrash.sign(model, lab.clock.now_s(), **own), "itrash")

    for number, name in enumerate(by_hash, 1):
        tell(Classification, number=number, image_sha256=name)
    tell(Drop, classification=len(by_hash))
    lab.move()
    session.end()
    kept = session.proof.topics["/" + topics.BIN_IMAGE.name(bin="itrash")].data
    assert pictures[-1] in [types.deserialize(one, topics.BIN_IMAGE.type).data.tobytes() for one in kept]
    assert len(kept) == 37


def test_the_picture_that_the_bin_classified_is_in_the_recording(lab: Lab, session: Session) -> None:
    picture = b"\xff\xd8 what the camera encoded"
    name = "0x" + sha256(picture).hexdigest()
    key = topics.BIN_PICTURE.name(org=SITE.org, bin="itrash")
    wrong = base64.b64encode(b"another picture").decode()
    answers = [
        {"data_base64": wrong},
        {"data_base64": "?"},
        {"data_base64": base64.b64encode(picture).decode()},
    ]

    def give(request: Any) -> dict[str, Any]:
        assert request.parameters["sha256"] == name
        return answers.pop(0) if len(answers) > 1 else answers[0]

    lab.bus.serve(key, give)
    session.begin()
    claimant = session.recording.claimant
    more = {"image_sha256": name, "claimants": [claimant.model_dump()], "shown_s": lab.clock.now_s()}
    fields = payload_of(Classification, 1, BIN, **more)
    own = {key: fields[key] for key in fields if key not in Header.model_fields and key != "type"}
    lab.tell(lab.itrash.sign(Classification, lab.clock.now_s(), **own), "itrash")
    until(lambda: len(answers) == 1, lab.move)
    session.end()
    (message,) = session.proof.topics["/" + topics.BIN_IMAGE.name(bin="itrash")].data
    assert types.deserialize(message, topics.BIN_IMAGE.type).data.tobytes() == picture
