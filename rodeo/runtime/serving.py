"""One process at a time works with a key or speaks for a device.

Each holds a liveliness token, `rodeo/<org>/serves/<what>/<name>/<state>/<holder>`: it goes with its session.
Two processes that start at the same moment both claim first and look then. The router takes one declaration
after the other, so that at least one of them sees the other: the elder waits, the younger steps back, and who
sees nobody serves. After a partition two may serve: the younger ends.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import zenoh

from rodeo.bus.sending import has_left
from rodeo.errors import Interrupted, ServedElsewhere
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import (
    bin_process,
    bridge_wallets,
    dock_process,
    oracle_names,
    oracle_process,
    robot_process,
)
from rodeo.site.processes import ros_process
from rodeo.site.providers import SIMULATOR, provided_by

log = logging.getLogger(__name__)

LEASE_S = 12.0
"""Wall time for which a claim waits for a holder's end. Zenoh drops a session that fell silent after 10 s."""

_LOOK_S = 0.2
"""Wall time between two looks while a claim waits."""

_WATCH_S = 5.0
"""The same once it serves: the router reports what happens, unless it was away."""

_ANSWER_S = 5.0

RIVAL_SHOWN_S = 600.0
"""Wall time for which a process's state tells of another that wanted to serve the same."""

CLAIMS, SERVES = "claims", "serves"


class Thing(NamedTuple):
    """What only one process may serve."""

    what: str
    """wallet, oracle, robot, bin, dock, mocap, ros, clock or console"""
    name: str

    def __str__(self) -> str:
        return f"{self.what} {self.name}"


def served_by(site: Site, process: str) -> list[Thing]:
    """What `process` of the table serves."""
    if (names := bridge_wallets(site).get(process)) is not None:
        return [Thing("wallet", name) for name in names]
    things = {
        "console": Thing("console", "console"),
        SIMULATOR: Thing("clock", f"domain{site.bus.domain_id}"),
    }
    things |= {oracle_process(site, name): Thing("oracle", name) for name in oracle_names(site)}
    things |= {bin_process(site, one.name): Thing("bin", one.name) for one in site.bins}
    things |= {dock_process(site, one.name): Thing("dock", one.name) for one in site.docks}
    things |= {ros_process(site, one.owner): Thing("ros", one.owner) for one in site.ros}
    things |= {robot_process(site, robot.name): Thing("robot", robot.name) for robot in site.robots}
    cameras = [Thing("mocap", name) for name in provided_by(site, process, "mocap")]
    return [*([things[process]] if process in things else []), *cameras]


@dataclass(frozen=True, order=True)
class Holder:
    """A process that claims or serves; the elder is the smaller."""

    since_ns: int
    """Wall time of its claim."""
    pid: int
    host: str

    @classmethod
    def here(cls) -> Holder:
        return cls(time.time_ns(), os.getpid(), re.sub(r"[^A-Za-z0-9.-]", "-", socket.gethostname()))

    @classmethod
    def decode(cls, text: str) -> Holder | None:
        """The holder in the last part of a token, None where it is none of ours."""
        since_ns, _, rest = text.partition("_")
        pid, _, host = rest.partition("_")
        return cls(int(since_ns), int(pid), host) if since_ns.isdigit() and pid.isdigit() else None

    def encode(self) -> str:
        return f"{self.since_ns}_{self.pid}_{self.host}"

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}"


@dataclass(frozen=True)
class Rival:
    """Somebody else's token."""

    thing: Thing
    serves: bool
    holder: Holder


class Rivals:
    """Others that wanted to serve the same, as far as they were heard of."""

    def __init__(self) -> None:
        self._heard_s: dict[Holder, dict[Thing, float]] = {}
        """When each was heard of last (monotonic wall time)."""
        self._lock = threading.Lock()

    def heard(self, rival: Rival) -> None:
        with self._lock:
            wanted = self._heard_s.setdefault(rival.holder, {})
            new = rival.thing not in wanted
            wanted[rival.thing] = time.monotonic()
        if new:
            log.warning("%s tries to serve %s, which is already served here", rival.holder, rival.thing)

    def warnings(self) -> list[str]:
        """A text for each that was heard of in the last RIVAL_SHOWN_S."""
        since_s = time.monotonic() - RIVAL_SHOWN_S
        texts = []
        with self._lock:
            for holder, wanted in self._heard_s.items():
                if things := sorted(str(thing) for thing, heard_s in wanted.items() if heard_s > since_s):
                    texts.append(f"{holder} also tries to serve {', '.join(things)}")
        return texts


class Claim:
    """The right to serve `things`, from `take` to `close`. `connected()` says whether there is a router."""

    def __init__(
        self,
        session: zenoh.Session,
        org: str,
        things: Iterable[Thing],
        connected: Callable[[], bool],
        holder: Holder | None = None,
    ) -> None:
        self._session = session
        self._org = org
        self._things = list(things)
        self._connected = connected
        self.holder = holder or Holder.here()
        self._claims: list[zenoh.LivelinessToken] = []
        self._serves: list[zenoh.LivelinessToken] = []
        self._wake = threading.Event()
        self._closed = threading.Event()
        self._watcher: threading.Thread | None = None
        self._subscriber: zenoh.Subscriber[None] | None = None

    def take(
        self, stop: threading.Event, say: Callable[[str], None] = log.warning, lease_s: float = LEASE_S
    ) -> None:
        """Return when nobody else serves any of the things. `say(reason)` is called while somebody does.

        Raises ServedElsewhere when that continues for `lease_s` of wall time, and Interrupted.
        """
        deadline_s: float | None = None
        # Declared before the first look, for whoever serves to hear of it.
        self._claims = self._declare(CLAIMS)
        while True:
            rivals = self._look()
            if rivals == [] and self._claims:
                self._serves = self._declare(SERVES)
                self._drop(self._claims)
                return
            if rivals is None:
                say("the router does not answer which process serves what")
            elif any(rival.serves or rival.holder < self.holder for rival in rivals):
                self._drop(self._claims)
            elif not self._claims:
                self._claims = self._declare(CLAIMS)
                continue
            if rivals:
                error = _served_elsewhere(rivals)
                now_s = time.monotonic()
                deadline_s = deadline_s or now_s + lease_s
                if now_s >= deadline_s:
                    self.close()
                    raise error
                say(f"{error.message}; waiting up to {lease_s:.0f} s for it to exit")
            if stop.wait(_LOOK_S):
                self.close()
                raise Interrupted("stopped while waiting for another process to stop serving the same")

    def watch(self, on_rival: Callable[[Rival], None], on_lost: Callable[[ServedElsewhere], None]) -> None:
        """From now on `on_rival` hears of others that want to serve the same, and `on_lost` of an elder that
        does: this process must end."""

        def work() -> None:
            while not self._closed.is_set():
                try:
                    rivals = self._look() or []
                except zenoh.ZError:
                    if not has_left(self._session):
                        raise
                    return
                if elder := [one for one in rivals if one.serves and one.holder < self.holder]:
                    on_lost(_served_elsewhere(elder))
                    return
                for rival in rivals:
                    on_rival(rival)
                self._wake.wait(_WATCH_S)
                self._wake.clear()

        def on_token(sample: zenoh.Sample) -> None:
            rival = self._parse(str(sample.key_expr))
            if rival is not None and sample.kind == zenoh.SampleKind.PUT:
                # A claim that is refused is gone before anybody looks.
                on_rival(rival)
                self._wake.set()

        self._subscriber = self._session.liveliness().declare_subscriber(self._expression, on_token)
        # The router takes one message after the other: who claims after this answer is heard of, and who did
        # before it is seen by the watcher's own look or was gone.
        self._look()
        self._watcher = threading.Thread(target=work, name="serves", daemon=True)
        self._watcher.start()

    def close(self) -> None:
        """Leave the things to others."""
        self._closed.set()
        self._wake.set()
        if self._subscriber is not None:
            self._subscriber.undeclare()
            self._subscriber = None
        self._drop(self._claims)
        self._drop(self._serves)

    @property
    def _expression(self) -> str:
        return topics.SERVES.pattern(org=self._org)

    def _declare(self, state: str) -> list[zenoh.LivelinessToken]:
        names = [
            topics.SERVES.name(
                org=self._org, what=one.what, name=one.name, state=state, holder=self.holder.encode()
            )
            for one in self._things
        ]
        return [self._session.liveliness().declare_token(name) for name in names]

    def _drop(self, tokens: list[zenoh.LivelinessToken]) -> None:
        while tokens:
            tokens.pop().undeclare()

    def _look(self) -> list[Rival] | None:
        """Everybody else at the same things, or None when the router did not tell."""
        if not self._connected():
            return None
        rivals = []
        for reply in self._session.liveliness().get(self._expression, timeout=_ANSWER_S):
            if reply.ok is None:
                return None
            if (rival := self._parse(str(reply.ok.key_expr))) is not None:
                rivals.append(rival)
        return rivals if self._connected() else None

    def _parse(self, token: str) -> Rival | None:
        """The rival of a token; None for our own, and for what is not ours to serve."""
        parts = topics.SERVES.parts(token)
        if parts is None:
            return None
        thing, holder = Thing(parts["what"], parts["name"]), Holder.decode(parts["holder"])
        if thing not in self._things or holder is None or holder == self.holder:
            return None
        return Rival(thing, parts["state"] == SERVES, holder)


def _served_elsewhere(rivals: list[Rival]) -> ServedElsewhere:
    first = min(rivals, key=lambda rival: (not rival.serves, rival.holder))
    things = ", ".join(sorted({str(rival.thing) for rival in rivals if rival.holder == first.holder}))
    return ServedElsewhere(
        f"already served by {first.holder}: {things}; stop it there (`rodeo down`), then start this one",
        holder=str(first.holder),
        since_s=round(first.holder.since_ns * 1e-9, 3),
    )
