"""One photo on demand: the camera's software trigger, then the frame on its topic."""

from __future__ import annotations

import threading
import time
from typing import Any

from rodeo import topics
from rodeo.errors import RodeoError
from rodeo.ros2 import MessageInfo, Node
from rodeo.ros2.types import new


class CameraError(RodeoError):
    """The camera was asked and gave no frame."""


def stamp_s(message: Any) -> float:
    """The header's stamp in s of site time."""
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


class BusCamera:
    """The bin's camera over the bus."""

    def __init__(self, node: Node, bin_name: str, timeout_s: float = 10.0) -> None:
        self._timeout_s = timeout_s
        self._frame: tuple[float, bytes] | None = None
        self._arrived = threading.Condition()
        self._trigger = node.client(topics.BIN_CAPTURE.name(bin=bin_name), topics.BIN_CAPTURE.type)
        node.subscription(topics.BIN_IMAGE.name(bin=bin_name), topics.BIN_IMAGE.type, self._on_frame)

    def _on_frame(self, message: Any, _info: MessageInfo) -> None:
        with self._arrived:
            self._frame = stamp_s(message), message.data.tobytes()
            self._arrived.notify_all()

    def capture(self, after_s: float) -> tuple[float, bytes]:
        """A frame taken at or after site time `after_s`: its stamp and its encoded bytes.

        Waits `timeout_s` wall seconds. Raises CameraError; errors of the service call as they come.
        """
        deadline_s = time.monotonic() + self._timeout_s
        answer = self._trigger.call(new("std_srvs/srv/Trigger_Request"), timeout_s=self._timeout_s)
        if not answer.success:
            raise CameraError("the camera refused", reason=answer.message)
        with self._arrived:
            while self._frame is None or self._frame[0] < after_s:
                if not self._arrived.wait(deadline_s - time.monotonic()):
                    raise CameraError("the camera sent no frame", after_s=after_s, timeout_s=self._timeout_s)
            return self._frame
