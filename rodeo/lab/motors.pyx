# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""A robot's motors and encoders in a MuJoCo world, as its drivers use them in each control period, in compiled code.

In numpy and Python each of these took one to three microseconds, most of it for calling numpy with four numbers.
"""

from libc.math cimport atan2, fabs

import numpy as np

from rodeo.lab.geometry import Twist2
from rodeo.lab.world import (
    CONTROL_PERIOD_S,
    GRIPPER_CLOSED_M,
    GRIPPER_OPEN_M,
    PAD_THICKNESS_M,
    ROLLING_RADIUS_M,
    TRACK_M,
)

SKID_TRACK_M = TRACK_M * 1.56
"""Track of the ideal two-wheeled robot that turns like the skidding one (Husarion multiplies by 1.5)."""

cdef enum:
    WHEELS = 4
cdef double _STANDING_RAD_S = 0.05
"""A wheel slower than this has come to a stand."""
cdef double _RETURN_PER_S = 10.0
"""How fast the controller of a standing wheel takes a deviation back."""
cdef double _GRIP_STIFFNESS_N_M = 2000.0
"""kp of the gripper actuator."""

# What the constants of other files are to C.
cdef double _period_s = CONTROL_PERIOD_S, _rolling_radius_m = ROLLING_RADIUS_M, _skid_track_m = SKID_TRACK_M
cdef double _open_m = GRIPPER_OPEN_M, _closed_m = GRIPPER_CLOSED_M - PAD_THICKNESS_M


cdef class Motors:
    """Reads and writes the arrays of a world, which stay where they are for its life. Indices are `intc`.

    Args:
        base: MuJoCo's number of base_link.
        arm, fingers, wheels: (n,), (2,), (4,) of the joints' positions in `qpos`, and of their speeds in `qvel`.
        arm_motors, wheel_motors: (n,), (4,) of their actuators in `ctrl`; the arm's activations in `act`.
        gripper: of the gripper's actuator in `ctrl`, and of its activation in `act`.
        yaw_rate: of the gyro's third number in `sensordata`.
        limits: what the motors may do, a `MotionLimits`.
    """

    cdef const double[::1] _position, _velocity, _force, _activation, _sensed, _place_m, _quat_wxyz
    cdef double[::1] _control
    cdef const int[::1] _arm_qpos, _finger_qpos, _finger_dof, _wheel_qpos, _wheel_dof
    cdef const int[::1] _arm_motors, _arm_act, _wheel_motors
    cdef int _gripper_motor, _gripper_act, _yaw_rate
    cdef double _linear_m_s, _angular_rad_s, _joint_rad_s, _gripper_force_n
    cdef bint _stands
    cdef double _stand_rad[WHEELS]

    def __init__(self, data, int base, arm, fingers, wheels, arm_motors, wheel_motors, gripper, int yaw_rate, limits):
        self._position, self._velocity, self._force = data.qpos, data.qvel, data.qfrc_actuator
        self._control, self._activation, self._sensed = data.ctrl, data.act, data.sensordata
        self._place_m, self._quat_wxyz = data.xpos[base], data.xquat[base]
        self._arm_qpos, _ = arm
        self._finger_qpos, self._finger_dof = fingers
        self._wheel_qpos, self._wheel_dof = wheels
        self._arm_motors, self._arm_act = arm_motors
        self._wheel_motors = wheel_motors
        self._gripper_motor, self._gripper_act = gripper
        self._yaw_rate = yaw_rate
        self._linear_m_s, self._angular_rad_s = limits.linear_m_s, limits.angular_rad_s
        self._joint_rad_s, self._gripper_force_n = limits.joint_rad_s, limits.gripper_force_n
        self._stands = False

    # -- sensors -----------------------------------------------------------------------------------

    @property
    def place(self):
        """Where the base stands, in the map frame: x and y in m, yaw in rad."""
        cdef double w = self._quat_wxyz[0], x = self._quat_wxyz[1], y = self._quat_wxyz[2], z = self._quat_wxyz[3]
        return self._place_m[0], self._place_m[1], atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    @property
    def gripper_m(self):
        """Half the gap between the fingers."""
        return self._gap_m()

    cdef double _gap_m(self):
        return (self._position[self._finger_qpos[0]] - self._position[self._finger_qpos[1]]) / 2

    @property
    def gripper_speed_m_s(self):
        return (self._velocity[self._finger_dof[0]] - self._velocity[self._finger_dof[1]]) / 2

    @property
    def wheel_twist(self):
        """Speed of the base as the wheels turn (slip included) and the gyro sees it."""
        cdef double turning_rad_s = 0
        cdef int k
        for k in range(WHEELS):
            turning_rad_s += self._velocity[self._wheel_dof[k]]
        return Twist2(turning_rad_s / WHEELS * _rolling_radius_m, self._sensed[self._yaw_rate])

    @property
    def wheel_power_w(self):
        """Mechanical power that the wheel motors give."""
        cdef double power_w = 0
        cdef int k
        for k in range(WHEELS):
            power_w += fabs(self._velocity[self._wheel_dof[k]] * self._force[self._wheel_dof[k]])
        return power_w

    def arm_within(self, const double[::1] wanted_rad, const double[::1] tolerance_rad):
        """Whether each arm joint is at most as far from where it is wanted; both (len(arm_model.joints),).

        Raises ValueError for another number of joints.
        """
        self._require_arm(wanted_rad)
        self._require_arm(tolerance_rad)
        for k in range(self._arm_qpos.shape[0]):
            if not fabs(self._position[self._arm_qpos[k]] - wanted_rad[k]) <= tolerance_rad[k]:
                return False
        return True

    # -- motors ------------------------------------------------------------------------------------

    def drive(self, twist):
        """Turn the wheels for this speed of the base, within the limits; at zero they hold their place."""
        cdef int k
        cdef double linear_m_s, angular_rad_s
        linear_m_s, angular_rad_s = twist
        if linear_m_s == 0 and angular_rad_s == 0:
            self._stand()
            return
        self._stands = False
        cdef double v = _clip(linear_m_s, self._linear_m_s) / _rolling_radius_m
        cdef double w = _clip(angular_rad_s, self._angular_rad_s) * _skid_track_m / 2 / _rolling_radius_m
        for k in range(WHEELS):
            self._control[self._wheel_motors[k]] = v + w if k % 2 else v - w

    cdef void _stand(self):
        """Stop the wheels and keep them where they stopped, whatever pushes."""
        cdef int k
        if not self._stands:
            for k in range(WHEELS):
                if fabs(self._velocity[self._wheel_dof[k]]) > _STANDING_RAD_S:
                    for k in range(WHEELS):
                        self._control[self._wheel_motors[k]] = 0
                    return
            self._stands = True
            for k in range(WHEELS):
                self._stand_rad[k] = self._position[self._wheel_qpos[k]]
        for k in range(WHEELS):
            self._control[self._wheel_motors[k]] = _RETURN_PER_S * (
                self._stand_rad[k] - self._position[self._wheel_qpos[k]]
            )

    def move_arm(self, const double[::1] setpoint_rad):
        """Bring the servos' set-points to `setpoint_rad` in one control period, if speeds allow.

        Raises ValueError for another number of joints.
        """
        self._require_arm(setpoint_rad)
        for k in range(self._arm_motors.shape[0]):
            self._control[self._arm_motors[k]] = _clip(
                (setpoint_rad[k] - self._activation[self._arm_act[k]]) / _period_s, self._joint_rad_s
            )

    cdef int _require_arm(self, const double[::1] angles_rad) except -1:
        if angles_rad.shape[0] != self._arm_motors.shape[0]:
            raise ValueError(f"{angles_rad.shape[0]} angles for the {self._arm_motors.shape[0]} joints of an arm")
        return 0

    def move_gripper(self, double position_m, double force_n, double speed_m_s=0.06):
        """Move the fingers towards `position_m`, pushing each with at most `force_n`.

        The set-point never runs ahead of the fingers by more than what gives that force.
        """
        cdef double goal_m = min(max(position_m, _closed_m), _open_m)
        cdef double reach_m = 2 * min(force_n, self._gripper_force_n) / _GRIP_STIFFNESS_N_M
        cdef double here_m = self._gap_m()
        cdef double aim_m = here_m + _clip(goal_m - here_m, reach_m)
        self._control[self._gripper_motor] = _clip(
            (aim_m - self._activation[self._gripper_act]) / _period_s, speed_m_s
        )


cdef inline double _clip(double value, double limit):
    return min(max(value, -limit), limit)
