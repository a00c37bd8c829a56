"""Motion capture as a process: a driver's poses over the bus, or a recording's, become signed statements."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from mcap.writer import Writer

from rodeo.bus.messages import Status
from rodeo.bus.session import Bus, zenoh_config
from rodeo.evidence.attestation import Attestation, verify_attestation
from rodeo.host.clock import WallClock
from rodeo.ros2.node import Node
from rodeo.ros2.types import new, serialize
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.motion import track
from rodeo.witness.statement import Motion, parse
from rodeo_testing import answers
from rodeo_testing.assignments import MOCAP, devices
from rodeo_testing.waiting import HANG_S, wait_until
from services.mocap.process import run
from tests.support.clock import serve_time
from tests.support.site import LAB, free_port

PLACES = {"item1": (4.6, 1.2, 0.05), "panther1": (1.4, 1.3, 0.0)}
POSE = "geometry_msgs/msg/PoseStamped"


def pose(body: str, time_ns: int, frame: str = "map") -> Any:
    message = new(POSE)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 10**9)
    at = message.pose.position
    at.x, at.y, at.z = PLACES[body]
    message.pose.orientation.w = 1.0
    return message


class Lab:
    """Router and bridge of a site on which motion capture is real; `hear` collects what it says."""

    def __init__(self, folder: Path, lines: str) -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        path = folder / "site.toml"
        path.write_text(
            f'extends = "{LAB}"\ndata_dir = "data"\nclock.source = "wall"\n'
            f'bus.router = "{endpoint}"\nbus.open = true\n{lines}'
        )
        self.site = Site.load(path)
        self._router = zenoh.open(zenoh_config("router", listen=[endpoint]))
        self.bus = Bus.open(endpoint, timeout_s=HANG_S)
        org = self.site.org
        self.bus.serve(topics.STATE.name(org=org, what="chain"), lambda _: answers.chain())
        known = [one.model_dump() for one in devices()]
        self.bus.serve(topics.STATE.name(org=org, what="devices"), lambda _: {"devices": known})
        serve_time(self.bus, org)
        self.statements: list[Attestation] = []
        self.status: Status | None = None
        self.bus.subscribe_json(
            topics.WITNESS_STATEMENT.name(org=org, device="mocap"),
            lambda _, data: self.statements.append(Attestation.model_validate(data)),
        )
        self.bus.subscribe_json(topics.STATUS.name(org=org, process="mocap"), self._on_status)
        self.node = Node(self.bus.session, "driver", "", 0, WallClock())
        self.shown: list[Any] = []
        name = topics.MOCAP_POSE.name(body="item1")
        self.node.subscription(name, POSE, lambda message, _: self.shown.append(message))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=run, args=(self.site, self._stop))
        self._thread.start()

    def _on_status(self, _key: str, data: dict[str, Any]) -> None:
        self.status = Status.model_validate(data)

    def reason(self) -> str:
        return "" if self.status is None else self.status.reason

    def motion(self) -> list[Motion]:
        said = [parse(one.payload) for one in list(self.statements)]
        return [one for one in said if isinstance(one, Motion)]

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.node.close()
        self.bus.close()
        self._router.close()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("RODEO_KEY_MOCAP_DEVICE", "0x" + bytes(MOCAP.key).hex())
    yield tmp_path


def assert_signed(lab: Lab, inputs: str) -> None:
    """Both bodies are where they are, in statements that motion capture's key signed."""
    wait_until(lambda: lab.shown and lab.motion(), lab.reason)
    assert {verify_attestation(one) for one in lab.statements} == {MOCAP.address}
    assert {one.inputs for one in lab.motion()} == {inputs}
    for body, place_m in PLACES.items():
        wait_until(lambda body=body: track(lab.motion(), body), lab.reason)  # type: ignore[misc]
        seen = track(lab.motion(), body)
        assert seen is not None and seen.position_m[-1] == pytest.approx(place_m, abs=1e-3)
    at = lab.shown[-1].pose.position
    assert (at.x, at.y, at.z) == pytest.approx(PLACES["item1"])


def test_a_drivers_poses_are_signed_and_what_is_wrong_with_it_is_said(folder: Path) -> None:
    lab = Lab(folder, 'mocap = { source = "ros2", address = "vrpn/{body}/pose" }\n')
    publishers = {body: lab.node.publisher(f"vrpn/{body}/pose", POSE) for body in PLACES}
    off_ns, frame, quiet = 0, "map", threading.Event()
    done = threading.Event()

    def publish() -> None:
        clock = WallClock()
        while not done.wait(0.02):
            for body, publisher in publishers.items():
                if not quiet.is_set():
                    publisher.publish(pose(body, clock.now_ns() + off_ns, frame))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        assert_signed(lab, "open_bus")
        wait_until(lambda: lab.status is not None and lab.status.ready, lab.reason)
        off_ns = 1_500_000_000
        wait_until(lambda: "ros2 stamps its frames +1.5 s off the site's time" in lab.reason(), lab.reason)
        off_ns, frame = 0, "optitrack"
        wait_until(lambda: "its poses are in the frame 'optitrack', not 'map'" in lab.reason(), lab.reason)
        frame = "map"
        wait_until(lambda: lab.status is not None and lab.status.ready, lab.reason)
        quiet.set()
        wait_until(lambda: "no frames from ros2 at vrpn/{body}/pose" in lab.reason(), lab.reason)
    finally:
        done.set()
        thread.join()
        lab.close()


def test_a_recording_is_played_and_signed_under_its_own_names(folder: Path) -> None:
    path = folder / "poses.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(POSE, "ros2msg", b"")
        names = {"item1": "Can 1", "panther1": "panther1"}
        channels = {
            body: writer.register_channel(f"/mocap/{name}/pose", "cdr", schema)
            for body, name in names.items()
        }
        for at_ns in range(10**9, 2 * 10**9, 20_000_000):  # a clock of its own
            for body, channel in channels.items():
                writer.add_message(channel, at_ns, bytes(serialize(pose(body, at_ns))), at_ns)
        writer.finish()
    lab = Lab(
        folder,
        'mocap = { source = "recorded", address = "poses.mcap", settings = { repeat = true }, '
        'bodies = { item1 = "Can 1" } }\n',
    )
    try:
        assert_signed(lab, "sensor")
    finally:
        lab.close()
