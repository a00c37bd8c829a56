"""ROS 2 messages of the simulated robot and lab."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rodeo.lab.body import JOINTS, Body
from rodeo.lab.config import BatteryConfig
from rodeo.ros2 import types
from services.robot_sim.battery import Battery, Supply, SupplyStatus
from services.robot_sim.simulation import SimRobot

Numbers = Sequence[float] | np.ndarray

_Time = types.msg("builtin_interfaces/msg/Time")
_Header = types.msg("std_msgs/msg/Header")
_Point = types.msg("geometry_msgs/msg/Point")
_Vector3 = types.msg("geometry_msgs/msg/Vector3")
_Quaternion = types.msg("geometry_msgs/msg/Quaternion")
_Pose = types.msg("geometry_msgs/msg/Pose")
_PoseStamped = types.msg("geometry_msgs/msg/PoseStamped")
_PoseWithCovariance = types.msg("geometry_msgs/msg/PoseWithCovariance")
_Twist = types.msg("geometry_msgs/msg/Twist")
_TwistWithCovariance = types.msg("geometry_msgs/msg/TwistWithCovariance")
_Odometry = types.msg("nav_msgs/msg/Odometry")
_JointState = types.msg("sensor_msgs/msg/JointState")

_LION = 2
"""sensor_msgs/BatteryState POWER_SUPPLY_TECHNOLOGY_LION; GOOD health is 1."""
_INFRARED = 1
_COVARIANCE = np.zeros(36)


def stamp(time_ns: int) -> Any:
    sec, nanosec = divmod(time_ns, 1_000_000_000)
    return _Time(sec=sec, nanosec=nanosec)


def header(time_ns: int, frame: str) -> Any:
    return _Header(stamp=stamp(time_ns), frame_id=frame)


def clock(time_ns: int) -> Any:
    return types.msg("rosgraph_msgs/msg/Clock")(clock=stamp(time_ns))


def pose(position_m: Numbers, quat_wxyz: Numbers) -> Any:
    x, y, z = position_m
    qw, qx, qy, qz = quat_wxyz
    return _Pose(position=_Point(x=x, y=y, z=z), orientation=_Quaternion(x=qx, y=qy, z=qz, w=qw))


def planar_pose(x_m: float, y_m: float, yaw_rad: float) -> Any:
    return pose((x_m, y_m, 0.0), (math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)))


def pose_stamped(time_ns: int, pose_in_map: Any) -> Any:
    return _PoseStamped(header=header(time_ns, "map"), pose=pose_in_map)


def odometry(time_ns: int, robot: SimRobot) -> Any:
    reckoned, twist = robot.odometry, robot.body.wheel_twist
    moving = _Twist(
        linear=_Vector3(x=twist.linear_m_s, y=0.0, z=0.0),
        angular=_Vector3(x=0.0, y=0.0, z=twist.angular_rad_s),
    )
    return _Odometry(
        header=header(time_ns, "odom"),
        child_frame_id="base_link",
        pose=_PoseWithCovariance(
            pose=planar_pose(reckoned.x_m, reckoned.y_m, reckoned.yaw_rad), covariance=_COVARIANCE
        ),
        twist=_TwistWithCovariance(twist=moving, covariance=_COVARIANCE),
    )


def joint_state(time_ns: int, body: Body) -> Any:
    return _JointState(
        header=header(time_ns, ""),
        name=list(JOINTS),
        position=body.positions,
        velocity=body.velocities,
        effort=body.efforts,
    )


def battery_state(time_ns: int, battery: Battery) -> Any:
    config: BatteryConfig = battery.config
    charging = battery.current_a > 0
    return types.new(
        "sensor_msgs/msg/BatteryState",
        header=header(time_ns, "base_link"),
        voltage=battery.voltage_v,
        temperature=math.nan,
        current=battery.current_a,
        charge=battery.soc * config.capacity_ah,
        capacity=config.capacity_ah,
        design_capacity=config.capacity_ah,
        percentage=battery.soc,
        power_supply_status=int(SupplyStatus.CHARGING if charging else SupplyStatus.DISCHARGING),
        power_supply_health=1,
        power_supply_technology=_LION,
        present=True,
    )


def dock_output(time_ns: int, supply: Supply) -> Any:
    """What the meter at the terminals sees; `present`: a battery is on the contacts."""
    return types.new(
        "sensor_msgs/msg/BatteryState",
        header=header(time_ns, supply.config.name),
        voltage=supply.voltage_v,
        temperature=math.nan,
        current=supply.current_a,
        charge=math.nan,
        capacity=math.nan,
        design_capacity=math.nan,
        percentage=math.nan,
        power_supply_status=int(supply.status),
        present=supply.connected,
    )


def presence(time_ns: int, frame: str, distance_m: float) -> Any:
    return types.new(
        "sensor_msgs/msg/Range",
        header=header(time_ns, frame),
        radiation_type=_INFRARED,
        field_of_view=0.01,
        min_range=0.02,
        max_range=2.0,
        range=distance_m,
    )


def load(time_ns: int, frame: str, weight_n: float) -> Any:
    wrench = types.new("geometry_msgs/msg/Wrench", force=_Vector3(x=0.0, y=0.0, z=weight_n))
    return types.new("geometry_msgs/msg/WrenchStamped", header=header(time_ns, frame), wrench=wrench)


def compressed_image(time_ns: int, frame: str, jpeg: bytes) -> Any:
    return types.new(
        "sensor_msgs/msg/CompressedImage",
        header=header(time_ns, frame),
        format="jpeg",
        data=np.frombuffer(jpeg, np.uint8),
    )
