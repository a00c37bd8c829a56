"""The robot's motors and encoders in a MuJoCo world: what its drivers command, what its sensors read.

Drivers ask for four or six numbers in each control period. To read and write them one by one through
memoryviews of MuJoCo's arrays takes a third of the time that NumPy takes. Sums are written out, because from
Python 3.12 on `sum` rounds otherwise: the same commands give the same world with every Python.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from rodeo.errors import ConfigError
from rodeo.lab.arm import ArmModel
from rodeo.lab.config import MotionLimits, Pose2
from rodeo.lab.geometry import Twist2, yaw_of
from rodeo.lab.world import (
    CONTROL_PERIOD_S,
    GRIPPER_CLOSED_M,
    GRIPPER_OPEN_M,
    PAD_THICKNESS_M,
    ROLLING_RADIUS_M,
    TRACK_M,
    WHEEL_JOINTS,
)

__all__ = ["Body", "Twist2", "joint_names", "numbers"]

SKID_TRACK_M = TRACK_M * 1.56
"""Track of the ideal two-wheeled robot that turns like the skidding one (Husarion multiplies by 1.5)."""
_STANDING_RAD_S = 0.05
"""A wheel slower than this has come to a stand."""
_RETURN_PER_S = 10.0
"""How fast the controller of a standing wheel takes a deviation back."""
_GRIP_STIFFNESS_N_M = 2000.0
"""kp of the gripper actuator."""


def numbers(array: np.ndarray) -> "memoryview[float]":
    """The numbers of a float64 array of any shape, one after the other, to read and write one by one."""
    return array.data.cast("B").cast("d")


def joint_names(arm: ArmModel) -> tuple[str, ...]:
    """All joints of a robot with this arm, in the order of its joint states: arm, fingers, wheels."""
    return (*arm.joints, *arm.fingers, *WHEEL_JOINTS)


def _clip(value: float, limit: float) -> float:
    # `min` and `max` are calls, which take three times as long.
    return -limit if value < -limit else limit if value > limit else value


class Wheels:
    """Motors and encoders of the four wheels, and the gyro."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, limits: MotionLimits) -> None:
        joints = [model.joint(f"{robot}/{name}") for name in WHEEL_JOINTS]
        self._limits = limits
        self._angle, self._speed = numbers(data.qpos), numbers(data.qvel)
        self._torque, self._control = numbers(data.qfrc_actuator), numbers(data.ctrl)
        self._sensed = numbers(data.sensordata)
        self._angles = [int(joint.qposadr[0]) for joint in joints]
        self._dofs = [int(joint.dofadr[0]) for joint in joints]
        self._motors = [int(model.actuator(f"{robot}/{name}").id) for name in WHEEL_JOINTS]
        self._yaw_rate = int(model.sensor(f"{robot}/gyro").adr[0]) + 2
        self._stand_rad: list[float] | None = None
        """Where the wheels came to a stand; None while they turn."""

    @property
    def twist(self) -> Twist2:
        """See `Body.wheel_twist`."""
        a, b, c, d = self._dofs
        speed = self._speed
        turning_rad_s = 0.0 + speed[a] + speed[b] + speed[c] + speed[d]
        return Twist2(turning_rad_s / 4 * ROLLING_RADIUS_M, self._sensed[self._yaw_rate])

    @property
    def power_w(self) -> float:
        """Mechanical power that the motors give."""
        speed, torque = self._speed, self._torque
        power_w = 0.0
        for dof in self._dofs:
            power_w += abs(speed[dof] * torque[dof])
        return power_w

    def drive(self, twist: Twist2) -> None:
        """See `Body.drive`."""
        linear_m_s, angular_rad_s = twist
        if linear_m_s == 0 and angular_rad_s == 0:
            self._stand()
            return
        self._stand_rad = None
        v = _clip(linear_m_s, self._limits.linear_m_s) / ROLLING_RADIUS_M
        w = _clip(angular_rad_s, self._limits.angular_rad_s) * SKID_TRACK_M / 2 / ROLLING_RADIUS_M
        self._turn((v - w, v + w, v - w, v + w))

    def _turn(self, speeds_rad_s: Sequence[float]) -> None:
        control = self._control
        for wheel, speed_rad_s in zip(self._motors, speeds_rad_s, strict=True):
            control[wheel] = speed_rad_s

    def _stand(self) -> None:
        """Stop the wheels and keep them where they stopped, whatever pushes."""
        angle, speed = self._angle, self._speed
        if self._stand_rad is None:
            if any(abs(speed[dof]) > _STANDING_RAD_S for dof in self._dofs):
                self._turn((0.0, 0.0, 0.0, 0.0))
                return
            self._stand_rad = [angle[at] for at in self._angles]
        self._turn([
            _RETURN_PER_S * (stood_rad - angle[at])
            for stood_rad, at in zip(self._stand_rad, self._angles, strict=True)
        ])  # fmt: skip


class Gripper:
    """Motor and encoders of the two fingers."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, arm: ArmModel) -> None:
        motor = model.actuator(f"{robot}/gripper")
        left, right = (model.joint(f"{robot}/{name}") for name in arm.fingers)
        self._angle, self._speed = numbers(data.qpos), numbers(data.qvel)
        self._setpoint, self._control = numbers(data.act), numbers(data.ctrl)
        self._forces = data.actuator_force
        self._motor, self._act = int(motor.id), int(motor.actadr[0])
        self._left, self._right = int(left.qposadr[0]), int(right.qposadr[0])
        self._left_dof, self._right_dof = int(left.dofadr[0]), int(right.dofadr[0])

    @property
    def force_n(self) -> float:
        """Force of one finger; negative closes."""
        return float(self._forces[self._motor]) / 2

    @property
    def half_gap_m(self) -> float:
        return (self._angle[self._left] - self._angle[self._right]) / 2

    @property
    def speed_m_s(self) -> float:
        return (self._speed[self._left_dof] - self._speed[self._right_dof]) / 2

    def move(self, position_m: float, force_n: float, speed_m_s: float) -> None:
        """See `Body.move_gripper`."""
        goal_m = min(max(position_m, GRIPPER_CLOSED_M - PAD_THICKNESS_M), GRIPPER_OPEN_M)
        reach_m = 2 * force_n / _GRIP_STIFFNESS_N_M
        here_m = self.half_gap_m
        aim_m = here_m + _clip(goal_m - here_m, reach_m)
        self._control[self._motor] = _clip((aim_m - self._setpoint[self._act]) / CONTROL_PERIOD_S, speed_m_s)


class Arm:
    """Servos and encoders of the arm's joints."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, arm: ArmModel) -> None:
        motors = [model.actuator(f"{robot}/{name}") for name in arm.joints]
        joints = [model.joint(f"{robot}/{name}") for name in arm.joints]
        self._qpos, self._act = data.qpos, data.act
        self._angle = numbers(data.qpos)
        self._setpoint, self._control = numbers(data.act), numbers(data.ctrl)
        self._angles = [int(joint.qposadr[0]) for joint in joints]
        self._servos = [(int(motor.id), int(motor.actadr[0])) for motor in motors]
        # The same indexes as an array, to read all numbers at once.
        self._angles_at = np.array(self._angles, np.intc)
        self._setpoints_at = np.array([at for _, at in self._servos], np.intc)

    @property
    def positions_rad(self) -> np.ndarray:
        return self._qpos[self._angles_at]

    @property
    def setpoint_rad(self) -> np.ndarray:
        return self._act[self._setpoints_at]

    def is_within(self, wanted_rad: np.ndarray, tolerance_rad: np.ndarray) -> bool:
        """See `Body.arm_within`."""
        angle = self._angle
        wanted, tolerances = self._each(wanted_rad), self._each(tolerance_rad)
        for at, want_rad, most_rad in zip(self._angles, wanted, tolerances, strict=True):
            if not abs(angle[at] - want_rad) <= most_rad:
                return False
        return True

    def move(self, setpoint_rad: np.ndarray, most_rad_s: float) -> None:
        """See `Body.move_arm`."""
        control, setpoint = self._control, self._setpoint
        for (motor, at), wanted_rad in zip(self._servos, self._each(setpoint_rad), strict=True):
            control[motor] = _clip((wanted_rad - setpoint[at]) / CONTROL_PERIOD_S, most_rad_s)

    def _each(self, angles_rad: np.ndarray) -> list[float]:
        if len(angles_rad) != len(self._servos):
            raise ValueError(f"{len(angles_rad)} angles for the {len(self._servos)} joints of an arm")
        angles: list[float] = angles_rad.tolist()
        return angles


class Body:
    """One robot in a world. Commands hold until the next one; call them once per control period.

    Its parts keep the arrays of `data`, which stay where they are for its life: asking for them costs more
    than reading them, fifty times a simulated second.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, limits: MotionLimits) -> None:
        """Raises ConfigError where the robot's MJCF has other actuators or sensors than its drivers know."""
        self.model, self.data, self.name, self.limits = model, data, robot, limits
        self.base = base = int(model.body(f"{robot}/base_link").id)
        """MuJoCo's number of base_link."""
        self.arm_model = arm = ArmModel.of(model, f"{robot}/")
        _check_motors(model, robot, arm)
        joints = [model.joint(f"{robot}/{name}") for name in joint_names(arm)]
        self.positions_at = np.array([joint.qposadr[0] for joint in joints], np.intc)
        """(n,) of `positions` in `mjData.qpos`."""
        self.velocities_at = np.array([joint.dofadr[0] for joint in joints], np.intc)
        """(n,) of `velocities` and `efforts` in `mjData.qvel` and the like."""
        self._wheels = Wheels(model, data, robot, limits)
        self._gripper = Gripper(model, data, robot, arm)
        self._arm = Arm(model, data, robot, arm)
        self.position_m = data.xpos[base]
        """(3,) of base_link in the map frame; a view."""
        self.quat_wxyz = data.xquat[base]
        """(4,) of base_link in the map frame; a view."""
        # The same memory, to read single numbers.
        self._place = numbers(self.position_m), numbers(self.quat_wxyz)

    # -- what is asked for less than once in a control period -----------------------------------------

    @property
    def pose(self) -> Pose2:
        """Where the base stands, in the map frame."""
        x_m, y_m, yaw_rad = self.place
        return Pose2.model_construct(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)

    @property
    def arm_columns(self) -> slice:
        """Columns of `positions`, `velocities` and `efforts`."""
        return slice(0, len(self.arm_model.joints))

    @property
    def finger_columns(self) -> slice:
        """The fingers' columns of the same."""
        count = len(self.arm_model.joints)
        return slice(count, count + 2)

    @property
    def positions(self) -> np.ndarray:
        """(n,) joint positions in the order of `joint_names`: rad, m for the fingers."""
        return self.data.qpos[self.positions_at]

    @property
    def velocities(self) -> np.ndarray:
        """(n,) rad/s, m/s for the fingers."""
        return self.data.qvel[self.velocities_at]

    @property
    def efforts(self) -> np.ndarray:
        """(n,) what the motors give: N m, N for the fingers."""
        return self.data.qfrc_actuator[self.velocities_at]

    @property
    def arm(self) -> np.ndarray:
        """(len(arm_model.joints),) arm joint positions, rad."""
        return self._arm.positions_rad

    @property
    def arm_setpoint(self) -> np.ndarray:
        """(len(arm_model.joints),) where the arm's servos want the joints now, rad."""
        return self._arm.setpoint_rad

    @property
    def gripper_force_n(self) -> float:
        """Force of one finger; negative closes."""
        return self._gripper.force_n

    # -- sensors, as the drivers read them in each control period --------------------------------------

    @property
    def place(self) -> tuple[float, float, float]:
        """Where the base stands, in the map frame: x and y in m, yaw in rad."""
        at, turn = self._place
        return at[0], at[1], yaw_of(turn[0], turn[1], turn[2], turn[3])

    @property
    def gripper_m(self) -> float:
        """Half the gap between the fingers."""
        return self._gripper.half_gap_m

    @property
    def gripper_speed_m_s(self) -> float:
        return self._gripper.speed_m_s

    @property
    def wheel_twist(self) -> Twist2:
        """Speed of the base as the wheels turn (slip included) and the gyro sees it."""
        return self._wheels.twist

    @property
    def wheel_power_w(self) -> float:
        """Mechanical power that the wheel motors give."""
        return self._wheels.power_w

    def arm_within(self, wanted_rad: np.ndarray, tolerance_rad: np.ndarray) -> bool:
        """Whether each arm joint is at most as far from where it is wanted; both (len(arm_model.joints),).

        Raises ValueError for another number of joints.
        """
        return self._arm.is_within(wanted_rad, tolerance_rad)

    # -- motors ------------------------------------------------------------------------------------

    def drive(self, twist: Twist2) -> None:
        """Turn the wheels for this speed of the base, within the limits; at zero they hold their place."""
        self._wheels.drive(twist)

    def move_arm(self, setpoint_rad: np.ndarray) -> None:
        """Bring the servos' set-points to `setpoint_rad` in one control period, if speeds allow.

        Raises ValueError for another number of joints.
        """
        self._arm.move(setpoint_rad, self.limits.joint_rad_s)

    def move_gripper(self, position_m: float, force_n: float, speed_m_s: float = 0.06) -> None:
        """Move the fingers towards `position_m`, pushing each with at most `force_n`.

        The set-point never runs ahead of the fingers by more than what gives that force.
        """
        self._gripper.move(position_m, min(force_n, self.limits.gripper_force_n), speed_m_s)


def _check_motors(model: mujoco.MjModel, robot: str, arm: ArmModel) -> None:
    servos = [model.actuator(f"{robot}/{name}") for name in (*arm.joints, "gripper")]
    gyro = model.sensor(f"{robot}/gyro")
    # An index of -1 would read another actuator's set-point.
    if any(motor.actadr[0] < 0 for motor in servos) or gyro.dim[0] != 3:
        raise ConfigError(
            "not a usable robot: arm and gripper need actuators that keep a set-point (intvelocity), and "
            "its sensor gyro has to be a gyro",
            robot=robot,
            without_set_point=[motor.name for motor in servos if motor.actadr[0] < 0],
            numbers_of_gyro=int(gyro.dim[0]),
        )
