"""The robot's motors and encoders in a MuJoCo world: what its drivers command, what its sensors read."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from rodeo.lab.config import MotionLimits, Pose2
from rodeo.lab.world import (
    ARM_JOINTS,
    CONTROL_PERIOD_S,
    FINGER_JOINTS,
    GRIPPER_CLOSED_M,
    GRIPPER_OPEN_M,
    PAD_THICKNESS_M,
    ROLLING_RADIUS_M,
    TRACK_M,
    WHEEL_JOINTS,
)

JOINTS = (*ARM_JOINTS, *FINGER_JOINTS, *WHEEL_JOINTS)

SKID_TRACK_M = TRACK_M * 1.56
"""Track of the ideal two-wheeled robot that turns like the skidding one (Husarion multiplies by 1.5)."""

_STANDING_RAD_S = 0.05
"""A wheel slower than this has come to a stand."""
_RETURN_PER_S = 10.0
"""How fast the controller of a standing wheel takes a deviation back."""

_GRIP_STIFFNESS_N_M = 2000.0
"""kp of the gripper actuator."""


@dataclass(frozen=True)
class Twist2:
    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0


class Body:
    """One robot in a world. Commands hold until the next one; call them once per control period."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, limits: MotionLimits) -> None:
        self.model, self.data, self.name, self.limits = model, data, robot, limits
        self._base = model.body(f"{robot}/base_link").id
        joints = [model.joint(f"{robot}/{name}") for name in JOINTS]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._arm_joints = [joint.id for joint in joints[:6]]
        self._wheels = np.array([model.actuator(f"{robot}/{name}").id for name in WHEEL_JOINTS])
        self._arm = np.array([model.actuator(f"{robot}/{name}").id for name in ARM_JOINTS])
        self._arm_act = np.array([model.actuator(f"{robot}/{name}").actadr[0] for name in ARM_JOINTS])
        gripper = model.actuator(f"{robot}/gripper")
        self._gripper, self._gripper_act = gripper.id, gripper.actadr[0]
        self._gyro = model.sensor(f"{robot}/gyro").adr[0]
        self._stand_rad: np.ndarray | None = None

    # -- sensors -----------------------------------------------------------------------------------

    @property
    def pose(self) -> Pose2:
        """Where the base stands, in the map frame."""
        x, y, _ = self.data.xpos[self._base]
        w, qx, qy, qz = self.data.xquat[self._base]
        yaw = math.atan2(2 * (w * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        return Pose2.model_construct(x_m=float(x), y_m=float(y), yaw_rad=yaw)

    @property
    def position_m(self) -> np.ndarray:
        """(3,) of base_link in the map frame."""
        return self.data.xpos[self._base]

    @property
    def quat_wxyz(self) -> np.ndarray:
        """(4,) of base_link in the map frame."""
        return self.data.xquat[self._base]

    @property
    def positions(self) -> np.ndarray:
        """(12,) joint positions in the order of JOINTS: rad, m for the fingers."""
        return self.data.qpos[self._qpos]

    @property
    def velocities(self) -> np.ndarray:
        """(12,) rad/s, m/s for the fingers."""
        return self.data.qvel[self._dof]

    @property
    def efforts(self) -> np.ndarray:
        """(12,) what the motors give: N m, N for the fingers."""
        return self.data.qfrc_actuator[self._dof]

    @property
    def arm(self) -> np.ndarray:
        """(6,) arm joint positions, rad."""
        return self.positions[:6]

    @property
    def arm_setpoint(self) -> np.ndarray:
        """(6,) where the arm's servos want the joints now, rad."""
        return self.data.act[self._arm_act].copy()

    @property
    def gripper_m(self) -> float:
        """Half the gap between the fingers."""
        left, right = self.positions[6:8]
        return float(left - right) / 2

    @property
    def gripper_speed_m_s(self) -> float:
        left, right = self.velocities[6:8]
        return float(left - right) / 2

    @property
    def arm_ranges(self) -> np.ndarray:
        """(6, 2) lowest and highest position of each arm joint, rad."""
        return self.model.jnt_range[self._arm_joints]

    @property
    def gripper_force_n(self) -> float:
        """Force of one finger; negative closes."""
        return float(self.data.actuator_force[self._gripper]) / 2

    @property
    def wheel_twist(self) -> Twist2:
        """Speed of the base as the wheels turn (slip included) and the gyro sees it."""
        left_f, right_f, left_r, right_r = self.velocities[8:]
        forward = (left_f + right_f + left_r + right_r) / 4 * ROLLING_RADIUS_M
        return Twist2(float(forward), float(self.data.sensordata[self._gyro + 2]))

    @property
    def wheel_power_w(self) -> float:
        """Mechanical power that the wheel motors give."""
        return float(np.abs(self.velocities[8:] * self.efforts[8:]).sum())

    # -- motors ------------------------------------------------------------------------------------

    def drive(self, twist: Twist2) -> None:
        """Turn the wheels for this speed of the base, within the limits; at zero they hold their place."""
        if twist == Twist2():
            self.data.ctrl[self._wheels] = self._standing()
            return
        self._stand_rad = None
        v = float(np.clip(twist.linear_m_s, -self.limits.linear_m_s, self.limits.linear_m_s))
        w = float(np.clip(twist.angular_rad_s, -self.limits.angular_rad_s, self.limits.angular_rad_s))
        left, right = v - w * SKID_TRACK_M / 2, v + w * SKID_TRACK_M / 2
        self.data.ctrl[self._wheels] = np.array([left, right, left, right]) / ROLLING_RADIUS_M

    def _standing(self) -> np.ndarray:
        """(4,) wheel speeds that stop the wheels and keep them where they stopped, whatever pushes."""
        positions, velocities = self.positions[8:], self.velocities[8:]
        if self._stand_rad is None:
            if np.abs(velocities).max() > _STANDING_RAD_S:
                return np.zeros(4)
            self._stand_rad = positions
        return _RETURN_PER_S * (self._stand_rad - positions)

    def move_arm(self, setpoint_rad: np.ndarray) -> None:
        """Bring the servos' set-points to `setpoint_rad` (6,) within one control period, if speeds allow."""
        speed = (setpoint_rad - self.data.act[self._arm_act]) / CONTROL_PERIOD_S
        self.data.ctrl[self._arm] = np.clip(speed, -self.limits.joint_rad_s, self.limits.joint_rad_s)

    def move_gripper(self, position_m: float, force_n: float, speed_m_s: float = 0.06) -> None:
        """Move the fingers towards `position_m`, pushing each with at most `force_n`.

        The set-point never runs ahead of the fingers by more than what gives that force.
        """
        goal = float(np.clip(position_m, GRIPPER_CLOSED_M - PAD_THICKNESS_M, GRIPPER_OPEN_M))
        reach = 2 * min(force_n, self.limits.gripper_force_n) / _GRIP_STIFFNESS_N_M
        here, setpoint = self.gripper_m, float(self.data.act[self._gripper_act])
        aim = float(np.clip(goal, here - reach, here + reach))
        self.data.ctrl[self._gripper] = np.clip((aim - setpoint) / CONTROL_PERIOD_S, -speed_m_s, speed_m_s)
