"""The relay for nodes with a stock DDS: between zenoh-bridge-ros2dds and the site's bus."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import zenoh

from deploy.access import nodes_of
from rodeo.bus.session import Bus, zenoh_config
from rodeo.errors import ConfigError
from rodeo.host.clock import WallClock
from rodeo.interfaces.package import asked, commands, recorder, register
from rodeo.ros2.base import BaseNode
from rodeo.ros2.dds import DdsRelay, RawCodec, names_of_body
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import body_identity, node_identity
from rodeo.site.ros_names import ros_name
from rodeo.site.tls import identity
from rodeo.site.topics import NODE, Plane, Topic

_HERE = ("tcp/127.0.0.1:", "tcp/[::1]:", "unixsock-stream/")

Names = list[tuple[Topic, str]]


def names_of_node(site: Site, participant: str) -> tuple[Names, Names]:
    """What the nodes of a participant serve, and what the site has for them, each with its name: the
    organization's, and those of the recorder of a robot whose mind they are."""
    named = {"org": ros_name(site.org), "participant": ros_name(participant)}
    served = {name: one.interface.typename for name, one in (commands() | asked()).items()}
    takes = [
        (replace(topics.ROS_SERVICE, type=typename), topics.ROS_SERVICE.name(**named, service=name))
        for name, typename in served.items()
    ]
    others = [one for one in topics.TOPICS if one.plane is Plane.ORGANIZATION and one != topics.ROS_SERVICE]
    takes += [(one, one.name(**named)) for one in others if one.writer != NODE]
    gives = [(one, one.name(**named)) for one in others if one.writer == NODE]
    minds = [one for one in site.robots if one.mind == node_identity(participant)]
    recorded = [one for one in topics.TOPICS if one.key in recorder()] + [topics.ROBOT_ORDERS]
    takes += [(one, one.name(ns=robot.namespace)) for robot in minds for one in recorded]
    return gives, takes


@contextmanager
def relayed(site: Site, name: str, listen: str, stop: threading.Event) -> Iterator[int]:
    """Carry the names of a robot's body, of a participant's nodes, or of both; how many there are. Raises
    ConfigError where there are none, and BusUnavailable."""
    if not listen.startswith(_HERE):
        raise ConfigError("whoever reaches this address speaks as the robot: listen on this computer alone")
    robot = next((one for one in site.robots if (one.name, one.body) == (name, "ros2")), None)
    speakers = {} if robot is None else {body_identity(name): names_of_body(robot.namespace)}
    if (node := node_identity(name)) in nodes_of(site):
        speakers[node] = names_of_node(site, name)
    if not speakers:
        raise ConfigError(f'{name} is no robot with body = "ros2", and has no ROS 2 nodes on this site')
    register()
    with ExitStack() as closing:
        bridge = closing.enter_context(zenoh.open(zenoh_config("router", listen=[listen])))
        for shown, (gives, takes) in speakers.items():
            bus = closing.enter_context(Bus.open(site.bus.router, stop, identity=identity(site, shown)))
            speaks = BaseNode(bus.session, "dds", "", site.bus.domain_id, WallClock(), RawCodec())
            closing.callback(speaks.close)
            relay = DdsRelay(bridge, speaks)
            closing.callback(relay.close)
            for topic, key in gives:
                relay.carry_in(topic, key)
            for topic, key in takes:
                relay.carry_out(topic, key)
        yield sum(len(one) for pair in speakers.values() for one in pair)
