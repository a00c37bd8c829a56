"""The world as it was at the end of the last control periods, until it is published.

What moves is published in each period, and made from many of them at once: arrays of one period are so small
that calling numpy takes most of the time.
"""

from __future__ import annotations

import numpy as np

from services.robot_sim.simulation import Simulation

XYZW = np.array([1, 2, 3, 0])
"""ROS's order of a quaternion in MuJoCo's."""
_MOST = 10
_UNDERGROUND_M = -1.0


class Periods:
    """Rows of arrays, one for each period since `clear`. For the simulation's thread, between two periods."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, data = simulation, simulation.data
        self.count = 0
        self._time_ns = np.empty(_MOST, np.int64)
        self._reckoned = np.empty((_MOST, len(simulation.robots), 5))
        self._sources = (
            data.qpos, data.qvel, data.qfrc_actuator, data.xpos, data.xquat, data.xmat
        )  # fmt: skip
        self._rows = [np.empty((_MOST, *source.shape)) for source in self._sources]
        self._captured = list(simulation.things.captured)
        self._tracked = np.array(list(simulation.things.captured.values()), int)

    @property
    def full(self) -> bool:
        return self.count == _MOST

    def take(self) -> int:
        """Keep the world as it is now; the number of its row. Not when it is `full`."""
        row = self.count
        self.count += 1
        self._time_ns[row] = self._simulation.time_ns
        for rows, source in zip(self._rows, self._sources, strict=True):
            rows[row] = source
        for number, robot in enumerate(self._simulation.robots.values()):
            o = robot.odometry
            self._reckoned[row, number] = o.x_m, o.y_m, o.yaw_rad, *o.twist
        return row

    def clear(self) -> None:
        """Everything is published."""
        self.count = 0

    @property
    def time_ns(self) -> np.ndarray:
        """(k,) int64"""
        return self._time_ns[: self.count]

    @property
    def reckoned(self) -> np.ndarray:
        """(k, robots, 5): x and y in m and yaw in rad in the frame odom, as the wheels have it, and how fast:
        m/s forwards, rad/s."""
        return self._reckoned[: self.count]

    @property
    def positions(self) -> np.ndarray:
        """(k, nq) `mjData.qpos`"""
        return self._rows[0][: self.count]

    @property
    def velocities(self) -> np.ndarray:
        """(k, nv) `mjData.qvel`"""
        return self._rows[1][: self.count]

    @property
    def efforts(self) -> np.ndarray:
        """(k, nv) `mjData.qfrc_actuator`"""
        return self._rows[2][: self.count]

    @property
    def places_m(self) -> np.ndarray:
        """(k, bodies, 3) `mjData.xpos`"""
        return self._rows[3][: self.count]

    @property
    def quaternions(self) -> np.ndarray:
        """(k, bodies, 4) `mjData.xquat`: w, x, y, z"""
        return self._rows[4][: self.count]

    @property
    def turns(self) -> np.ndarray:
        """(k, bodies, 9) `mjData.xmat`"""
        return self._rows[5][: self.count]

    def poses(self, bodies: np.ndarray) -> np.ndarray:
        """(k, n, 7) x, y, z in m, qx, qy, qz, qw in the map of n bodies."""
        poses = np.empty((self.count, len(bodies), 7))
        poses[..., :3] = self.places_m[:, bodies]
        poses[..., 3:] = self.quaternions[:, bodies[:, None], XYZW]
        return poses

    def captured(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """The n bodies that motion capture tracks, their poses (k, n, 7), and which it sees (k, n): what is
        under the floor is not in the lab."""
        poses = self.poses(self._tracked)
        return self._captured, poses, poses[..., 2] >= _UNDERGROUND_M
