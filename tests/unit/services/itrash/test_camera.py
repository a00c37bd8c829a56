"""Cameras other than the bus: a video device that is unplugged and comes back, a folder of pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from rodeo.lab.config import CameraConfig
from rodeo.ros2.errors import ServiceUnavailable
from rodeo.ros2.node import Node
from rodeo.ros2.types import new
from rodeo.site import topics
from rodeo.vision.images import decode_image
from rodeo_testing.waiting import wait_until
from services.itrash.camera import BusCamera, CameraError, FolderCamera, VideoCamera
from tests.support.nodes import make_node as make_node
from tests.support.nodes import router_port as router_port


class StillClock:
    """Site time as the test sets it."""

    def __init__(self) -> None:
        self.time_s = 100.0

    def now_s(self) -> float:
        return self.time_s

    def now_ns(self) -> int:
        return int(self.time_s * 1e9)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """A short film, which OpenCV opens as it opens a device; its end is an unplug."""
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (64, 48))
    for _ in range(5):
        writer.write(np.full((48, 64, 3), 200, np.uint8))
    writer.release()
    return path


def test_a_video_camera_gives_pictures_and_is_opened_again_after_an_unplug(video: Path) -> None:
    away = video.with_suffix(".gone")
    camera = VideoCamera(str(video), StillClock())
    try:
        _, data = camera.capture(100.0)
        assert decode_image(data).shape == (48, 64, 3)
        video.rename(away)
        wait_until(lambda: camera.problem() is not None and camera.latest() is None)
        away.rename(video)
        _, data = camera.capture(100.0)
        assert decode_image(data).shape == (48, 64, 3)
    finally:
        camera.close()


def test_a_frame_from_before_the_question_is_no_answer(video: Path) -> None:
    clock = StillClock()
    camera = VideoCamera(str(video), clock, timeout_s=0.1)
    try:
        with pytest.raises(CameraError):
            camera.capture(200.0)
        clock.time_s = 201.0
        wait_until(lambda: _captures(camera, 200.0))
    finally:
        camera.close()


def _captures(camera: VideoCamera, after_s: float) -> bool:
    try:
        return camera.capture(after_s)[0] == 201.0
    except CameraError:
        return False


def test_a_camera_that_is_not_there_says_so(tmp_path: Path) -> None:
    camera = VideoCamera(str(tmp_path / "none.avi"), StillClock(), timeout_s=0.1)
    try:
        with pytest.raises(CameraError) as failed:
            camera.capture(0.0)
        assert "none.avi" in str(failed.value)
        assert camera.problem() is not None
    finally:
        camera.close()


def test_the_password_of_a_stream_is_not_told() -> None:
    camera = VideoCamera("rtsp://bin:secret@127.0.0.1:9/stream", StillClock(), timeout_s=0.1)
    try:
        with pytest.raises(CameraError) as failed:
            camera.capture(0.0)
        assert "rtsp://127.0.0.1:9/stream" in str(failed.value)
        assert "secret" not in str(failed.value)
    finally:
        camera.close()


def test_a_camera_on_the_bus_that_was_away_is_well_again_once_it_is_back(
    make_node: Callable[[str], Node],
) -> None:
    camera = BusCamera(make_node("bin"), "itrash")
    assert camera.problem() is None
    with pytest.raises(ServiceUnavailable):
        camera.capture(0.0)
    assert camera.problem() is not None
    _serve_camera(make_node("sim"), success=True)
    wait_until(lambda: camera.problem() is None)


def test_a_camera_on_the_bus_that_sends_nothing_is_not_well_for_being_there(
    make_node: Callable[[str], Node],
) -> None:
    sim = make_node("sim")
    _serve_camera(sim, success=False)
    camera = BusCamera(make_node("bin"), "itrash")
    wait_until(lambda: _refused(camera))
    assert "refused" in str(camera.problem())
    image = sim.publisher(topics.BIN_IMAGE.name(bin="itrash"), topics.BIN_IMAGE.type)
    frame = new(topics.BIN_IMAGE.type, data=np.frombuffer(b"a frame", np.uint8))

    def well() -> bool:
        image.publish(frame, 0)
        return camera.problem() is None

    wait_until(well)
    assert camera.latest() == b"a frame"


def _serve_camera(node: Node, success: bool) -> None:
    response = new("std_srvs/srv/Trigger_Response", success=success, message="out of film")
    node.service(topics.BIN_CAPTURE.name(bin="itrash"), topics.BIN_CAPTURE.type, lambda _request: response)


def _refused(camera: BusCamera) -> bool:
    """False while the service is not known yet."""
    try:
        camera.capture(0.0)
    except ServiceUnavailable:
        return False
    except CameraError as error:
        return "refused" in str(error)
    return False


def test_a_folder_gives_its_pictures_in_turn_and_survives_being_unmounted(tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    camera = FolderCamera(folder, StillClock())
    assert camera.problem() is not None
    with pytest.raises(CameraError):
        camera.capture(0.0)
    folder.mkdir()
    for name in ("b.jpg", "a.PNG", "notes.txt"):
        (folder / name).write_bytes(name.encode())
    assert camera.problem() is None
    assert [camera.capture(0.0) for _ in range(3)] == [
        (100.0, b"a.PNG"), (100.0, b"b.jpg"), (100.0, b"a.PNG")
    ]  # fmt: skip
    assert camera.latest() == b"a.PNG"


def test_the_site_file_must_say_where_a_camera_is() -> None:
    assert CameraConfig().source == "bus"
    with pytest.raises(ValidationError):
        CameraConfig(source="video")
    with pytest.raises(ValidationError):
        CameraConfig(source="bus", address="0")
