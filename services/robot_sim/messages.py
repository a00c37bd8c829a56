"""ROS 2 messages of the simulated robot and lab."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rodeo.host.stamps import sec_nanosec
from rodeo.lab.battery import Battery, Supply, SupplyStatus
from rodeo.lab.config import BatteryConfig, NoiseConfig
from rodeo.lab.geometry import quaternion_of
from rodeo.lab.sensors import Lidar, Pinhole
from rodeo.lab.world import CAMERA_SITE, LIDAR_SITE
from rodeo.ros2 import types
from services.robot_sim.cdr import (
    ControllerStates,
    DoublesRows,
    JointStates,
    StampedDoubles,
    StampedFields,
    StampedSequence,
    Transforms,
)
from services.robot_sim.frames import Transform
from services.robot_sim.planner import Point2

Numbers = Sequence[float] | np.ndarray

_Time = types.msg("builtin_interfaces/msg/Time")
_Header = types.msg("std_msgs/msg/Header")
_Point = types.msg("geometry_msgs/msg/Point")
_Vector3 = types.msg("geometry_msgs/msg/Vector3")
_Quaternion = types.msg("geometry_msgs/msg/Quaternion")
_Pose = types.msg("geometry_msgs/msg/Pose")
_PoseStamped = types.msg("geometry_msgs/msg/PoseStamped")
_PoseWithCovariance = types.msg("geometry_msgs/msg/PoseWithCovariance")
_Transform = types.msg("geometry_msgs/msg/Transform")
_TransformStamped = types.msg("geometry_msgs/msg/TransformStamped")
_TwistWithCovariance = types.msg("geometry_msgs/msg/TwistWithCovariance")
_Odometry = types.msg("nav_msgs/msg/Odometry")
_JointState = types.msg("sensor_msgs/msg/JointState")

_LION = 2
"""sensor_msgs/BatteryState POWER_SUPPLY_TECHNOLOGY_LION; GOOD health is 1."""
_INFRARED = 1
_PERFECT = 1e-6
_UNUSED = 1e-9
"""Variance of what a base on a floor does not do: small, because zero would mean unknown."""
ODOMETRY_NUMBERS = 7 + 36 + 6 + 36
ODOMETRY_TWIST = 7 + 36
"""Where the twist begins."""
LOAD_Z = 2
"""Which number of a load is its weight."""


def stamp(time_ns: int) -> Any:
    sec, nanosec = sec_nanosec(time_ns)
    return _Time(sec=sec, nanosec=nanosec)


def header(time_ns: int, frame: str) -> Any:
    return _Header(stamp=stamp(time_ns), frame_id=frame)


def clock(time_ns: int) -> Any:
    return types.msg("rosgraph_msgs/msg/Clock")(clock=stamp(time_ns))


def clock_template() -> StampedFields:
    return StampedFields(clock(0))


def pose(position_m: Numbers, quat_wxyz: Numbers) -> Any:
    x, y, z = position_m
    qw, qx, qy, qz = quat_wxyz
    return _Pose(position=_Point(x=x, y=y, z=z), orientation=_Quaternion(x=qx, y=qy, z=qz, w=qw))


def planar_pose(x_m: float, y_m: float, yaw_rad: float) -> Any:
    return pose((x_m, y_m, 0.0), quaternion_of(yaw_rad))


def pose_stamped(time_ns: int, pose_in_map: Any) -> Any:
    return _PoseStamped(header=header(time_ns, "map"), pose=pose_in_map)


def odometry_template(namespace: str, noise: NoiseConfig) -> DoublesRows:
    """Numbers: pose (x, y, z, qx, qy, qz, qw), its covariance, twist (linear, angular), its covariance.

    The covariance of the pose is that of one second of driving, as robot_localization expects of a pose that
    drifts without bound.
    """
    moving = np.diag(
        [(noise.wheel_scale or _PERFECT) ** 2, *[_UNUSED] * 4, (noise.gyro_rad_s or _PERFECT) ** 2]
    )
    template = _Odometry(
        header=header(0, f"{namespace}/odom"),
        child_frame_id=f"{namespace}/base_link",
        pose=_PoseWithCovariance(pose=planar_pose(0.0, 0.0, 0.0), covariance=moving.ravel()),
        twist=_TwistWithCovariance(twist=types.new("geometry_msgs/msg/Twist"), covariance=moving.ravel()),
    )
    return DoublesRows(template, ODOMETRY_NUMBERS)


def pose_template() -> DoublesRows:
    """Numbers: x, y, z, qx, qy, qz, qw."""
    return DoublesRows(pose_stamped(0, planar_pose(0.0, 0.0, 0.0)), 7)


def joint_state_template(joints: Sequence[str]) -> JointStates:
    zeros = np.zeros(len(joints))
    return JointStates(
        _JointState(header=header(0, ""), name=list(joints), position=zeros, velocity=zeros, effort=zeros)
    )


def controller_state_template(joints: Sequence[str]) -> ControllerStates:
    return ControllerStates(
        types.new(
            "control_msgs/msg/JointTrajectoryControllerState",
            header=header(0, ""),
            joint_names=list(joints),
            speed_scaling_factor=1.0,
        )
    )


def scan(time_ns: int, namespace: str, ranges_m: np.ndarray) -> Any:
    return types.new(
        "sensor_msgs/msg/LaserScan",
        header=header(time_ns, f"{namespace}/{LIDAR_SITE}"),
        angle_min=Lidar.ANGLE_MIN_RAD,
        angle_max=Lidar.ANGLE_MIN_RAD + (Lidar.BEAMS - 1) * Lidar.STEP_RAD,
        angle_increment=Lidar.STEP_RAD,
        range_min=Lidar.NEAREST_M,
        range_max=Lidar.FARTHEST_M,
        ranges=ranges_m.astype(np.float32),
    )


def scan_template(namespace: str) -> StampedSequence:
    """Numbers: (Lidar.BEAMS,) ranges in m."""
    return StampedSequence(scan(0, namespace, np.zeros(Lidar.BEAMS)), "ranges")


def depth_image(time_ns: int, namespace: str, depth_m: np.ndarray) -> Any:
    """32FC1, row by row."""
    height, width = depth_m.shape
    return types.new(
        "sensor_msgs/msg/Image",
        header=header(time_ns, f"{namespace}/{CAMERA_SITE}"),
        height=height,
        width=width,
        encoding="32FC1",
        step=4 * width,
        data=np.frombuffer(depth_m.astype("<f4").tobytes(), np.uint8),
    )


def camera_info(time_ns: int, namespace: str, lens: Pinhole) -> Any:
    matrix = lens.matrix
    return types.new(
        "sensor_msgs/msg/CameraInfo",
        header=header(time_ns, f"{namespace}/{CAMERA_SITE}"),
        height=lens.height_px,
        width=lens.width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=matrix.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([matrix, np.zeros((3, 1))]).ravel(),
    )


def camera_info_template(namespace: str, lens: Pinhole) -> StampedFields:
    return StampedFields(camera_info(0, namespace, lens))


def depth_image_template(namespace: str, lens: Pinhole) -> StampedSequence:
    """Numbers: the bytes of float32 depths in m, row by row."""
    return StampedSequence(depth_image(0, namespace, np.zeros((lens.height_px, lens.width_px))), "data")


def transforms(time_ns: int, frames: Sequence[Transform]) -> Any:
    stamped = [
        _TransformStamped(
            header=header(time_ns, frame.parent),
            child_frame_id=frame.child,
            transform=_transform(frame.position_m, frame.quat_wxyz),
        )
        for frame in frames
    ]
    return types.new("tf2_msgs/msg/TFMessage", transforms=stamped)


def _transform(position_m: Numbers, quat_wxyz: Numbers) -> Any:
    x, y, z = position_m
    qw, qx, qy, qz = quat_wxyz
    return _Transform(translation=_Vector3(x=x, y=y, z=z), rotation=_Quaternion(x=qx, y=qy, z=qz, w=qw))


def transforms_template(frames: Sequence[tuple[str, str]]) -> Transforms:
    """A template for (parent, child) frames."""
    still = Transform("", "", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return Transforms(transforms(0, [replace(still, parent=parent, child=child) for parent, child in frames]))


def path(time_ns: int, corners: Sequence[Point2]) -> Any:
    """A nav_msgs/Path along `corners`, a pose at each, facing the next."""
    poses, yaw_rad = [], 0.0
    for k, (x_m, y_m) in enumerate(corners):
        if k + 1 < len(corners) and corners[k + 1] != corners[k]:
            yaw_rad = math.atan2(corners[k + 1][1] - y_m, corners[k + 1][0] - x_m)
        poses.append(pose_stamped(time_ns, planar_pose(x_m, y_m, yaw_rad)))
    return types.new("nav_msgs/msg/Path", header=header(time_ns, "map"), poses=poses)


class BatteryState:
    """sensor_msgs/BatteryState of one robot's pack."""

    def __init__(self, namespace: str, config: BatteryConfig) -> None:
        self._capacity_ah = config.capacity_ah
        template = types.new(
            "sensor_msgs/msg/BatteryState",
            header=header(0, f"{namespace}/base_link"),
            temperature=math.nan,
            capacity=config.capacity_ah,
            design_capacity=config.capacity_ah,
            power_supply_health=1,
            power_supply_technology=_LION,
            present=True,
        )
        self._fields = StampedFields(
            template, voltage="f", current="f", charge="f", percentage="f", power_supply_status="B"
        )

    def encode(self, time_ns: int, battery: Battery) -> bytes:
        charging = battery.current_a > 0
        return self._fields.encode(
            time_ns,
            battery.voltage_v,
            battery.current_a,
            battery.soc * self._capacity_ah,
            battery.soc,
            SupplyStatus.CHARGING if charging else SupplyStatus.DISCHARGING,
        )


class DockOutput:
    """sensor_msgs/BatteryState as the meter at the dock's terminals sees it; `present`: a battery is on the
    contacts."""

    def __init__(self, dock: str) -> None:
        template = types.new(
            "sensor_msgs/msg/BatteryState",
            header=header(0, dock),
            temperature=math.nan,
            charge=math.nan,
            capacity=math.nan,
            design_capacity=math.nan,
            percentage=math.nan,
        )
        self._fields = StampedFields(template, voltage="f", current="f", power_supply_status="B", present="?")

    def encode(self, time_ns: int, supply: Supply) -> bytes:
        return self._fields.encode(
            time_ns, supply.voltage_v, supply.current_a, supply.status, supply.connected
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


def presence_template(frame: str) -> StampedFields:
    """Number: the distance in m."""
    return StampedFields(presence(0, frame, 0.0), range="f")


def load_template(frame: str) -> StampedDoubles:
    """Numbers: force (x, y, z), torque (x, y, z)."""
    return StampedDoubles(types.new("geometry_msgs/msg/WrenchStamped", header=header(0, frame)), 6)


def compressed_image(time_ns: int, frame: str, jpeg: bytes) -> Any:
    return types.new(
        "sensor_msgs/msg/CompressedImage",
        header=header(time_ns, frame),
        format="jpeg",
        data=np.frombuffer(jpeg, np.uint8),
    )
