"""Dead reckoning from wheels and gyro, with the errors that both have."""

import math

import numpy as np

from rodeo.lab.body import Twist2
from rodeo.lab.config import NoiseConfig, Pose2
from rodeo.lab.world import CONTROL_PERIOD_S

STANDING_M_S = 0.002
"""Slower than this by its encoders the base stands, and the gyro is not believed (zero-velocity update)."""


class Odometry:
    """Pose of the base in frame `odom`, which is the map when the world is new and drifts away from it."""

    def __init__(self, start: Pose2, noise: NoiseConfig, chance: np.random.Generator) -> None:
        self.x_m, self.y_m, self.yaw_rad = start.x_m, start.y_m, start.yaw_rad
        self.twist = Twist2()
        """As measured over the last control period."""
        self._chance = chance
        self._scale = 1 + noise.wheel_scale * self._chance.standard_normal()
        self._bias_rad_s = noise.gyro_bias_rad_s * self._chance.standard_normal()
        self._noise_rad_s = noise.gyro_rad_s
        self._noise: list[float] = []

    def advance(self, true: Twist2) -> None:
        """Reckon one control period in which perfect wheels and a perfect gyro would have measured `true`."""
        self.twist = self._measure(true)
        middle = self.yaw_rad + self.twist.angular_rad_s * CONTROL_PERIOD_S / 2
        way_m = self.twist.linear_m_s * CONTROL_PERIOD_S
        self.x_m += math.cos(middle) * way_m
        self.y_m += math.sin(middle) * way_m
        self.yaw_rad += self.twist.angular_rad_s * CONTROL_PERIOD_S

    def _measure(self, true: Twist2) -> Twist2:
        turning = abs(true.angular_rad_s) > STANDING_M_S
        if abs(true.linear_m_s) < STANDING_M_S and not turning:
            return Twist2()
        if not self._noise:
            # Drawn ahead: one call per control period would cost as much as the reckoning.
            self._noise = (self._noise_rad_s * self._chance.standard_normal(256)).tolist()
        return Twist2(
            true.linear_m_s * self._scale, true.angular_rad_s + self._bias_rad_s + self._noise.pop()
        )
