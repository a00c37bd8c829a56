"""ROS 2 in pure Python: topics, services and actions in the wire format of rmw_zenoh.

No ROS installation is needed on our side; nodes that run ROS 2 with rmw_zenoh on the same Zenoh network
see ours as their own kind, and the other way round.
"""

from rodeo.ros2.action import ActionClient, ActionServer, ClientGoal, GoalStatus, ServerGoal
from rodeo.ros2.node import MessageInfo, Node, Publisher, Subscription
from rodeo.ros2.service import Client, Service
from rodeo.ros2.wire import DEFAULT, LATCHED, SENSOR_DATA, QoS

__all__ = [
    "DEFAULT",
    "LATCHED",
    "SENSOR_DATA",
    "ActionClient",
    "ActionServer",
    "Client",
    "ClientGoal",
    "GoalStatus",
    "MessageInfo",
    "Node",
    "Publisher",
    "QoS",
    "ServerGoal",
    "Service",
    "Subscription",
]
