"""The stand-ins of a real lab's devices, read by what is neither theirs nor a client's of this project."""

from __future__ import annotations

import socket
import struct
from typing import Any

import cv2
import numpy as np
import pytest
import zenoh
from natnet.data_descriptions import DataDescriptions
from natnet.data_frame import DataFrame
from natnet.packet_buffer import PacketBuffer
from natnet.server_info import ServerInfo
from natnet.version import Version

from rodeo.bus.session import zenoh_config
from rodeo_testing.waiting import wait_until
from tests.reallab.motive import CONNECT, FRAME, MODELS, REQUEST_MODELS, SERVER_INFO, Motive
from tests.reallab.stock_dds import StockDds
from tests.reallab.things import Things
from tests.reallab.video import Video
from tests.support.site import free_port

WAIT_S = 60.0
PLACE_M, TURN = np.array([1.5, 2.0, 0.25]), np.array([0.8, 0.36, 0.48, 0.0])


def asked(port: int, *kinds: int) -> dict[int, bytes]:
    """The first packet of each kind that a client gets which asks for these."""
    found: dict[int, bytes] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(WAIT_S)
        for kind in kinds:
            client.sendto(struct.pack("<HH", kind, 0), ("127.0.0.1", port))
        while not {SERVER_INFO, MODELS, FRAME} <= set(found):
            packet = client.recv(65_535)
            kind, size = struct.unpack_from("<HH", packet)
            assert len(packet) == 4 + size
            found.setdefault(kind, packet[4:])
    return found


@pytest.mark.parametrize("protocol", [(3, 0), (4, 1)])
def test_motives_packets_are_what_another_client_reads(protocol: tuple[int, int]) -> None:
    port, version = free_port(), Version(*protocol)
    Motive(port, ["arthur", "item1"], lambda: {"arthur": (PLACE_M, TURN), "item1": None}, protocol)
    packets = asked(port, CONNECT, REQUEST_MODELS)
    server = ServerInfo.read_from_buffer(PacketBuffer(packets[SERVER_INFO]), version)
    assert (server.application_name, server.nat_net_protocol_version) == ("Motive", version)
    models = DataDescriptions.read_from_buffer(PacketBuffer(packets[MODELS]), version)
    assert [(one.name, one.id_num) for one in models.rigid_bodies] == [("arthur", 1), ("item1", 2)]
    frame = DataFrame.read_from_buffer(PacketBuffer(packets[FRAME]), version)
    seen, lost = frame.rigid_bodies
    assert (seen.tracking_valid, lost.tracking_valid) == (True, False)
    # y is up there.
    assert seen.pos == pytest.approx((1.5, 0.25, -2.0))
    assert seen.rot == pytest.approx((0.36, 0.0, -0.48, 0.8))
    assert frame.suffix.stamp_data_received < frame.suffix.stamp_transmit


def test_a_stream_of_pictures_is_what_ffmpeg_reads() -> None:
    grey = np.full((48, 64, 3), 90, np.uint8)
    port, jpeg = free_port(), cv2.imencode(".jpg", grey)[1].tobytes()
    Video(port, lambda: jpeg)
    capture = cv2.VideoCapture(f"http://127.0.0.1:{port}/", cv2.CAP_FFMPEG)
    try:
        for _ in range(2):
            ok, image = capture.read()
            assert ok and image.shape == grey.shape and abs(int(image.mean()) - 90) < 3
    finally:
        capture.release()


def test_a_robot_with_a_stock_dds_looks_as_its_bridge_shows_it() -> None:
    """Bytes and keys derived from the bridge's description by hand."""
    endpoint, name, header = f"tcp/127.0.0.1:{free_port()}", "arthur/emergency_stop", b"\x00\x01\x00\x00"
    with zenoh.open(zenoh_config("router", listen=[endpoint])) as relay:
        robot = StockDds(endpoint, {})
        with robot.session:
            robot.server(
                name,
                "std_srvs/srv/SetBool",
                ("bool data\n", "bool success\nstring message\n"),
                lambda asked: robot.new(
                    "std_srvs/srv/msg/SetBool_Response", success=asked.data, message="ok"
                ),
            )
            (reply,) = wait_until(lambda: list(relay.get(name, payload=header + b"\x01", timeout=WAIT_S)))
            assert reply.ok is not None and reply.ok.attachment is None
            assert reply.ok.payload.to_bytes() == header + b"\x01\0\0\0" + struct.pack("<I", 3) + b"ok\0"
            (token,) = wait_until(lambda: list(relay.liveliness().get("@/*/@ros2_lv/**", timeout=WAIT_S)))
            assert token.ok is not None
            shown = "SS/arthur§emergency_stop/std_srvs§srv§SetBool"
            assert str(token.ok.key_expr) == f"@/{robot.session.info.zid()}/@ros2_lv/{shown}"


TOLD: dict[str, Any] = {
    "items": {
        "can": {
            "x_m": 2.0, "y_m": 1.0, "yaw_rad": 0.3, "radius_m": 0.03, "half_height_m": 0.05, "mass_kg": 0.1,
        }
    },
    "bin": {
        "yaw_rad": 0.0,
        "camera_m": [-0.34, 0.0, 0.7],
        "show_m": [0.0, 0.0, 0.7],
        "compartments": {
            "left": {"x_m": 0.0, "y_m": 0.12, "rim_m": 0.4, "half_m": [0.1, 0.1]},
            "right": {"x_m": 0.0, "y_m": -0.12, "rim_m": 0.4, "half_m": [0.1, 0.1]},
        },
    },
}  # fmt: skip


def test_what_falls_into_a_compartment_weighs_there_what_it_weighs() -> None:
    things, upright = Things(TOLD), np.array([1.0, 0.0, 0.0, 0.0])
    things.pass_until(0.0)
    assert things.weights_n() == {"left": 0.0, "right": 0.0} and things.shown() is None
    things.carry("can", np.array([0.0, 0.0, 0.7]), upright)
    things.pass_until(0.5)
    assert things.shown() == "can" and things.nearest_m() == pytest.approx(0.31, abs=0.001)
    things.let_go("can", np.array([0.0, -0.12, 0.5]), upright)
    things.pass_until(3.0)
    assert things.weights_n() == {"left": 0.0, "right": pytest.approx(0.1 * 9.81, rel=0.01)}
    things.lay("can")
    things.pass_until(3.5)
    assert things.pose("can")[0] == pytest.approx([2.0, 1.0, 0.05], abs=0.002)
