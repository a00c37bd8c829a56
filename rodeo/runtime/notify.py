"""The service manager that started this process, told how it is: sd_notify(3), a datagram of lines.

systemd names its socket in NOTIFY_SOCKET. Without that variable there is no such manager.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Mapping

log = logging.getLogger(__name__)

SOCKET_VARIABLE = "NOTIFY_SOCKET"

_EXTENDS_S = 60
"""A start may take this much longer after each word of a process that waits for something."""


class ServiceManager:
    """READY=1 is said once, WATCHDOG=1 with each heartbeat of a process that does not hang.

    A process that waits for others is well: starting it again would not bring them back.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        name = environment.get(SOCKET_VARIABLE, "")
        # A name that begins with @ is one of the abstract namespace of unix(7).
        self._address = f"\0{name[1:]}" if name.startswith("@") else name
        self._socket: socket.socket | None = None
        self._is_ready = False
        if name:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            # A manager that stands still must not stop the process.
            self._socket.setblocking(False)

    def ready(self) -> None:
        """The process does its work from now on; only the first time is news."""
        if not self._is_ready:
            self._is_ready = True
            self._say("READY=1", "STATUS=ready")

    def alive(self, reason: str, hangs: bool) -> None:
        """A heartbeat; `reason` is why the process is not ready, empty where it is."""
        lines = [f"STATUS={' '.join(reason.split()) or 'ready'}"]
        if not self._is_ready:
            lines.append(f"EXTEND_TIMEOUT_USEC={_EXTENDS_S * 1_000_000}")
        self._say(*lines, *([] if hangs else ["WATCHDOG=1"]))

    def close(self) -> None:
        """The process ends by itself."""
        self._say("STOPPING=1")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _say(self, *lines: str) -> None:
        if (to := self._socket) is None:
            return
        try:
            to.sendto("\n".join(lines).encode(), self._address)
        except OSError as error:
            # It hears the next heartbeat, or its watchdog ends the process.
            log.warning("the service manager cannot be told %s: %s", lines[0], error)
