"""Motive's stream, NatNet over UDP, from its public description: what a lab's OptiTrack computer sends.

Rigid bodies in a frame whose y axis is up, as Motive has it. Each client that asks gets the frames.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping

import numpy as np

Poses = Mapping[str, tuple[np.ndarray, np.ndarray] | None]
"""Body -> position (3,) in m and quaternion (4,) w x y z, z up; None for one that is not in view."""

CONNECT, SERVER_INFO, REQUEST_MODELS, MODELS, FRAME, ECHO, ECHOED = 0, 1, 4, 5, 7, 12, 13
TICKS_HZ = 10_000_000
EXPOSED_S = 0.006
"""From the middle of the exposure until the frame is sent."""
PERIOD_S = 0.01
_AWAKE_S = 60.0
"""A client that has not asked anything for so long gets no more frames."""
_TRACKED = 1


def y_up(position_m: np.ndarray, quaternion: np.ndarray) -> tuple[float, ...]:
    """x y z and qx qy qz qw in Motive's frame."""
    (x, y, z), (w, i, j, k) = position_m, quaternion
    return x, z, -y, i, k, -j, w


class Motive:
    """A server of NatNet on a port of loopback.

    Args:
        poses: what the cameras see now.
        protocol: (3, 0) or (4, 1).
        ahead_s: how far its clock is ahead of the machine's; Motive counts from when it was started.
    """

    def __init__(
        self,
        port: int,
        bodies: list[str],
        poses: Callable[[], Poses],
        protocol: tuple[int, int] = (4, 1),
        ahead_s: float = -1e9,
    ) -> None:
        self._numbers = {name: number for number, name in enumerate(bodies, 1)}
        self._poses, self._protocol = poses, protocol
        self.ahead_s = ahead_s
        self.plugged = True
        """Whether anything comes in or goes out."""
        self.frozen = False
        """Whether it sends the last frame again and again."""
        self._last = b""
        self._clients: dict[tuple[str, int], float] = {}
        self._count = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        for serve in (self._listen, self._stream):
            threading.Thread(target=serve, daemon=True).start()

    def _ticks(self, before_s: float = 0.0) -> int:
        return int((time.time() - before_s + self.ahead_s + 2e9) * TICKS_HZ)

    def _listen(self) -> None:
        while True:
            asked, client = self._socket.recvfrom(2000)
            if not self.plugged:
                continue
            self._clients[client] = time.monotonic()
            kind = struct.unpack_from("<H", asked)[0]
            if kind == CONNECT:
                self._send(SERVER_INFO, self._server(), client)
            elif kind == REQUEST_MODELS:
                self._send(MODELS, self._models(), client)
            elif kind == ECHO:
                self._send(ECHOED, asked[4:12] + struct.pack("<Q", self._ticks()), client)

    def _stream(self) -> None:
        next_s = time.monotonic()
        pause = threading.Event()
        while True:
            next_s = max(next_s + PERIOD_S, time.monotonic())
            pause.wait(next_s - time.monotonic())
            if not self.plugged:
                continue
            frame = self._last = self._last if self.frozen else self._frame(self._poses())
            for client, asked_s in list(self._clients.items()):
                if time.monotonic() - asked_s < _AWAKE_S:
                    self._send(FRAME, frame, client)

    def _send(self, kind: int, payload: bytes, client: tuple[str, int]) -> None:
        self._socket.sendto(struct.pack("<HH", kind, len(payload)) + payload, client)

    def _server(self) -> bytes:
        name = b"Motive".ljust(256, b"\0")
        versions = bytes((3, 1, 0, 0)) + bytes((*self._protocol, 0, 0))
        return name + versions + struct.pack("<QH?4B", TICKS_HZ, 1511, False, 0, 0, 0, 0)

    def _models(self) -> bytes:
        said = struct.pack("<I", len(self._numbers))
        for name, number in self._numbers.items():
            body = name.encode() + b"\0" + struct.pack("<II3f", number, 0xFFFFFFFF, 0, 0, 0)
            body += struct.pack("<I", 0)
            said += struct.pack("<I", 1) + (self._size(body) + body)
        return said

    def _size(self, content: bytes) -> bytes:
        """Protocol 4.1 names the size of what follows."""
        return struct.pack("<I", len(content)) if self._protocol >= (4, 1) else b""

    def _frame(self, poses: Poses) -> bytes:
        self._count += 1
        bodies = b""
        for name, number in self._numbers.items():
            seen = poses.get(name)
            told = (0.0,) * 7 if seen is None else y_up(*seen)
            bodies += struct.pack("<I7ffH", number, *told, 0.0005, 0 if seen is None else _TRACKED)
        none = struct.pack("<I", 0) + self._size(b"")
        sections = [none, none, struct.pack("<I", len(self._numbers)) + self._size(bodies) + bodies]
        # Skeletons, other assets in 4.1, labelled markers, force plates, devices.
        sections += [none] * (5 if self._protocol >= (4, 1) else 4)
        exposed, received, sent = self._ticks(EXPOSED_S), self._ticks(0.002), self._ticks()
        end = struct.pack("<IId", 0, 0, self._count * PERIOD_S) + struct.pack("<QQQ", exposed, received, sent)
        if self._protocol >= (4, 1):
            end += struct.pack("<II", 0, 0)
        return struct.pack("<I", self._count) + b"".join(sections) + end + struct.pack("<HI", 0, 0)
