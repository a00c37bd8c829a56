"""What is published of the world as it is at the end of a control period."""

import math

import mujoco
import numpy as np

from rodeo.chance import Moments
from rodeo.config import Site
from rodeo.lab.sensors import DepthCamera, Lidar
from rodeo.lab.world import CAMERA_SITE, LIDAR_SITE, scale_weight_n
from services.robot_sim.simulation import PROCESS, SimRobot, Simulation

XYZW = np.array([1, 2, 3, 0])
"""ROS's order of a quaternion in MuJoCo's."""
_UNDERGROUND_M = -1.0
_PRESENCE_MAX_M = 2.0


class RobotSnapshot:
    """One robot, with its own sensors."""

    def __init__(
        self, robot: SimRobot, model: mujoco.MjModel, data: mujoco.MjData, site: Site, time_ns: int
    ) -> None:
        config = self.config = robot.config
        self.body = robot.body
        self._robot, self._data = robot, data
        self._lidar = Lidar(model, f"{config.name}/{LIDAR_SITE}", f"{config.name}/base_link")
        self.depth = DepthCamera(model, f"{config.name}/{CAMERA_SITE}")
        self._depth_chance = Moments(site, PROCESS, f"depth of {config.name}")
        self.take(time_ns)

    def take(self, time_ns: int) -> None:
        self._time_ns = time_ns
        reckoned = self._robot.odometry
        self.x_m, self.y_m, self.yaw_rad = reckoned.x_m, reckoned.y_m, reckoned.yaw_rad
        """In the frame odom, as the wheels have it."""
        self.twist = reckoned.twist
        self.take_power()
        self.arm_reference_rad, self.gripper_reference_m = (
            self._robot.arm.reference_rad,
            self._robot.gripper.position_m,
        )

    def take_power(self) -> None:
        self.battery = self._robot.battery.copy()

    def scan_m(self) -> np.ndarray:
        """(Lidar.BEAMS,) ranges as the lidar measures them, noise included."""
        chance = self._robot.lidar_chance.at(self._time_ns)
        noise_m = self.config.noise.lidar_m * chance.standard_normal(Lidar.BEAMS)
        return self._lidar.ranges(self._data) + noise_m

    def depth_m(self) -> np.ndarray:
        """(height, width) depths as the wrist's camera measures them."""
        depth_m = self.depth.image(self._data)
        share, chance = self.config.noise.depth_share, self._depth_chance.at(self._time_ns)
        return depth_m * (1 + share * chance.standard_normal(depth_m.shape, np.float32))


class Snapshot:
    """For the simulation's thread, between two control periods. `take` comes first."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.site, self.model = simulation.site, simulation.model
        self.data = simulation.data
        self.robots = [
            RobotSnapshot(robot, self.model, self.data, self.site, simulation.time_ns)
            for robot in simulation.robots.values()
        ]
        self._bodies = list(simulation.captured)
        self._tracked = np.array(list(simulation.captured.values()))
        self._presence = {one.name: self.model.site(f"{one.name}/presence").id for one in self.site.bins}
        self.take()

    def take(self) -> None:
        """What the robots' drivers and batteries tell, as it is now."""
        self.stalls_ns = self._simulation.take_stalls()
        self.take_power()
        for robot in self.robots:
            robot.take(self.time_ns)

    def take_power(self) -> None:
        """Only what changes while nothing moves."""
        self.time_ns = self._simulation.time_ns
        self.supplies = {name: supply.copy() for name, supply in self._simulation.supplies.items()}
        for robot in self.robots:
            robot.take_power()

    def captured_poses(self) -> tuple[list[str], np.ndarray]:
        """The n bodies that motion capture sees in the lab, and their poses (n, 7): x, y, z in m, qx, qy, qz,
        qw."""
        poses = np.empty((len(self._tracked), 7))
        poses[:, :3] = self.data.xpos[self._tracked]
        poses[:, 3:] = self.data.xquat[self._tracked[:, None], XYZW]
        heights_m = poses[:, 2].tolist()
        if min(heights_m, default=0.0) >= _UNDERGROUND_M:
            return self._bodies, poses
        seen = [row for row, height_m in enumerate(heights_m) if height_m >= _UNDERGROUND_M]
        return [self._bodies[row] for row in seen], poses[seen]

    def weight_n(self, bin_name: str, compartment: str) -> float:
        return scale_weight_n(self.model, self.data, bin_name, compartment)

    def presence_m(self, bin_name: str) -> float:
        """Distance from the bin's camera to the first thing in front of it; infinite beyond 2 m."""
        sensor = self._presence[bin_name]
        eye = self.data.site_xpos[sensor]
        beam = self.data.site_xmat[sensor].reshape(3, 3)[:, 2].copy()
        distance_m = mujoco.mj_ray(self.model, self.data, eye, beam, None, True, -1, None)
        return distance_m if 0 <= distance_m <= _PRESENCE_MAX_M else math.inf
