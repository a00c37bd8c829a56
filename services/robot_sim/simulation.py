"""The simulated world: physics, drivers, battery and dock, one control period at a time. Knows no bus."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from rodeo.config import Site
from rodeo.lab.body import Body
from rodeo.lab.config import RobotConfig
from rodeo.lab.layout import BinLayout, on_contacts
from rodeo.lab.world import CONTROL_PERIOD_S, CONTROL_STEPS, begin, build_world, scale_weight_n
from services.robot_sim.arm import ArmDriver, GripperDriver
from services.robot_sim.battery import Battery, Supply
from services.robot_sim.navigation import BaseDriver

PERIOD_NS = round(CONTROL_PERIOD_S * 1e9)
IDLE_PERIOD_NS = 1_000_000_000
"""Stride of the site time while a parked robot charges and nothing else happens."""

_REST_SPEED = 1e-3
_MJ_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_ON_FLOOR_M = 0.15
_PRESENCE_MAX_M = 2.0


@dataclass
class Odometry:
    """Dead reckoning from wheels and gyro; starts at the pose where the world began."""

    x_m: float
    y_m: float
    yaw_rad: float


class SimRobot:
    """One robot: its body, the drivers that move it, its battery and its odometry."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, config: RobotConfig) -> None:
        self.config = config
        self.body = Body(model, data, config.name, config.limits)
        self.base = BaseDriver(self.body, config.limits)
        self.arm = ArmDriver(self.body)
        self.gripper = GripperDriver(self.body)
        self.battery = Battery(config.battery, config.battery.soc)
        self.odometry = Odometry(config.pose.x_m, config.pose.y_m, config.pose.yaw_rad)

    @property
    def idle(self) -> bool:
        return self.base.idle and self.arm.idle and self.gripper.idle

    @property
    def load_w(self) -> float:
        """Electrical power that the robot uses now."""
        battery = self.config.battery
        arm_w = 0.0 if self.arm.idle and self.gripper.idle else battery.arm_power_w
        return battery.idle_power_w + arm_w + self.body.wheel_power_w / battery.drive_efficiency

    def reckon(self) -> None:
        """Advance the odometry by one control period."""
        twist, odometry = self.body.wheel_twist, self.odometry
        middle = odometry.yaw_rad + twist.angular_rad_s * CONTROL_PERIOD_S / 2
        odometry.x_m += math.cos(middle) * twist.linear_m_s * CONTROL_PERIOD_S
        odometry.y_m += math.sin(middle) * twist.linear_m_s * CONTROL_PERIOD_S
        odometry.yaw_rad += twist.angular_rad_s * CONTROL_PERIOD_S

    def row(self) -> list[float]:
        o, g = self.odometry, self.gripper
        return [self.battery.soc, o.x_m, o.y_m, o.yaw_rad, g.position_m, g.force_n]

    def restore(self, row: np.ndarray) -> None:
        soc, x, y, yaw, position_m, force_n = (float(value) for value in row)
        self.battery.soc = soc
        self.odometry = Odometry(x, y, yaw)
        self.gripper.position_m, self.gripper.force_n = position_m, force_n
        self.arm.hold(self.body.arm_setpoint)


class Simulation:
    """The site's lab, alive.

    Args:
        time_ns: site time at which the world begins.
    """

    def __init__(self, site: Site, time_ns: int) -> None:
        self.site = site
        self.time_ns = time_ns
        self.model = build_world(site)
        self.data = begin(self.model, site)
        self.robots = {config.name: SimRobot(self.model, self.data, config) for config in site.robots}
        self.supply = Supply(site.dock)
        self.bin = BinLayout(site.bin)
        self._items = {item.id: self.model.body(item.id).id for item in site.items}
        self._presence = self.model.site(f"{site.bin.name}/presence").id

    @property
    def time_s(self) -> float:
        return self.time_ns * 1e-9

    def now_ns(self) -> int:
        return self.time_ns

    # -- going on ----------------------------------------------------------------------------------

    def step(self) -> None:
        """One control period: drivers, physics, odometry, power."""
        now_s = self.time_s
        for robot in self.robots.values():
            robot.base.step(now_s)
            robot.arm.step(now_s)
            robot.gripper.step(now_s)
        mujoco.mj_step(self.model, self.data, nstep=CONTROL_STEPS)
        self.time_ns += PERIOD_NS
        for robot in self.robots.values():
            robot.reckon()
        self._power(CONTROL_PERIOD_S)

    def skip(self) -> None:
        """Let IDLE_PERIOD_NS pass in which nothing moves and only the battery charges; see `parked`."""
        self.time_ns += IDLE_PERIOD_NS
        self._power(IDLE_PERIOD_NS * 1e-9)

    @property
    def parked(self) -> bool:
        """Whether a robot is being charged, nothing moves and nothing is asked to."""
        return (
            self.supply.current_a > 0
            and all(robot.idle for robot in self.robots.values())
            and float(np.abs(self.data.qvel).max()) < _REST_SPEED
        )

    def halt(self) -> None:
        """End all motion under way as cancelled."""
        for robot in self.robots.values():
            robot.base.halt()
            robot.arm.halt()
            robot.gripper.halt()

    def _power(self, dt_s: float) -> None:
        docked = self.docked
        supplied_a = self.supply.deliver(docked.battery if docked else None, docked.load_w if docked else 0.0)
        for robot in self.robots.values():
            robot.battery.step(robot.load_w, supplied_a if robot is docked else 0.0, dt_s)

    # -- what sensors of the lab see ---------------------------------------------------------------

    @property
    def docked(self) -> SimRobot | None:
        """The robot on the dock's contacts."""
        for robot in self.robots.values():
            if on_contacts(self.site.dock, robot.body.pose):
                return robot
        return None

    def item_pose(self, item: str) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) in m and quaternion (4,) w, x, y, z, in the map frame."""
        body = self._items[item]
        return self.data.xpos[body], self.data.xquat[body]

    def items_on_floor(self) -> list[tuple[float, float]]:
        """Where items lie that a base has to drive around."""
        places = (self.data.xpos[body] for body in self._items.values())
        bin_pose = self.site.bin.pose
        return [
            (float(x), float(y))
            for x, y, z in places
            if z < _ON_FLOOR_M and math.hypot(x - bin_pose.x_m, y - bin_pose.y_m) > self.bin.width_m / 2
        ]

    def weight_n(self, compartment: str) -> float:
        return scale_weight_n(self.model, self.data, self.site.bin.name, compartment)

    def presence_m(self) -> float:
        """Distance from the bin's camera to the first thing in front of it; infinite beyond 2 m."""
        eye = self.data.site_xpos[self._presence]
        beam = self.data.site_xmat[self._presence].reshape(3, 3)[:, 2].copy()
        distance_m = mujoco.mj_ray(self.model, self.data, eye, beam, None, True, -1, None)
        return distance_m if 0 <= distance_m <= _PRESENCE_MAX_M else math.inf

    # -- survival ----------------------------------------------------------------------------------

    @property
    def fingerprint(self) -> bytes:
        """What the saved numbers are about: the compiled world."""
        buffer = np.empty(mujoco.mj_sizeModel(self.model), np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        return buffer.tobytes() + "".join(self.robots).encode()

    @property
    def row_size(self) -> int:
        return mujoco.mj_stateSize(self.model, _MJ_STATE) + len(self._extras())

    def row(self) -> np.ndarray:
        """Everything that changes, for `restore`."""
        state = np.empty(mujoco.mj_stateSize(self.model, _MJ_STATE))
        mujoco.mj_getState(self.model, self.data, state, _MJ_STATE)
        return np.concatenate((state, self._extras()))

    def restore(self, time_ns: int, row: np.ndarray) -> None:
        """Go on from a saved row. Motion that was under way is not resumed: the base stops, the arm holds."""
        size = mujoco.mj_stateSize(self.model, _MJ_STATE)
        self.time_ns = time_ns
        mujoco.mj_setState(self.model, self.data, row[:size].copy(), _MJ_STATE)
        mujoco.mj_forward(self.model, self.data)
        enabled, finished, *rest = row[size:]
        self.supply.enabled, self.supply.finished = bool(enabled), bool(finished)
        shares = np.split(np.array(rest), len(self.robots))
        for robot, share in zip(self.robots.values(), shares, strict=True):
            robot.restore(share)

    def _extras(self) -> list[float]:
        robots = [number for robot in self.robots.values() for number in robot.row()]
        return [float(self.supply.enabled), float(self.supply.finished), *robots]
