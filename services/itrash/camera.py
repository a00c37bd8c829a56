"""The bin's camera, wherever its pictures come from: the bus, a video device or stream, a folder.

A camera that goes away (unplugged, rebooted, a folder not mounted) is opened again when it is back; until
then `capture` raises CameraError and `problem` explains why.
"""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from rodeo.errors import RodeoError
from rodeo.host.clock import Clock
from rodeo.host.stamps import stamp_s
from rodeo.lab.config import CameraConfig
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.errors import ServiceUnavailable
from rodeo.ros2.node import Node
from rodeo.ros2.types import new
from rodeo.site import topics
from rodeo.text.redaction import redacted
from rodeo.vision.images import MOST_READ_BYTES, picture_of

log = logging.getLogger(__name__)

_REOPEN_S = 1.0
"""Wall time between two attempts to open a camera that is not there."""
_STREAM_TIMEOUT_MS = 5000
_JPEG_QUALITY = 92


class CameraError(RodeoError):
    """The camera was asked and gave no frame."""


class Camera(Protocol):
    """Encoded pictures (JPEG, PNG or WebP) with the site time at which they were taken."""

    def capture(self, after_s: float) -> tuple[float, bytes]:
        """A picture taken at or after site time `after_s`. Raises CameraError."""

    def latest(self) -> bytes | None:
        """The newest picture, None before the first; requests no new one."""

    def problem(self) -> str | None:
        """Why there are no pictures at present; None when nothing is known to be wrong."""

    def close(self) -> None:
        """Let go of the device."""


def open_camera(config: CameraConfig, node: Node, bin_name: str, clock: Clock) -> Camera:
    """The camera that the site file chose."""
    if config.source == "video":
        return VideoCamera(config.address, clock)
    if config.source == "folder":
        return FolderCamera(Path(config.address), clock)
    return BusCamera(node, bin_name)


class BusCamera:
    """A camera on the robot plane: its software trigger, then the frame on its topic."""

    def __init__(self, node: Node, bin_name: str, timeout_s: float = 10.0) -> None:
        self._timeout_s = timeout_s
        self._frame: tuple[float, bytes] | None = None
        self._problem: str | None = None
        self._away = False
        self._arrived = threading.Condition()
        self._trigger = node.client(topics.BIN_CAPTURE.name(bin=bin_name), topics.BIN_CAPTURE.type)
        node.subscription(topics.BIN_IMAGE.name(bin=bin_name), topics.BIN_IMAGE.type, self._on_frame)

    def _on_frame(self, message: Any, _info: MessageInfo) -> None:
        with self._arrived:
            self._frame, self._problem = (stamp_s(message.header.stamp), message.data.tobytes()), None
            self._arrived.notify_all()

    def capture(self, after_s: float) -> tuple[float, bytes]:
        """Waits `timeout_s` wall seconds. Errors of the service call come as they are."""
        try:
            return self._capture(after_s)
        except RodeoError as error:
            with self._arrived:
                self._problem, self._away = str(error), isinstance(error, ServiceUnavailable)
            raise

    def _capture(self, after_s: float) -> tuple[float, bytes]:
        deadline_s = time.monotonic() + self._timeout_s
        answer = self._trigger.call(new("std_srvs/srv/Trigger_Request"), timeout_s=self._timeout_s)
        if not answer.success:
            raise CameraError("the camera refused", reason=answer.message)
        with self._arrived:
            while self._frame is None or self._frame[0] < after_s:
                if not self._arrived.wait(deadline_s - time.monotonic()):
                    raise CameraError("the camera sent no frame", after_s=after_s, timeout_s=self._timeout_s)
            return self._frame

    def latest(self) -> bytes | None:
        with self._arrived:
            return None if self._frame is None else self._frame[1]

    def problem(self) -> str | None:
        """The last capture's failure. A frame ends it; as frames come only when something is shown, so does
        a camera that was away and came back."""
        there = self._trigger.wait_for_server(0.0)
        with self._arrived:
            if self._problem is not None and there and self._away:
                self._problem = None
            self._away = not there
            return self._problem

    def close(self) -> None:
        """The node that carries it is closed by its owner."""


class VideoCamera:
    """A USB device ("0", "/dev/video0") or a stream ("rtsp://...") through OpenCV.

    A thread reads all the time: streams buffer, and a frame that waited is not what is in front of the lens.
    """

    def __init__(self, address: str, clock: Clock, timeout_s: float = 10.0) -> None:
        self._address = address
        self._shown = redacted(address)
        """The address without the password that a stream's may carry."""
        self._clock = clock
        self._timeout_s = timeout_s
        self._frame: tuple[float, np.ndarray] | None = None
        self._problem: str | None = "not opened yet"
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._stop.is_set():
            capture = self._open()
            while not self._stop.is_set():
                image = self._picture(capture)
                if image is None:
                    break
                with self._changed:
                    self._frame, self._problem = (self._clock.now_s(), image), None
                    self._changed.notify_all()
            capture.release()
            if not self._stop.is_set():
                with self._changed:
                    if self._problem is None:
                        log.warning("lost the camera %s", self._shown)
                    self._frame, self._problem = None, f"no frames from {self._shown}"
                self._stop.wait(_REOPEN_S)

    def _open(self) -> cv2.VideoCapture:
        if self._address.isdecimal():
            return cv2.VideoCapture(int(self._address))
        if "://" in self._address:
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _STREAM_TIMEOUT_MS,
                      cv2.CAP_PROP_READ_TIMEOUT_MSEC, _STREAM_TIMEOUT_MS]  # fmt: skip
            return cv2.VideoCapture(self._address, cv2.CAP_FFMPEG, limits)
        return cv2.VideoCapture(self._address)

    def _picture(self, capture: cv2.VideoCapture) -> np.ndarray | None:
        """None when there is none: away, at its end, or not to be decoded."""
        try:
            ok, image = capture.read() if capture.isOpened() else (False, None)
        except cv2.error as error:
            log.warning("the camera %s: %s", self._shown, error.err)
            return None
        return image if ok else None

    def capture(self, after_s: float) -> tuple[float, bytes]:
        deadline_s = time.monotonic() + self._timeout_s
        with self._changed:
            while self._frame is None or self._frame[0] < after_s:
                if not self._changed.wait(max(deadline_s - time.monotonic(), 0.0)):
                    raise CameraError("the camera sent no frame", address=self._shown, reason=self._problem)
            time_s, image = self._frame
        return time_s, _jpeg(image)

    def latest(self) -> bytes | None:
        with self._changed:
            frame = self._frame
        return None if frame is None else _jpeg(frame[1])

    def problem(self) -> str | None:
        with self._changed:
            return self._problem

    def close(self) -> None:
        self._stop.set()
        self._thread.join(timeout=2 * _STREAM_TIMEOUT_MS / 1e3)


class FolderCamera:
    """The pictures of a folder one after another, in the order of their names, from the start again."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._folder = folder
        self._clock = clock
        self._taken = 0
        self._latest: bytes | None = None

    def capture(self, after_s: float) -> tuple[float, bytes]:
        files = self._files()
        if not files:
            raise CameraError("no picture in the folder", folder=str(self._folder))
        path = files[self._taken % len(files)]
        self._taken += 1
        try:
            with path.open("rb") as file:
                data = picture_of(file.read(MOST_READ_BYTES))
        except OSError as error:
            raise CameraError("the picture cannot be read", path=str(path), reason=str(error)) from error
        self._latest = data
        return max(self._clock.now_s(), after_s), data

    def latest(self) -> bytes | None:
        return self._latest

    def problem(self) -> str | None:
        return None if self._files() else f"no picture in {self._folder}"

    def close(self) -> None:
        """Holds nothing."""

    def _files(self) -> list[Path]:
        try:
            return sorted(path for path in self._folder.iterdir() if path.suffix.lower() in _PICTURES)
        except OSError:
            return []  # not mounted: `problem` tells


_PICTURES = frozenset({".jpg", ".jpeg", ".png", ".webp"})


def _jpeg(image_bgr: np.ndarray) -> bytes:
    _, data = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()
