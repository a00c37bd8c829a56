"""The bin's process on a real router; the test plays its sensors, its camera and the robot."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from rodeo import topics, wallets
from rodeo.evidence import Attestation, verify_attestation
from rodeo.ros2 import Node
from rodeo.ros2.types import new
from services.itrash.behaviour import DisposalRecord, Memory
from services.itrash.journal import Journal
from tests.support.site import WAIT_S, RunningSite

RENDERINGS = Path(__file__).parents[1] / "unit" / "services" / "itrash" / "renderings"
TICK_S = 0.01
"""Wall time between two rounds of readings, which are 0.1 s of site time apart."""


class Hardware:
    """The bin's sensors and camera, and the site's clock, ten times faster than real time."""

    def __init__(self, site: RunningSite) -> None:
        config = site.site.bin
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


class Listener:
    """The bin's statements as they come over the bus, each with a valid signature of the bin's device."""

    def __init__(self, site: RunningSite) -> None:
        self._signer = wallets.address(site.site, f"{site.site.bin.name}-device")
        names = {"org": site.site.org, "bin": site.site.bin.name}
        self.classifications = self._listen(site, topics.CLASSIFICATION.name(**names))
        self.disposals = self._listen(site, topics.DISPOSAL.name(**names))

    def _listen(self, site: RunningSite, key: str) -> queue.SimpleQueue[dict[str, Any]]:
        heard: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

        def on_attestation(_key: str, data: dict[str, Any]) -> None:
            attestation = Attestation.model_validate(data)
            assert verify_attestation(attestation) == self._signer
            heard.put(attestation.payload)

        site.bus.subscribe_json(key, on_attestation)
        return heard


@pytest.fixture
def site(running: RunningSite) -> RunningSite:
    running.start("router")
    return running


@pytest.fixture
def hardware(site: RunningSite) -> Iterator[Hardware]:
    hardware = Hardware(site)
    yield hardware
    hardware.close()


def test_a_shown_item_is_classified_and_its_drop_confirmed_on_the_bus_and_over_http(
    site: RunningSite, hardware: Hardware
) -> None:
    listener = Listener(site)
    site.start("itrash")
    hardware.show("plastic_1.jpg")
    classified = listener.classifications.get(timeout=WAIT_S)
    assert (classified["class"], classified["compartment"]) == ("plastic", "yellow")

    hardware.take_away()
    hardware.loads_n["yellow"] = 0.3
    disposed = listener.disposals.get(timeout=WAIT_S)
    assert disposed["correct"]
    assert disposed["classification_seq"] == classified["seq"]
    assert disposed["weight_n"] == pytest.approx(0.3)
    assert disposed["time_s"] > classified["time_s"]

    status = site.bus.query(topics.STATUS.name(org=site.site.org, process="itrash"))
    url = status["details"]["http"]
    assert httpx.get(f"{url}/disposal").json()["payload"] == disposed
    assert httpx.get(f"{url}/classification").json()["payload"] == classified
    assert len(httpx.get(f"{url}/events").json()) == 2
    assert httpx.get(f"{url}/health").status_code == 200
    verdict = httpx.post(f"{url}/classify", content=hardware.photo, timeout=WAIT_S).json()
    assert verdict["class"] == "plastic"


def test_a_drop_while_the_bin_was_killed_is_confirmed_after_its_restart(
    site: RunningSite, hardware: Hardware
) -> None:
    listener = Listener(site)
    site.start("itrash")
    hardware.show("glass_1.jpg")
    classified = listener.classifications.get(timeout=WAIT_S)
    site.kill("itrash")
    hardware.take_away()
    hardware.loads_n["blue"] = 0.5
    site.start("itrash")
    disposed = listener.disposals.get(timeout=WAIT_S)
    assert (disposed["compartment"], disposed["expected_compartment"]) == ("blue", "green")
    assert disposed["classification_seq"] == classified["seq"]
    assert not disposed["correct"]

    state = site.bus.query(topics.BIN_STATE.name(org=site.site.org, bin=site.site.bin.name))
    assert state["classification"]["payload"] == classified
    assert state["disposal"]["payload"] == disposed


def test_what_was_decided_and_not_signed_is_said_once_after_a_restart(
    site: RunningSite, hardware: Hardware
) -> None:
    fell = DisposalRecord(
        bin=site.site.bin.name,
        seq=7,
        classification_seq=None,
        compartment="blue",
        expected_compartment=None,
        weight_n=0.4,
        after_s=1.0,
        time_s=2.0,
        correct=False,
    )
    path = site.site.data_dir / "itrash" / "journal.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    Journal(memory=Memory(disposal_seq=7, unsigned=[fell])).save(path)
    listener = Listener(site)
    site.start("itrash")
    assert listener.disposals.get(timeout=WAIT_S) == fell.payload()
    kept = Journal.load(path)
    assert (kept.memory.unsigned, len(kept.entries)) == ([], 1)


def test_a_frame_without_an_item_is_called_unknown_after_a_second_and_third_look(
    site: RunningSite, hardware: Hardware
) -> None:
    listener = Listener(site)
    site.start("itrash")
    hardware.show("unknown_1.jpg")
    classified = listener.classifications.get(timeout=WAIT_S)
    assert (classified["class"], classified["compartment"]) == ("unknown", "grey")
    assert hardware.photos == 3
