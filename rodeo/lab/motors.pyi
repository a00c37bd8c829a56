"""See motors.pyx."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from rodeo.lab.config import MotionLimits
from rodeo.lab.geometry import Twist2

SKID_TRACK_M: float

class Motors:
    def __init__(
        self,
        data: mujoco.MjData,
        base: int,
        arm: tuple[NDArray[np.intc], NDArray[np.intc]],
        fingers: tuple[NDArray[np.intc], NDArray[np.intc]],
        wheels: tuple[NDArray[np.intc], NDArray[np.intc]],
        arm_motors: tuple[NDArray[np.intc], NDArray[np.intc]],
        wheel_motors: NDArray[np.intc],
        gripper: tuple[int, int],
        yaw_rate: int,
        limits: MotionLimits,
    ) -> None: ...
    @property
    def place(self) -> tuple[float, float, float]: ...
    @property
    def gripper_m(self) -> float: ...
    @property
    def gripper_speed_m_s(self) -> float: ...
    @property
    def wheel_twist(self) -> Twist2: ...
    @property
    def wheel_power_w(self) -> float: ...
    def arm_within(self, wanted_rad: NDArray[np.float64], tolerance_rad: NDArray[np.float64]) -> bool: ...
    def drive(self, twist: Twist2) -> None: ...
    def move_arm(self, setpoint_rad: NDArray[np.float64]) -> None: ...
    def move_gripper(self, position_m: float, force_n: float, speed_m_s: float = 0.06) -> None: ...
