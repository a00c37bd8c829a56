"""The robot's motors and encoders in a MuJoCo world: what its drivers command, what its sensors read."""

import mujoco
import numpy as np

from rodeo.errors import ConfigError
from rodeo.lab.arm import ArmModel
from rodeo.lab.config import MotionLimits, Pose2
from rodeo.lab.geometry import Twist2
from rodeo.lab.motors import Motors
from rodeo.lab.world import WHEEL_JOINTS

__all__ = ["Body", "Twist2", "joint_names"]


def joint_names(arm: ArmModel) -> tuple[str, ...]:
    """All joints of a robot with this arm, in the order of its joint states: arm, fingers, wheels."""
    return (*arm.joints, *arm.fingers, *WHEEL_JOINTS)


class Body(Motors):
    """One robot in a world. Commands hold until the next one; call them once per control period.

    It keeps the arrays of `data`, which stay where they are for its life: asking for them costs more than
    reading them, fifty times a simulated second.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, limits: MotionLimits) -> None:
        """Raises ConfigError where the robot's MJCF has other actuators or sensors than its drivers know."""
        self.model, self.data, self.name, self.limits = model, data, robot, limits
        self.base = base = int(model.body(f"{robot}/base_link").id)
        """MuJoCo's number of base_link."""
        self.arm_model = arm = ArmModel.of(model, f"{robot}/")
        joints = [model.joint(f"{robot}/{name}") for name in joint_names(arm)]
        count = len(arm.joints)
        self.arm_columns, self.finger_columns = slice(0, count), slice(count, count + 2)
        """Of `positions`, `velocities` and `efforts`."""
        self.positions_at = qpos = np.array([joint.qposadr[0] for joint in joints], np.intc)
        """(n,) of `positions` in `mjData.qpos`."""
        self.velocities_at = dof = np.array([joint.dofadr[0] for joint in joints], np.intc)
        """(n,) of `velocities` and `efforts` in `mjData.qvel` and the like."""
        self._arm_qpos = qpos[self.arm_columns]
        motors = [model.actuator(f"{robot}/{name}") for name in arm.joints]
        self._arm_act = np.array([motor.actadr[0] for motor in motors], np.intc)
        gripper = model.actuator(f"{robot}/gripper")
        self._gripper = gripper.id
        servos, gyro = [*motors, gripper], model.sensor(f"{robot}/gyro")
        # Compiled code reads these without asking whether they are there.
        if any(motor.actadr[0] < 0 for motor in servos) or gyro.dim[0] != 3:
            raise ConfigError(
                "not a usable robot: arm and gripper need actuators that keep a set-point (intvelocity), and "
                "its sensor gyro has to be a gyro",
                robot=robot,
                without_set_point=[motor.name for motor in servos if motor.actadr[0] < 0],
                numbers_of_gyro=int(gyro.dim[0]),
            )
        self._position, self._velocity, self._force = data.qpos, data.qvel, data.qfrc_actuator
        self._activation = data.act
        self.position_m = data.xpos[base]
        """(3,) of base_link in the map frame; a view."""
        self.quat_wxyz = data.xquat[base]
        """(4,) of base_link in the map frame; a view."""
        wheels = slice(count + 2, None)
        super().__init__(
            data,
            base,
            arm=(self._arm_qpos, dof[self.arm_columns]),
            fingers=(qpos[self.finger_columns], dof[self.finger_columns]),
            wheels=(qpos[wheels], dof[wheels]),
            arm_motors=(np.array([motor.id for motor in motors], np.intc), self._arm_act),
            wheel_motors=np.array([model.actuator(f"{robot}/{name}").id for name in WHEEL_JOINTS], np.intc),
            gripper=(gripper.id, gripper.actadr[0]),
            yaw_rate=gyro.adr[0] + 2,
            limits=limits,
        )

    # -- what is asked for less than once in a control period -----------------------------------------

    @property
    def pose(self) -> Pose2:
        """Where the base stands, in the map frame."""
        x_m, y_m, yaw_rad = self.place
        return Pose2.model_construct(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)

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
    def gripper_force_n(self) -> float:
        """Force of one finger; negative closes."""
        return float(self.data.actuator_force[self._gripper]) / 2
