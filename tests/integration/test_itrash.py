"""The bin's process on a real router; the test plays its sensors, its camera and the robot."""

from __future__ import annotations

import base64
import math
import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from eth_account import Account
from typer.testing import CliRunner

from rodeo.errors import RemoteError
from rodeo.evidence.attestation import Attestation, attest, verify_attestation
from rodeo.ros2.node import Node
from rodeo.ros2.types import new
from rodeo.signing import keystores
from rodeo.site import topics
from rodeo.vision.classification import model_sha256, thresholds_sha256
from rodeo.witness.chain import WitnessChain
from rodeo.witness.correction import Correction
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal as WitnessJournal
from rodeo.witness.statement import Claimant, Classification, Drop, Presentation, Scope, parse
from rodeo_cli import app
from rodeo_testing import answers
from rodeo_testing.recordings import RENDERINGS
from rodeo_testing.waiting import HANG_S, wait_until
from services.itrash.behaviour import DropRecord, Memory
from services.itrash.journal import Journal
from tests.support.site import RunningSite
from training.allowed import Allowed

TICK_S = 0.01
"""Wall time between two rounds of readings, which are 0.1 s of site time apart."""


class Hardware:
    """The bin's sensors and camera, and the site's clock, ten times faster than real time."""

    def __init__(self, site: RunningSite) -> None:
        config = site.site.bins[0]
        self.range_m = math.inf
        self.loads_n = dict.fromkeys(config.compartments, 0.0)
        self.photo = b""
        self.photos = 0
        self._time_ns = 1_800_000_000_000_000_000
        node = Node(site.bus.session, "hardware", "", site.site.bus.domain_id, self)
        presence, load, image = topics.BIN_PRESENCE, topics.BIN_LOAD, topics.BIN_IMAGE
        self._clock = node.publisher("clock", topics.CLOCK.type)
        self._presence = node.publisher(presence.name(bin=config.name), presence.type)
        self._loads = {
            name: node.publisher(load.name(bin=config.name, compartment=name), load.type)
            for name in config.compartments
        }
        self._image = node.publisher(image.name(bin=config.name), image.type)
        node.service(topics.BIN_CAPTURE.name(bin=config.name), topics.BIN_CAPTURE.type, self._capture)
        self._node = node
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def now_ns(self) -> int:
        return self._time_ns

    def _header(self) -> Any:
        sec, nanosec = divmod(self._time_ns, 1_000_000_000)
        stamp = new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return new("std_msgs/msg/Header", stamp=stamp)

    def _run(self) -> None:
        while not self._stop.wait(TICK_S):
            self._time_ns += 100_000_000
            self._clock.publish(new("rosgraph_msgs/msg/Clock", clock=self._header().stamp))
            self._presence.publish(
                new("sensor_msgs/msg/Range", header=self._header(), range=self.range_m, max_range=2.0)
            )
            for name, publisher in self._loads.items():
                force = new("geometry_msgs/msg/Vector3", z=self.loads_n[name])
                wrench = new("geometry_msgs/msg/Wrench", force=force)
                publisher.publish(
                    new("geometry_msgs/msg/WrenchStamped", header=self._header(), wrench=wrench)
                )

    def _capture(self, _request: Any) -> Any:
        self.photos += 1
        data = np.frombuffer(self.photo, np.uint8)
        self._image.publish(
            new("sensor_msgs/msg/CompressedImage", header=self._header(), format="jpeg", data=data)
        )
        return new("std_srvs/srv/Trigger_Response", success=True)

    def show(self, rendering: str) -> None:
        self.photo = (RENDERINGS / rendering).read_bytes()
        self.range_m = 0.34

    def take_away(self) -> None:
        self.range_m = math.inf

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._node.close()


SCOPE = Scope(chain_id=31337, task_manager="0x" + "12" * 20, organization="0x" + "34" * 20)
ROBOT, AUDITOR = Account.create(), Account.create()


def bin_key(site: RunningSite) -> str:
    return keystores.address(site.site, f"{site.site.bins[0].name}-device")


class Office:
    """Answers as the bridge does: for which organization one signs, and which devices there are."""

    def __init__(self, site: RunningSite) -> None:
        own = {"address": bin_key(site), "role": "bin", "name": site.site.bins[0].name}
        robot = {"address": ROBOT.address, "role": "robot", "name": "panther1"}
        registered = {"owner": "0x" + "56" * 20, "registered": 0.0, "revoked": None, "revoked_because": None}
        contracts = answers.CONTRACTS | {
            "TaskManager": SCOPE.task_manager,
            "Organization": SCOPE.organization,
        }
        auditors = {"anna": AUDITOR.address, "organization": keystores.address(site.site, "organization")}
        listed = {"AUDITOR_ROLE": [{"address": one, "name": name} for name, one in auditors.items()]}
        answered = {
            "organization": answers.organization() | {"roles": listed},
            "chain": answers.chain(chain_id=SCOPE.chain_id, contracts=contracts),
            "devices": {"devices": [own | registered, robot | registered]},
        }
        for what, answer in answered.items():
            site.bus.serve(topics.STATE.name(org=site.site.org, what=what), lambda _request, one=answer: one)


class Listener:
    """The bin's statements as they come over the bus, each with a valid signature of the bin's device."""

    def __init__(self, site: RunningSite) -> None:
        self._signer = bin_key(site)
        self.classifications: queue.SimpleQueue[Classification] = queue.SimpleQueue()
        self.drops: queue.SimpleQueue[Drop] = queue.SimpleQueue()
        key = topics.WITNESS_STATEMENT.name(org=site.site.org, device=site.site.bins[0].name)
        site.bus.subscribe_json(key, self._on_attestation)

    def _on_attestation(self, _key: str, data: dict[str, Any]) -> None:
        attestation = Attestation.model_validate(data)
        assert verify_attestation(attestation) == self._signer
        statement = parse(attestation.payload)
        if isinstance(statement, Classification):
            self.classifications.put(statement)
        elif isinstance(statement, Drop):
            self.drops.put(statement)


@pytest.fixture
def site(running: RunningSite) -> RunningSite:
    running.start("router")
    Office(running)
    return running


@pytest.fixture
def hardware(site: RunningSite) -> Iterator[Hardware]:
    hardware = Hardware(site)
    yield hardware
    hardware.close()


def test_a_shown_item_is_classified_and_its_drop_confirmed_on_the_bus_and_over_http(
    site: RunningSite, hardware: Hardware, tmp_path: Path
) -> None:
    listener = Listener(site)
    site.start("itrash")
    hardware.show("plastic_1.jpg")
    classified = listener.classifications.get(timeout=HANG_S)
    assert (classified.item_class, classified.compartment) == ("plastic", "yellow")
    assert (classified.chain_id, classified.organization) == (SCOPE.chain_id, SCOPE.organization)
    assert (classified.model_sha256, classified.thresholds_sha256) == (model_sha256(), thresholds_sha256())

    hardware.take_away()
    hardware.loads_n["yellow"] = 0.3
    dropped = listener.drops.get(timeout=HANG_S)
    assert dropped.correct
    assert dropped.classification == classified.number
    assert dropped.weight_n == pytest.approx(0.3)
    assert dropped.settled_s > classified.shown_s
    assert dropped.seq > classified.seq

    status = site.bus.query(topics.STATUS.name(org=site.site.org, process="itrash"))
    url = status["details"]["http"]
    assert parse(httpx.get(f"{url}/disposal", timeout=HANG_S).json()["payload"]) == dropped
    assert parse(httpx.get(f"{url}/classification", timeout=HANG_S).json()["payload"]) == classified
    told = [one["kind"] for one in httpx.get(f"{url}/events", timeout=HANG_S).json()]
    assert [one for one in told if one != "watch"] == ["disposal", "classification"]
    assert httpx.get(f"{url}/readyz", timeout=HANG_S).status_code == 200
    verdict = httpx.post(f"{url}/classify", content=hardware.photo, timeout=HANG_S).json()
    assert verdict["class"] == "plastic"

    key = topics.BIN_PICTURE.name(org=site.site.org, bin=site.site.bins[0].name)
    picture = site.bus.query(key, parameters={"sha256": classified.image_sha256})
    assert base64.b64decode(picture["data_base64"]) == hardware.photo
    with pytest.raises(RemoteError) as refusal:
        site.bus.query(key, parameters={"sha256": "../journal.json"})
    assert refusal.value.code == "no_such_picture"

    corrections(site, classified, hardware.photo, tmp_path)

    key = topics.WITNESS_STATEMENTS.name(org=site.site.org, device=site.site.bins[0].name)
    again = site.bus.query(key, parameters={"after": dropped.seq - 1})["statements"]
    # What it says some seconds later, that it was there, may have come by now.
    assert [one for one in (parse(one["payload"]) for one in again) if isinstance(one, Drop)] == [dropped]


def corrections(site: RunningSite, classified: Classification, photo: bytes, tmp_path: Path) -> None:
    """What an auditor says of the item is kept and counted; what nobody may say is refused."""
    key = topics.BIN_CORRECTIONS.name(org=site.site.org, bin=site.site.bins[0].name)
    before = site.bus.query(key)
    assert before["people"] == []
    assert before["pictures"][0] == {
        "image_sha256": classified.image_sha256,
        "class": classified.item_class,
        "shown_s": classified.shown_s,
        "corrections": {},
    }
    said = Correction(
        **SCOPE.model_dump(),
        bin=site.site.bins[0].name,
        image_sha256=classified.image_sha256,
        item_class="glass",
    )
    right = attest(said.model_dump(), AUDITOR)

    def refused(signed: Attestation | dict[str, Any]) -> str:
        with pytest.raises(RemoteError) as refusal:
            site.bus.query(key, signed)
        return refusal.value.code

    def changed(**changes: Any) -> Attestation:
        return attest(said.model_dump() | changes, AUDITOR)

    assert refused(said.model_dump()) == "invalid_request"  # nobody signed it
    assert refused(right.model_copy(update={"payload": changed(**{"class": "metal"}).payload})) == (
        "bad_attestation"
    )
    assert refused(attest(said.model_dump(), ROBOT)) == "not_an_auditor"
    assert refused(changed(organization="0x" + "77" * 20)) == "for_another_bin"
    assert refused(changed(bin="another")) == "for_another_bin"
    assert refused(changed(image_sha256="0x" + "77" * 32)) == "no_such_picture"
    assert refused(changed(**{"class": "gold"})) == "no_such_class"
    found = site.bus.query(key, right)
    assert found["people"] == [{"address": AUDITOR.address.lower(), "name": "anna", "items": 1, "right": 0}]
    assert refused(changed(**{"class": "metal"})) == "already_corrected"
    folder = site.site.data_dir / "itrash" / "corrections"
    assert (folder / classified.image_sha256).read_bytes() == photo
    looked = ["bin", "pictures", "--save", str(tmp_path), "--site", str(site.path)]
    pictured = CliRunner().invoke(app, looked).output.splitlines()[1]
    assert "anna: glass" in pictured and pictured.endswith(classified.image_sha256)
    assert (tmp_path / f"{classified.image_sha256}.jpg").read_bytes() == photo
    listing = CliRunner().invoke(app, ["bin", "corrections", "--site", str(site.path)])
    assert "itrash was right in 0 of 1 (0%)" in listing.output
    confirmed = CliRunner().invoke(app, ["bin", "correct", "plastic", "--site", str(site.path)])
    assert "itrash was right in 1 of 2 (50%)" in confirmed.output
    allowed = Allowed.at(site.site)
    assert allowed.scope == SCOPE and AUDITOR.address.lower() in allowed.auditors
    assert ROBOT.address.lower() not in allowed.auditors
    own = (site.site.bins[0].name, classified.shown_s)
    assert allowed.speaks_for(bin_key(site), *own) and not allowed.speaks_for(ROBOT.address, *own)


def test_a_robot_that_presents_itself_is_named_and_a_stranger_is_not(
    site: RunningSite, hardware: Hardware, tmp_path: Path
) -> None:
    listener = Listener(site)
    site.start("itrash")
    recording = "0x" + "ab" * 32
    for number, account in enumerate((Account.create(), ROBOT)):
        journal = WitnessJournal(tmp_path / f"journal-{number}")
        chain = WitnessChain("panther1", account, SCOPE, "closed_bus", journal, HeadBook())
        presented = chain.sign(
            Presentation, 5.0, bin=site.site.bins[0].name, recording=recording, task_id=7, attempt=1
        )
        site.bus.put_json(topics.WITNESS_STATEMENT.name(org=site.site.org, device="panther1"), presented)
    state_key = topics.BIN_STATE.name(org=site.site.org, bin=site.site.bins[0].name)
    presented = wait_until(lambda: site.bus.query(state_key)["presented"], lambda: site.log("itrash"))
    assert presented == ["panther1"]
    hardware.show("plastic_1.jpg")
    classified = listener.classifications.get(timeout=HANG_S)
    assert classified.claimants == (
        Claimant(device="panther1", address=ROBOT.address, recording=recording, task_id=7, attempt=1),
    )


def test_a_drop_while_the_bin_was_killed_is_confirmed_after_its_restart(
    site: RunningSite, hardware: Hardware
) -> None:
    listener = Listener(site)
    site.start("itrash")
    hardware.show("glass_1.jpg")
    classified = listener.classifications.get(timeout=HANG_S)
    site.kill("itrash")
    hardware.take_away()
    hardware.loads_n["blue"] = 0.5
    site.start("itrash")
    dropped = listener.drops.get(timeout=HANG_S)
    assert (dropped.compartment, dropped.expected_compartment) == ("blue", "green")
    assert dropped.classification == classified.number
    assert not dropped.correct
    assert dropped.seq == classified.seq + 1

    state = site.bus.query(topics.BIN_STATE.name(org=site.site.org, bin=site.site.bins[0].name))
    assert parse(state["classification"]["payload"]) == classified
    assert parse(state["disposal"]["payload"]) == dropped


def test_what_was_decided_and_not_signed_is_said_once_after_a_restart(
    site: RunningSite, hardware: Hardware
) -> None:
    fell = DropRecord(
        number=7,
        classification=None,
        compartment="blue",
        expected_compartment=None,
        weight_n=0.4,
        after_s=1.0,
        settled_s=2.0,
        correct=False,
    )
    path = site.site.data_dir / "itrash" / "journal.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    Journal(memory=Memory(drops=7, unsigned=[fell])).save(path)
    listener = Listener(site)
    site.start("itrash")
    said = listener.drops.get(timeout=HANG_S)
    assert said.model_dump(include=set(DropRecord.model_fields)) == fell.model_dump()
    kept = Journal.load(path)
    assert (kept.memory.unsigned, len(kept.entries)) == ([], 1)


def test_a_frame_without_an_item_is_called_unknown_after_a_second_and_third_look(
    site: RunningSite, hardware: Hardware
) -> None:
    listener = Listener(site)
    site.start("itrash")
    hardware.show("unknown_1.jpg")
    classified = listener.classifications.get(timeout=HANG_S)
    assert (classified.item_class, classified.compartment) == ("unknown", "grey")
    assert hardware.photos == 3
