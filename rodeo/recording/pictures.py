"""Asks bins for the pictures that it classified: a recording holds what a bin signed the hash of."""

from __future__ import annotations

import base64
import binascii
import logging
import threading
from collections import deque
from collections.abc import Callable
from hashlib import sha256

import numpy as np

from rodeo import topics
from rodeo.bus import Bus
from rodeo.errors import BusError, RemoteError
from rodeo.ros2 import types
from rodeo.stamps import set_stamp
from rodeo.witness import Classification
from rodeo.witness.statement import Look

log = logging.getLogger(__name__)

_RETRY_WALL_S = 1.0
_ANSWER_WALL_S = 5.0
_MOST = 30
"""Of one recording: a robot shows its item a few times, and each time a few pictures are taken."""
_MAX_BYTES = 8 << 20
"""Of one picture, as the bin reads them."""

Write = Callable[[str, bytes, int], None]
"""Gets the bin's name, a CompressedImage as CDR and the time of the picture in ns."""


class PictureFetcher:
    """Fetches in a thread of its own what it is told of, and hands it to `write`."""

    def __init__(self, bus: Bus, org: str, write: Write) -> None:
        self._bus = bus
        self._org = org
        self._write = write
        self._wanted: deque[tuple[str, Look]] = deque()
        """The bin's name and the picture."""
        self._asked: set[str] = set()
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._fetch_all, name="pictures", daemon=True)
        self._thread.start()

    def want(self, classification: Classification) -> None:
        """All pictures that were combined. The last one first: without it there is no classification."""
        with self._changed:
            for look in reversed(classification.looks):
                if look.image_sha256 in self._asked or len(self._asked) >= _MOST:
                    continue
                self._asked.add(look.image_sha256)
                self._wanted.append((classification.device, look))
            self._changed.notify_all()

    def wait(self, timeout_s: float) -> bool:
        """Until all that is wanted was written; False when `timeout_s` of wall time passed before."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._wanted, timeout_s)

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(_ANSWER_WALL_S + _RETRY_WALL_S)

    def _fetch_all(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted or self._closed)
                if self._closed:
                    return
                bin_name, look = self._wanted[0]
            picture = self._fetch(bin_name, look.image_sha256)
            if picture is not None:
                time_ns = round(look.taken_s * 1e9)
                self._write(bin_name, _message(picture, time_ns), time_ns)
            with self._changed:
                if picture is not None:
                    self._wanted.popleft()
                else:
                    self._wanted.rotate(-1)
                    self._changed.wait_for(lambda: self._closed, _RETRY_WALL_S)
                self._changed.notify_all()

    def _fetch(self, bin_name: str, name: str) -> bytes | None:
        """The bin's picture with this hash, whoever answers; None when nobody has it now."""
        try:
            answers = self._bus.query_all(
                topics.BIN_PICTURE.name(org=self._org, bin=bin_name),
                parameters={"sha256": name},
                timeout_s=_ANSWER_WALL_S,
                most=4,
            )
        except (BusError, RemoteError) as error:
            log.info("cannot ask the bin for a picture: %s", error)
            return None
        for answer in answers:
            try:
                data = base64.b64decode(str(answer.get("data_base64", "")), validate=True)
            except (binascii.Error, ValueError) as error:
                log.info("ignored an invalid picture: %s", error)
                continue
            if len(data) <= _MAX_BYTES and "0x" + sha256(data).hexdigest() == name:
                return data
        log.info("no process has the picture %s", name)
        return None


def _message(picture: bytes, time_ns: int) -> bytes:
    """A sensor_msgs/msg/CompressedImage."""
    message = types.new(topics.BIN_IMAGE.type, format="png" if picture[:4] == b"\x89PNG" else "jpeg")
    set_stamp(message, time_ns)
    message.data = np.frombuffer(picture, np.uint8)
    return types.serialize(message)
