"""The robot's motors and encoders in a MuJoCo world: what its drivers command, what its sensors read."""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from rodeo.lab.arm import ArmModel
from rodeo.lab.config import MotionLimits, Pose2
from rodeo.lab.geometry import yaw_of
from rodeo.lab.world import (
    CONTROL_PERIOD_S,
    GRIPPER_CLOSED_M,
    GRIPPER_OPEN_M,
    PAD_THICKNESS_M,
    ROLLING_RADIUS_M,
    TRACK_M,
    WHEEL_JOINTS,
)

SKID_TRACK_M = TRACK_M * 1.56
"""Track of the ideal two-wheeled robot that turns like the skidding one (Husarion multiplies by 1.5)."""

_STANDING_RAD_S = 0.05
"""A wheel slower than this has come to a stand."""
_RETURN_PER_S = 10.0
"""How fast the controller of a standing wheel takes a deviation back."""

_GRIP_STIFFNESS_N_M = 2000.0
"""kp of the gripper actuator."""


class Twist2(NamedTuple):
    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0


def joint_names(arm: ArmModel) -> tuple[str, ...]:
    """All joints of a robot with this arm, in the order of its joint states: arm, fingers, wheels."""
    return (*arm.joints, *arm.fingers, *WHEEL_JOINTS)


class Body:
    """One robot in a world. Commands hold until the next one; call them once per control period.

    It keeps the arrays of `data`, which stay where they are for its life: asking for them costs more than
    reading them, fifty times a simulated second.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, limits: MotionLimits) -> None:
        self.model, self.data, self.name, self.limits = model, data, robot, limits
        self.base = model.body(f"{robot}/base_link").id
        """MuJoCo's number of base_link."""
        self.arm_model = arm = ArmModel.of(model, f"{robot}/")
        joints = [model.joint(f"{robot}/{name}") for name in joint_names(arm)]
        count = len(arm.joints)
        self.arm_columns, self.finger_columns = slice(0, count), slice(count, count + 2)
        """Of `positions`, `velocities` and `efforts`."""
        self.positions_at = qpos = np.array([joint.qposadr[0] for joint in joints])
        """(n,) of `positions` in `mjData.qpos`."""
        self.velocities_at = dof = np.array([joint.dofadr[0] for joint in joints])
        """(n,) of `velocities` and `efforts` in `mjData.qvel` and the like."""
        self._arm_qpos, self._finger_qpos = qpos[self.arm_columns], qpos[self.finger_columns]
        self._wheel_qpos, self._wheel_dof = qpos[count + 2 :], dof[count + 2 :]
        self._finger_dof = dof[self.finger_columns]
        self._wheels = np.array([model.actuator(f"{robot}/{name}").id for name in WHEEL_JOINTS])
        self._arm = np.array([model.actuator(f"{robot}/{name}").id for name in arm.joints])
        self._arm_act = np.array([model.actuator(f"{robot}/{name}").actadr[0] for name in arm.joints])
        gripper = model.actuator(f"{robot}/gripper")
        self._gripper, self._gripper_act = gripper.id, gripper.actadr[0]
        self._yaw_rate = model.sensor(f"{robot}/gyro").adr[0] + 2
        self._position, self._velocity, self._force = data.qpos, data.qvel, data.qfrc_actuator
        self._control, self._activation, self._sensed = data.ctrl, data.act, data.sensordata
        self._stand_rad: list[float] | None = None
        self.position_m = data.xpos[self.base]
        """(3,) of base_link in the map frame; a view."""
        self.quat_wxyz = data.xquat[self.base]
        """(4,) of base_link in the map frame; a view."""

    # -- sensors -----------------------------------------------------------------------------------

    @property
    def pose(self) -> Pose2:
        """Where the base stands, in the map frame."""
        x_m, y_m, yaw_rad = self.place
        return Pose2.model_construct(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)

    @property
    def place(self) -> tuple[float, float, float]:
        """The same for who asks fifty times a second: x and y in m, yaw in rad."""
        x_m, y_m, _ = self.position_m.tolist()
        return x_m, y_m, yaw_of(*self.quat_wxyz.tolist())

    @property
    def positions(self) -> np.ndarray:
        """(n,) joint positions in the order of `joint_names`: rad, m for the fingers."""
        return self._position[self.positions_at]

    @property
    def velocities(self) -> np.ndarray:
        """(n,) rad/s, m/s for the fingers."""
        return self._velocity[self.velocities_at]

    @property
    def efforts(self) -> np.ndarray:
        """(n,) what the motors give: N m, N for the fingers."""
        return self._force[self.velocities_at]

    @property
    def arm(self) -> np.ndarray:
        """(len(arm_model.joints),) arm joint positions, rad."""
        return self._position[self._arm_qpos]

    @property
    def arm_setpoint(self) -> np.ndarray:
        """(len(arm_model.joints),) where the arm's servos want the joints now, rad."""
        return self._activation[self._arm_act]

    @property
    def gripper_m(self) -> float:
        """Half the gap between the fingers."""
        left, right = self._position[self._finger_qpos].tolist()
        return (left - right) / 2

    @property
    def gripper_speed_m_s(self) -> float:
        left, right = self._velocity[self._finger_dof].tolist()
        return (left - right) / 2

    @property
    def gripper_force_n(self) -> float:
        """Force of one finger; negative closes."""
        return float(self.data.actuator_force[self._gripper]) / 2

    @property
    def wheel_twist(self) -> Twist2:
        """Speed of the base as the wheels turn (slip included) and the gyro sees it."""
        forward = sum(self._velocity[self._wheel_dof].tolist()) / 4 * ROLLING_RADIUS_M
        return Twist2(forward, self._sensed.item(self._yaw_rate))

    @property
    def wheel_power_w(self) -> float:
        """Mechanical power that the wheel motors give."""
        speeds = self._velocity[self._wheel_dof].tolist()
        return sum(abs(v * f) for v, f in zip(speeds, self._force[self._wheel_dof].tolist(), strict=True))

    # -- motors ------------------------------------------------------------------------------------

    def drive(self, twist: Twist2) -> None:
        """Turn the wheels for this speed of the base, within the limits; at zero they hold their place."""
        if twist == Twist2():
            self._control[self._wheels] = self._standing()
            return
        self._stand_rad = None
        v = _clip(twist.linear_m_s, self.limits.linear_m_s) / ROLLING_RADIUS_M
        w = _clip(twist.angular_rad_s, self.limits.angular_rad_s) * SKID_TRACK_M / 2 / ROLLING_RADIUS_M
        self._control[self._wheels] = (v - w, v + w, v - w, v + w)

    def _standing(self) -> Sequence[float]:
        """(4,) wheel speeds that stop the wheels and keep them where they stopped, whatever pushes."""
        positions = self._position[self._wheel_qpos].tolist()
        if self._stand_rad is None:
            if max(map(abs, self._velocity[self._wheel_dof].tolist())) > _STANDING_RAD_S:
                return (0.0,) * 4
            self._stand_rad = positions
        return [_RETURN_PER_S * (stand - now) for stand, now in zip(self._stand_rad, positions, strict=True)]

    def move_arm(self, setpoint_rad: np.ndarray) -> None:
        """Bring the servos' set-points to `setpoint_rad` in one control period, if speeds allow."""
        speed = (setpoint_rad - self._activation[self._arm_act]) / CONTROL_PERIOD_S
        limit = self.limits.joint_rad_s
        self._control[self._arm] = np.minimum(np.maximum(speed, -limit), limit)

    def move_gripper(self, position_m: float, force_n: float, speed_m_s: float = 0.06) -> None:
        """Move the fingers towards `position_m`, pushing each with at most `force_n`.

        The set-point never runs ahead of the fingers by more than what gives that force.
        """
        goal = min(max(position_m, GRIPPER_CLOSED_M - PAD_THICKNESS_M), GRIPPER_OPEN_M)
        reach = 2 * min(force_n, self.limits.gripper_force_n) / _GRIP_STIFFNESS_N_M
        here, setpoint = self.gripper_m, self._activation.item(self._gripper_act)
        aim = here + _clip(goal - here, reach)
        self._control[self._gripper] = _clip((aim - setpoint) / CONTROL_PERIOD_S, speed_m_s)


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
