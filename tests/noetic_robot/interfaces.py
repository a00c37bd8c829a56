"""The network of `foreign_robot.robot` by rospy: names and messages of a Noetic robot."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import genpy
import numpy as np
import rospy

NAMES = {
    "odom": "/panther/odometry/filtered",
    "joint_states": "/joint_states",
    "arm_controller/controller_state": "/vx300s/arm_controller/state",
    "gripper_controller/controller_state": "/vx300s/gripper_controller/state",
    "battery_state": "/panther/battery",
    "scan": "/scan",
    "wrist_camera/depth/image_rect_raw": "/wrist_camera/depth/image_rect_raw",
    "wrist_camera/depth/camera_info": "/wrist_camera/depth/camera_info",
    "navigate_to_pose": "/move_base",
    "arm_controller/follow_joint_trajectory": "/vx300s/arm_controller/follow_joint_trajectory",
    "gripper_controller/gripper_cmd": "/vx300s/gripper_controller/gripper_cmd",
    "emergency_stop": "/emergency_stop",
}
"""Name below a robot's namespace in ROS 2 -> in this robot's ROS 1."""
RENAMED = {"reference": "desired", "feedback": "actual", "d": "D", "k": "K", "r": "R", "p": "P"}
SERVICES = dict.fromkeys(["std_srvs/srv/SetBool", "simulation_interfaces/srv/SetEntityState"])
TIMES = {"builtin_interfaces/msg/Time": genpy.Time, "builtin_interfaces/msg/Duration": genpy.Duration}


def ros1_name(name: str) -> str:
    for known, found in NAMES.items():
        if name.endswith(f"/{known}"):
            return found
    return f"/{name}"


def class_of(typename: str) -> Any:
    """Class of a message, a service or (`std_srvs/srv/msg/SetBool_Response`) a response."""
    package, form, name = typename.replace("/srv/msg/", "/srv/").split("/")
    return getattr(importlib.import_module(f"{package}.{form}"), name.replace("_", ""))


def plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    return value


class Publisher:
    def __init__(self, topic: str, typename: str) -> None:
        self._typename = typename
        self._publisher = rospy.Publisher(ros1_name(topic), class_of(typename), queue_size=100)

    def publish(self, **fields: Any) -> None:
        self._publisher.publish(Network.new(self._typename, **fields))


class Client:
    def __init__(self, name: str, typename: str) -> None:
        rospy.wait_for_service(ros1_name(name))
        self._proxy = rospy.ServiceProxy(ros1_name(name), class_of(typename), persistent=True)

    def call(self, **fields: Any) -> Any:
        return self._proxy(**fields)


class Network:
    def __init__(self, port: int) -> None:
        rospy.init_node("robot")

    @staticmethod
    def new(typename: str, **fields: Any) -> Any:
        """A message of ROS 1, with what it has of the fields."""
        if typename in TIMES:
            return TIMES[typename](fields["sec"], fields["nanosec"])
        made = class_of(typename)
        known = {name if name in made.__slots__ else RENAMED.get(name, name): v for name, v in fields.items()}
        return made(**{name: plain(value) for name, value in known.items() if name in made.__slots__})

    @staticmethod
    def seconds(stamp: Any) -> float:
        return float(stamp.to_sec())

    def publisher(self, topic: str, typename: str) -> Publisher:
        return Publisher(topic, typename)

    def subscriber(self, topic: str, typename: str, callback: Callable[[Any], None]) -> Any:
        return rospy.Subscriber(ros1_name(topic), class_of(typename), callback, queue_size=100)

    def server(self, name: str, typename: str, _texts: Any, callback: Callable[[Any], Any]) -> Any:
        return rospy.Service(ros1_name(name), class_of(typename), callback)

    def client(self, name: str, typename: str) -> Client:
        return Client(name, typename)
