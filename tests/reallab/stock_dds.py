"""A robot whose ROS 2 runs a stock DDS, as zenoh-bridge-ros2dds shows it to Zenoh by its public description.

Keys are plain names, without domain, type and hash. Messages are CDR, without attachment. What is served can
be found by a liveliness token. The methods are those of `interfaces.Network`.
"""

from __future__ import annotations

import json
import queue
from collections.abc import Callable, Mapping
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_ACTION = "/_action/"


class StockDds:
    """A session with the relay on the robot's computer.

    Args:
        endpoint: where the relay listens.
        parts: texts of messages that rosbags does not know.
    """

    def __init__(self, endpoint: str, parts: Mapping[str, str]) -> None:
        config = zenoh.Config()
        settings = {
            "mode": "client",
            "connect/endpoints": [endpoint],
            "scouting/multicast/enabled": False,
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._kept: list[Any] = []
        for name, text in parts.items():
            self.define(name, text)

    def define(self, typename: str, text: str) -> None:
        self.store.register(get_types_from_msg(text, typename))

    def new(self, typename: str, **fields: Any) -> Any:
        return self.store.types[typename](**fields)

    @staticmethod
    def seconds(stamp: Any) -> float:
        """A time or a duration."""
        return float(stamp.sec + stamp.nanosec * 1e-9)

    def publisher(self, topic: str, typename: str) -> _Publisher:
        if _ACTION not in topic:
            self._announce("MP", topic, typename)
        # As a reliable writer's messages are.
        reliable = self.session.declare_publisher(topic, congestion_control=zenoh.CongestionControl.BLOCK)
        return _Publisher(self, reliable, typename)

    def server(
        self,
        name: str,
        typename: str,
        texts: tuple[str, str],
        callback: Callable[[Any], Any] | None = None,
        mode: str = "",
    ) -> _Server:
        """One that answers by `callback`, or with `mode="queue"` when somebody has taken the request."""
        assert (callback is None) == (mode == "queue")
        package, group, service = typename.split("/")
        request, response = (f"{package}/{group}/msg/{service}_{half}" for half in ("Request", "Response"))
        for one, text in zip((request, response), texts, strict=True):
            self.define(one, text)
        served = _Server(self, name, request, response, callback)
        self._kept.append(self.session.declare_queryable(name, served.on_query))
        action, part, _ = name.partition(_ACTION)
        if not part:
            self._announce("SS", name, typename)
        elif typename.endswith("_SendGoal"):
            # The last of its three services: from now on there is an action.
            self._announce("AS", action, typename.removesuffix("_SendGoal"))
        return served

    def _announce(self, kind: str, name: str, typename: str) -> None:
        mangled = "/".join(one.replace("/", "§") for one in (name, typename))
        token = f"@/{self.session.info.zid()}/@ros2_lv/{kind}/{mangled}"
        self._kept.append(self.session.liveliness().declare_token(token))


class _Publisher:
    def __init__(self, network: StockDds, publisher: zenoh.Publisher, typename: str) -> None:
        self._network, self._publisher, self._type = network, publisher, typename

    def publish(self, **fields: Any) -> None:
        message = self._network.new(self._type, **fields)
        self._publisher.put(bytes(self._network.store.serialize_cdr(message, self._type)))


class _Server:
    def __init__(
        self,
        network: StockDds,
        name: str,
        request: str,
        response: str,
        callback: Callable[[Any], Any] | None,
    ) -> None:
        self._store, self._name, self._callback = network.store, name, callback
        self._request, self._response = request, response
        self.response_msg_class: Any = network.store.types[response]
        self._asked: queue.SimpleQueue[tuple[zenoh.Query, Any]] = queue.SimpleQueue()

    def on_query(self, query: zenoh.Query) -> None:
        assert query.payload is not None, f"a request of {self._name} has fields"
        request = self._store.deserialize_cdr(query.payload.to_bytes(), self._request)
        if self._callback is None:
            self._asked.put((query, request))
        else:
            self.send_response(query, self._callback(request))

    def take_request(self) -> tuple[zenoh.Query, Any]:
        return self._asked.get()

    def send_response(self, query: zenoh.Query, response: Any) -> None:
        with query:
            query.reply(self._name, bytes(self._store.serialize_cdr(response, self._response)))
