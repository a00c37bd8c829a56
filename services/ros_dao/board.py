"""What nodes hear without asking: tasks, services and balances as they are now, and each event."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rodeo.bus import queries
from rodeo.bus.messages import LIVE_STATES, DaoEvent
from rodeo.bus.queries import MAX_PAGE, Query
from rodeo.bus.session import Bus, DaoEvents
from rodeo.errors import BusError, RemoteError
from rodeo.interfaces.convert import message
from rodeo.ros2 import types, wire
from rodeo.ros2.base import Publisher
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.ros_names import ros_name
from rodeo.site.topics import Topic

log = logging.getLogger(__name__)

REFRESH_S = 1.0
"""Wall time between two looks at what changed: a page of 500 tasks takes a tenth of a second to write."""
_RETRY_S = 2.0


@dataclass
class _Listing:
    topic: Topic
    query: Query[Any]
    parameters: Mapping[str, Any]
    publishers: Sequence[Publisher]
    published: bytes = field(default=b"")


class Board:
    """Publishes below the name of each of `nodes`, which are by participant.

    Args:
        on_event: also called with each event, in the thread that publishes it.
    """

    def __init__(
        self, bus: Bus, site: Site, nodes: Mapping[str, Node], on_event: Callable[[DaoEvent], None]
    ) -> None:
        self._bus = bus
        self._org = site.org
        self._currency = site.economy.currency
        self._on_event = on_event
        self.problem = ""
        """Why what is listed is not as it is now; empty if it is."""
        self._changed = threading.Event()
        self._stop = threading.Event()
        self._events: DaoEvents | None = None

        def publishers(topic: Topic) -> list[Publisher]:
            types.prepare(topic.type)
            return [
                node.publisher(
                    topic.name(org=ros_name(site.org), participant=ros_name(name)), topic.type, wire.LATCHED
                )
                for name, node in nodes.items()
            ]

        running = {"state": ",".join(LIVE_STATES), "limit": MAX_PAGE}
        self._lists = [
            _Listing(topic, query, parameters, publishers(topic))
            for topic, query, parameters in (
                (topics.ROS_TASKS, queries.TASKS, running),
                (topics.ROS_SERVICES, queries.SERVICES, {}),
                (topics.ROS_BALANCES, queries.WALLETS, {}),
            )
        ]
        self._event_publishers = publishers(topics.ROS_EVENTS)
        self._thread = threading.Thread(target=self._run, name="board", daemon=True)

    def begin(self, after_seq: int) -> None:
        """Publish from now on, the events with those after `after_seq`."""
        self._events = DaoEvents(self._bus, self._org, self._take, after_seq=after_seq)
        self._changed.set()
        self._thread.start()

    def _take(self, event: DaoEvent) -> None:
        self._changed.set()
        self._on_event(event)
        cdr = types.serialize(message(event, self._currency))
        for publisher in self._event_publishers:
            publisher.publish_cdr(cdr)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._changed.wait()
            self._changed.clear()
            try:
                for listing in self._lists:
                    self._publish(listing)
                self.problem = ""
            except (BusError, RemoteError) as error:
                log.info("cannot list what there is: %s", error)
                self._changed.set()
                self._stop.wait(_RETRY_S)
            except Exception as error:
                if not self._stop.is_set():
                    log.exception("cannot publish what there is")
                    self.problem = f"cannot publish what there is: {error}"
                    self._changed.set()
                    self._stop.wait(_RETRY_S)
            self._stop.wait(REFRESH_S)

    def _publish(self, listing: _Listing) -> None:
        answer = queries.ask(self._bus, self._org, listing.query, **listing.parameters)
        cdr = types.serialize(message(answer, self._currency))
        if cdr != listing.published and not self._stop.is_set():
            for publisher in listing.publishers:
                publisher.publish_cdr(cdr)
            listing.published = cdr

    def close(self) -> None:
        """Before nodes and bus."""
        self._stop.set()
        self._changed.set()
        if self._events is not None:
            self._events.close()
            self._thread.join(timeout=2.0)
