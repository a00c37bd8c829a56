"""OptiTrack Motive, which streams NatNet over UDP: by multicast, or to each client.

    [mocap]
    source = "natnet"
    address = "192.168.1.5"               # of the computer that runs Motive
    settings = { local = "192.168.1.20" } # of the network card here, where there are several

Frames are stamped with the middle of their exposure by Motive's clock, whose offset is known from echoes.
Until the first echo, a frame's time is that of its arrival less what Motive says that it took.
"""

from __future__ import annotations

import logging
import select
import socket
import threading
import time
from collections import Counter
from ipaddress import IPv4Address
from typing import Literal

from pydantic import Field

from rodeo.errors import ConfigError
from rodeo.host.offset import Offset, RoundTrip
from services.mocap import natnet
from services.mocap.natnet import Captured, Kind, MalformedPacket, Server
from services.mocap.sources import Frame, Opening, Pose, Settings, SourceKind

log = logging.getLogger(__name__)

_ASK_S = 1.0
"""Between two questions to a server: for its name, its bodies, its time, or to stream on."""
_SILENCE_S = 5.0
"""After this time without a frame the server is asked again for its name."""
_LOOK_S = 0.1
_MOST_BYTES = 65_535
_BUFFERED_BYTES = 1 << 20
_ECHO_LATE_NS = 5 * 10**9
_PERIOD_NS = 100_000_000
"""Longest time between two frames that follow each other."""
_STEP_NS = 500_000_000
"""A clock that jumped by more between two frames was set."""


class NatNetSettings(Settings):
    """Settings of a connection to Motive; its own are in its pane "Data Streaming"."""

    local: IPv4Address = IPv4Address("0.0.0.0")
    """Address of the network card that leads to Motive; by default the system chooses."""
    command_port: int = Field(1510, ge=1, le=65535)
    up: Literal["y", "z"] = "y"
    """"Up Axis" of Motive's stream."""


class _Sockets:
    """Sockets to one server: for questions and what answers them, and for its multicast group."""

    def __init__(self, host: str, settings: NatNetSettings) -> None:
        self._server, self._local = (host, settings.command_port), settings.local
        self._commands = self._opened()
        self._commands.bind((str(self._local), 0))
        self._frames: socket.socket | None = None

    @staticmethod
    def _opened() -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFERED_BYTES)
        return made

    def send(self, packet: bytes) -> None:
        """Raises OSError."""
        self._commands.sendto(packet, self._server)

    def join(self, server: Server) -> None:
        """Listen to the server's multicast group, if it has one. Raises OSError."""
        if self._frames is not None:
            self._frames.close()
            self._frames = None
        if server.group is None:
            return
        made = self._opened()
        try:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind((server.group, server.data_port))
            member = socket.inet_aton(server.group) + self._local.packed
            made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        except OSError:
            made.close()
            raise
        self._frames = made

    def ready(self, timeout_s: float) -> list[socket.socket]:
        """Those that have a packet."""
        listening = [self._commands, *([] if self._frames is None else [self._frames])]
        return select.select(listening, [], [], timeout_s)[0]

    def close(self) -> None:
        self._commands.close()
        if self._frames is not None:
            self._frames.close()


class _Bodies:
    """Numbers and names of the rigid bodies that are `wanted`."""

    def __init__(self, wanted: frozenset[str]) -> None:
        self._wanted = wanted
        self._names: dict[int, str] = {}
        self.twice: set[str] = set()
        """Names that several bodies have: one of them is not this one."""

    def learn(self, names: list[tuple[int, str]]) -> None:
        counts = Counter(name for _number, name in names)
        self.twice = {name for name in self._wanted if counts[name] > 1}
        self._names = {number: name for number, name in names if name in self._wanted - self.twice}

    @property
    def missing(self) -> list[str]:
        return sorted(self._wanted - self.twice - set(self._names.values()))

    def poses(self, seen: Captured, up: Literal["y", "z"]) -> dict[str, Pose | None]:
        """By name; None for one that is not in view."""
        found: dict[str, Pose | None] = dict.fromkeys(self._names.values())
        for number, one in seen.bodies.items():
            if number in self._names and one.tracked:
                shown = natnet.z_up(one) if up == "y" else one
                found[self._names[number]] = Pose(shown.position_m, shown.quaternion)
        return found


class NatNet:
    """An open connection to Motive. It is opened again for as long as nothing comes."""

    def __init__(self, opening: Opening) -> None:
        settings = opening.settings
        assert isinstance(settings, NatNetSettings)
        try:
            self._host = socket.gethostbyname(opening.address)
            self._sockets = _Sockets(self._host, settings)
        except OSError as error:
            raise ConfigError(
                f"no connection to Motive can be opened: {error}", address=opening.address
            ) from error
        self._settings, self._opening = settings, opening
        self.refused: Counter[str] = Counter()
        """Why packets were left out -> how many."""
        self._server: Server | None = None
        self._bodies = _Bodies(opening.bodies)
        self._offset = Offset()
        """Motive's clock less the site's."""
        self._heard_s = time.monotonic()
        """When the last frame came, or the server was asked anew."""
        self._asked_s = -_ASK_S
        self._number, self._exposed_ns = -1, 0
        """Number of the last frame, and its exposure by Motive's clock."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="natnet", daemon=True)
        self._thread.start()

    def problem(self) -> str:
        if self._server is None:
            why = self.refused.most_common(1)
            said = f"; it was refused {why[0][1]} times: {why[0][0]}" if why else ""
            return f"Motive does not answer at {self._host}:{self._settings.command_port}{said}"
        if time.monotonic() - self._heard_s > _SILENCE_S:
            return f"Motive at {self._host} streams no frames"
        if self._bodies.twice:
            return f"several rigid bodies in Motive have one name: {', '.join(sorted(self._bodies.twice))}"
        if missing := self._bodies.missing:
            return f"Motive has no rigid body of this name: {', '.join(missing)}"
        return ""

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._sockets.close()

    # -- inside ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            self._ask()
            for ready in self._sockets.ready(_LOOK_S):
                self._receive(ready)

    def _ask(self) -> None:
        """Ask the server for what is not known yet, and again for its time."""
        now_s = time.monotonic()
        if now_s - self._asked_s < _ASK_S:
            return
        self._asked_s = now_s
        if now_s - self._heard_s > _SILENCE_S:
            # It was started again, perhaps with other settings and another clock.
            self._server = None
            self._heard_s = now_s
        if self._server is None:
            self._send(natnet.request(Kind.CONNECT))
            return
        if self._server.group is None:
            self._send(natnet.request(Kind.KEEP_ALIVE))
        if self._bodies.twice or self._bodies.missing:
            self._send(natnet.request(Kind.REQUEST_MODELS))
        self._send(natnet.echo_request(self._opening.clock.now_ns()))

    def _send(self, packet: bytes) -> None:
        try:
            self._sockets.send(packet)
        except OSError as error:
            self._count(f"cannot be sent: {error.strerror}")

    def _receive(self, ready: socket.socket) -> None:
        try:
            packet, (sender, _port) = ready.recvfrom(_MOST_BYTES)
        except OSError as error:
            # Nobody listens there, as UDP says later.
            self._count(f"cannot be received: {error.strerror}")
            return
        arrived_ns = self._opening.clock.now_ns()
        if sender != self._host:
            self._count("from another computer")
            return
        try:
            self._take(packet, arrived_ns)
        except MalformedPacket as error:
            self._count(error.message)

    def _take(self, packet: bytes, arrived_ns: int) -> None:
        """A packet of the server. Raises MalformedPacket."""
        kind, payload = natnet.opened(packet)
        if kind == Kind.SERVER_INFO:
            self._greet(natnet.server(payload))
        elif self._server is None:
            return  # in which protocol is not known yet
        elif kind == Kind.MODELS:
            self._bodies.learn(natnet.names(payload, self._server.protocol))
        elif kind == Kind.ECHO_RESPONSE:
            self._echoed(*natnet.echoed(payload), arrived_ns, self._server)
        elif kind == Kind.FRAME:
            self._show(natnet.frame(payload, self._server.protocol), arrived_ns, self._server)

    def _greet(self, server: Server) -> None:
        if server == self._server:
            return
        log.info("%s at %s streams NatNet %d.%d", server.name, self._host, *server.protocol)
        self._server, self._number, self._asked_s = server, -1, -_ASK_S
        self._offset.clear()
        self._bodies.learn([])
        try:
            self._sockets.join(server)
        except OSError as error:
            self._server = None
            self._count(f"no multicast: {error.strerror}")

    def _echoed(self, asked_ns: int, ticks: int, arrived_ns: int, server: Server) -> None:
        trip = RoundTrip(asked_ns, natnet.ticks_ns(ticks, server.clock_hz), arrived_ns)
        if not 0 <= trip.took_ns <= _ECHO_LATE_NS:
            self._count("an echo of nothing")
            return
        self._offset.add(trip)

    def _show(self, seen: Captured, arrived_ns: int, server: Server) -> None:
        if seen.number == self._number:
            self._count("a frame twice")
            return
        exposed_ns = natnet.ticks_ns(seen.exposed, server.clock_hz)
        passed_ns, frames = exposed_ns - self._exposed_ns, seen.number - self._number
        if self._number >= 0 and not 0 <= passed_ns <= max(frames, 1) * _PERIOD_NS + _STEP_NS:
            # What echoes said of it before would make each frame wrong.
            log.warning("Motive's clock at %s was set", self._host)
            self._offset.clear()
            self._asked_s = -_ASK_S
        self._exposed_ns = exposed_ns
        self._number, self._heard_s = seen.number, time.monotonic()
        if seen.models_changed:
            # Numbers may be others' from now on.
            self._bodies.learn([])
            self._asked_s = -_ASK_S
        shown = self._bodies.poses(seen, self._settings.up)
        self._opening.deliver(Frame(self._site_ns(seen, arrived_ns, server), shown))

    def _site_ns(self, seen: Captured, arrived_ns: int, server: Server) -> int:
        """Site time of the middle of the exposure."""
        if (offset_ns := self._offset.ns) is not None:
            return natnet.ticks_ns(seen.exposed, server.clock_hz) - offset_ns
        return arrived_ns - natnet.ticks_ns(max(seen.sent - seen.exposed, 0), server.clock_hz)

    def _count(self, why: str) -> None:
        if not self.refused[why]:
            log.warning("left out a packet of Motive: %s", why)
        self.refused[why] += 1


SOURCE = SourceKind(open=NatNet, settings=NatNetSettings, stamps="site")
