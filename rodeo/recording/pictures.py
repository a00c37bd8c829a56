"""Asks bins for the pictures that they classified: a recording holds what a bin signed the hash of.

Bins also name a robot while others show something. So the pictures are bounded that are fetched before it is
known whether they count. What a drop refers to counts, and is fetched whatever came before.
"""

from __future__ import annotations

import base64
import binascii
import logging
import threading
from collections import deque
from collections.abc import Callable
from hashlib import sha256

import numpy as np

from rodeo.bus.session import Bus
from rodeo.errors import BusError, RemoteError
from rodeo.host.stamps import set_stamp
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo.witness.statement import MAX_LOOKS, Classification, Drop, Look

log = logging.getLogger(__name__)

_RETRY_WALL_S = 1.0
_ANSWER_WALL_S = 5.0
_MOST = 4 * MAX_LOOKS
"""Most pictures of one recording, before a drop says which count: a robot delivers its item four times,
and shows it each time for as many pictures as a classification combines."""
_MOST_DROPS = 12
"""Most drops of one recording whose pictures are fetched beyond that. A robot presents itself this often in
four deliveries, and a drop names nobody who presented itself before the last delivery."""
_LEFT = 32
"""Classifications that a drop may still refer to: a bin keeps no more pictures."""
_MAX_BYTES = 8 << 20
"""Most bytes of one picture, as the bin reads them."""

Write = Callable[[str, bytes, int], None]
"""Gets the bin's name, a CompressedImage as CDR and the time of the picture in ns."""


class PictureFetcher:
    """Fetches in a thread of its own what statements name, and hands it to `write`."""

    def __init__(self, bus: Bus, org: str, write: Write) -> None:
        self._bus = bus
        self._org = org
        self._write = write
        self._wanted: deque[tuple[str, Look]] = deque()
        """The bin's name and the picture."""
        self._asked: set[str] = set()
        self._left: deque[Classification] = deque(maxlen=_LEFT)
        """Too many for their pictures to be fetched before a drop refers to them."""
        self._fell: set[tuple[str, int]] = set()
        """What drops referred to: the bin's name and the number of the classification."""
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._fetch_all, name="pictures", daemon=True)
        self._thread.start()

    def want(self, classification: Classification) -> None:
        """All pictures that were combined, or none yet where there were too many before."""
        with self._changed:
            new = [look for look in classification.looks if look.image_sha256 not in self._asked]
            if _subject(classification) in self._fell:  # heard late
                self._ask(classification, first=True)
            elif len(self._asked) + len(new) <= _MOST:
                self._ask(classification, first=False)
            else:
                self._left.append(classification)
            self._changed.notify_all()

    def fell(self, drop: Drop) -> None:
        """The pictures of what fell count."""
        if drop.classification is None:
            return
        with self._changed:
            if len(self._fell) >= _MOST_DROPS:
                return
            fallen = drop.device, drop.classification
            self._fell.add(fallen)
            for one in self._left:
                if _subject(one) == fallen:
                    self._ask(one, first=True)
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

    def _ask(self, classification: Classification, first: bool) -> None:
        # The last one first: without it there is no classification.
        looks = [look for look in reversed(classification.looks) if look.image_sha256 not in self._asked]
        self._asked |= {look.image_sha256 for look in looks}
        wanted = [(classification.device, look) for look in looks]
        if first:
            self._wanted.extendleft(reversed(wanted))
        else:
            self._wanted.extend(wanted)

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
                # Others may have been put before it meanwhile.
                self._wanted.remove((bin_name, look))
                if picture is None:
                    self._wanted.append((bin_name, look))
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


def _subject(classification: Classification) -> tuple[str, int]:
    return classification.device, classification.number


def _message(picture: bytes, time_ns: int) -> bytes:
    """A sensor_msgs/msg/CompressedImage."""
    message = types.new(topics.BIN_IMAGE.type, format="png" if picture[:4] == b"\x89PNG" else "jpeg")
    set_stamp(message, time_ns)
    message.data = np.frombuffer(picture, np.uint8)
    return types.serialize(message)
