"""A process as the others see it: a token on the bus, its status there and over HTTP, and its heartbeat,
which its service manager hears, too."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rodeo.bus.messages import Status
from rodeo.bus.session import Bus
from rodeo.host.instance import HEARTBEAT_S
from rodeo.runtime.metrics_server import metrics_server
from rodeo.runtime.notify import ServiceManager
from rodeo.site import topics
from rodeo.site.config import Site


class Presence:
    """Shows `status()` from `start` on; `look` is called before each heartbeat, until `stop` is set.
    `hangs()` is what the service manager hears with it."""

    def __init__(
        self,
        name: str,
        site: Site,
        bus: Bus,
        stop: threading.Event,
        status: Callable[[], Status],
        look: Callable[[], object],
        hangs: Callable[[], bool],
    ) -> None:
        """Raises PortUnavailable."""
        self._names = {"org": site.org, "process": name}
        self._stop = stop
        self._bus, self._status, self._look, self._hangs = bus, status, look, hangs
        self._manager = ServiceManager()
        self._metrics = metrics_server(site.metrics.host, site.metrics.ports.get(name, 0), status)
        self._heartbeat = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def start(self) -> None:
        self._metrics.start()
        self._alive = self._bus.session.liveliness().declare_token(topics.ALIVE.name(**self._names))
        self._queryable = self._bus.serve(self._key, lambda _request: self._status().model_dump())
        self._heartbeat.start()

    @property
    def url(self) -> str:
        """The metrics over HTTP."""
        return self._metrics.url

    def publish(self) -> Status:
        """Publish the status now: whoever waits for it need not wait for the next heartbeat."""
        status = self._status()
        self._bus.put_json(self._key, status)
        if status.ready:
            self._manager.ready()
        return status

    def close(self) -> None:
        """After `stop` is set."""
        self._heartbeat.join(timeout=2 * HEARTBEAT_S)
        self._manager.close()
        self._metrics.close()

    @property
    def _key(self) -> str:
        return topics.STATUS.name(**self._names)

    def _beat(self) -> None:
        while not self._stop.wait(HEARTBEAT_S):
            self._look()
            self._manager.alive(self.publish().reason, self._hangs())
