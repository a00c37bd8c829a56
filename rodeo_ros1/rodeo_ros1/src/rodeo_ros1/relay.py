"""The node: everything that the configuration declares, and a look each second at master and router.

rosrun rodeo_ros1 relay CONFIG.yaml
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import xmlrpc.client
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import genpy
import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from rodeo_ros1.actions import ActionToRos1, ActionToRos2
from rodeo_ros1.bus import Bus, open_session
from rodeo_ros1.cdr import Codecs
from rodeo_ros1.classes import message_class
from rodeo_ros1.config import Config, load
from rodeo_ros1.errors import RelayError
from rodeo_ros1.health import Health
from rodeo_ros1.layouts import Layouts
from rodeo_ros1.services import ServiceToRos1, ServiceToRos2
from rodeo_ros1.topics import TopicToRos1, TopicToRos2

log = logging.getLogger("rosout.relay")

_KINDS = {
    "topics_to_ros1": TopicToRos1,
    "topics_to_ros2": TopicToRos2,
    "services_to_ros1": ServiceToRos1,
    "services_to_ros2": ServiceToRos2,
    "actions_to_ros1": ActionToRos1,
    "actions_to_ros2": ActionToRos2,
}
_LOOK_S = 1.0
_MASTER_S = 3.0
"""A master that answers no sooner counts as gone."""


class _Transport(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = _MASTER_S
        return connection


class Relay:
    def __init__(self, config: Config, layouts: Layouts) -> None:
        self.stopping = threading.Event()
        self.forgotten = False
        """A new master does not know this node: it has to begin anew."""
        self.health = Health()
        self._config, self._layouts = config, layouts
        self._carried: list[Any] = []
        self._bus: Any = None
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)

    def open(self) -> None:
        """Wait for the router, and declare everything. Raises ConfigError."""
        session = open_session(self._config, self.stopping)
        if session is None:
            return
        node = rospy.get_name().strip("/").replace("/", "_")
        self._bus = Bus(session, self._config, self._layouts, node)
        codecs = Codecs(self._layouts, message_class, genpy.Time, genpy.Duration)
        for group, entries in self._config.entries.items():
            for entry in entries:
                if self.stopping.is_set():
                    return
                self._carried.append(_KINDS[group](entry, self._bus, codecs, self._layouts, self.health))
        log.info("relaying %d names to and from %s", len(self._carried), self._config.router)

    def run(self) -> None:
        """Look after master and router until the node is stopped, or has to begin anew."""
        while self._bus is not None and not self.forgotten and not self.stopping.wait(_LOOK_S):
            self.health.router.seen(self._bus.connected)
            self._look_for_master()
            self._publish()

    def _look_for_master(self) -> None:
        name = rospy.get_name()
        try:
            with xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), transport=_Transport()) as master:
                code, _, _ = master.lookupNode(name, name)
        except (OSError, xmlrpc.client.Error, ValueError) as error:
            log.debug("no master: %s", error)
            self.health.master.seen(False)
            return
        self.health.master.seen(True)
        if code != 1:
            log.error("the master was started anew and does not know this node, which begins anew, too")
            self.forgotten = True

    def _publish(self) -> None:
        told = DiagnosticArray()
        told.header.stamp = rospy.Time.now()
        for name, (level, words, values) in self.health.statuses():
            pairs = [KeyValue(key, value) for key, value in values.items()]
            told.status.append(
                DiagnosticStatus(
                    level=level,
                    name="{}: {}".format(rospy.get_name().strip("/"), name),
                    message=words,
                    hardware_id="",
                    values=pairs,
                )
            )
        self._diagnostics.publish(told)

    def stop(self) -> None:
        """Called by rospy before it closes its publishers: the robot still hears what is cancelled."""
        for one in self._carried:
            if isinstance(one, ActionToRos1):
                one.close()
        self.stopping.set()

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()


def main() -> int:
    arguments = rospy.myargv(sys.argv)
    if len(arguments) != 2:
        sys.stderr.write("usage: relay CONFIG.yaml\n")
        return 2
    try:
        layouts = Layouts.load()
        config = load(arguments[1], layouts)
        rospy.init_node("rodeo_relay")
        relay = Relay(config, layouts)
        rospy.on_shutdown(relay.stop)
        try:
            # rospy ends in the main thread, which must not be in a call to the master then.
            with ThreadPoolExecutor(1) as opening:
                opening.submit(relay.open).result()
            relay.run()
        finally:
            rospy.signal_shutdown("the relay ends")
            relay.close()
    except RelayError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    if relay.forgotten:
        os.execv(sys.executable, [sys.executable, *sys.argv])
    return 0
