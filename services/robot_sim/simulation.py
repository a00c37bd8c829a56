"""The simulated world: physics, drivers, battery and dock, one control period at a time. Knows no bus."""

import math
from collections.abc import Mapping

import mujoco
import numpy as np

from rodeo.errors import ConfigError
from rodeo.lab.battery import Battery, Supply
from rodeo.lab.body import Body, Twist2
from rodeo.lab.config import DockConfig, RobotConfig, gripper_body
from rodeo.lab.layout import BUMPER_M, BinLayout, on_contacts
from rodeo.lab.sensors import DepthCamera, Lidar
from rodeo.lab.world import (
    CAMERA_SITE,
    CONTROL_PERIOD_S,
    LIDAR_SITE,
    arm_model,
    begin,
    robot_model,
    scale_weight_n,
    world_spec,
)
from rodeo.site.chance import Moments, generator
from rodeo.site.config import Site
from services.robot_sim.arm import ArmDriver, GripperDriver
from services.robot_sim.entities import Entities, EntityState
from services.robot_sim.frames import Transform, lab_frames
from services.robot_sim.navigation import BaseDriver
from services.robot_sim.odometry import Odometry
from services.robot_sim.planner import Map
from services.robot_sim.steps import Steps
from services.robot_sim.surroundings import blocked, unknown_returns
from services.robot_sim.urdf import to_urdf

PROCESS = "robot_sim"
PERIOD_NS = round(CONTROL_PERIOD_S * 1e9)
IDLE_PERIOD_NS = 1_000_000_000
"""Stride of the site time while a parked robot charges and nothing else happens."""
_STALL_POWERED_S = 60.0
"""Part of a stall in which power flows: a machine left asleep does not drain the battery."""

_SETTLE_PERIODS = 5
"""Control periods at rest until something that was put somewhere counts as lying there: in the moment in
which it is let go it has no speed."""
_LOOK_PERIODS = 10
"""Control periods between two looks for obstacles on the way."""
_MJ_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_ON_FLOOR_M = 0.15
_PRESENCE_MAX_M = 2.0


class SimRobot:
    """One robot: its body, the drivers that move it, its battery and its odometry."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, config: RobotConfig, site: Site) -> None:
        self.config = config
        self.body = Body(model, data, config.name, config.limits)
        told, simulated = arm_model(config.kinematics).joints, self.body.arm_model.joints
        if told != simulated:
            raise ConfigError(
                "a simulated robot with another arm needs an MJCF: a URDF has no actuators to simulate",
                robot=config.name,
                kinematics=str(config.kinematics),
                joints=list(told),
                simulated=list(simulated),
            )
        self.base = BaseDriver(self.body, config.limits)
        self.arm = ArmDriver(self.body)
        self.gripper = GripperDriver(self.body)
        self.battery = Battery(config.battery, config.battery.soc)
        self.odometry = Odometry(
            config.pose,
            config.noise,
            generator(site, PROCESS, f"odometry of {config.name}", repeatable=True),
        )
        self.stopped = False
        """The emergency stop is engaged."""
        self.powered = True
        """The motors have power. Without it a real arm lies where it was folded; the simulated one stays."""
        self._lidar = Lidar(model, f"{config.name}/{LIDAR_SITE}", f"{config.name}/base_link")
        self._lidar_chance = Moments(site, PROCESS, f"lidar of {config.name}")
        self._scan: tuple[int, np.ndarray] | None = None
        """When it was taken, and its ranges: what is published is what the base's driver looks at."""
        self.depth = DepthCamera(model, f"{config.name}/{CAMERA_SITE}")
        self._depth_chance = Moments(site, PROCESS, f"depth of {config.name}")

    @property
    def idle(self) -> bool:
        return self.base.idle and self.arm.idle and self.gripper.idle

    @property
    def load_w(self) -> float:
        """Electrical power that the robot uses now."""
        battery = self.config.battery
        if not self.powered:
            return battery.standby_power_w
        arm_w = 0.0 if self.arm.idle and self.gripper.idle else battery.arm_power_w
        return battery.idle_power_w + arm_w + self.body.wheel_power_w / battery.drive_efficiency

    def step(self, now_s: float) -> None:
        """Let the drivers command the motors for one control period."""
        self.base.step(now_s)
        self.arm.step(now_s)
        self.gripper.step(now_s)

    @property
    def description(self) -> str:
        """Its URDF: the site's, or the model's as one. Raises ConfigError for what a mind could not use."""
        kinematics = self.config.kinematics
        model = robot_model(kinematics)
        if kinematics is not None and kinematics.suffix == ".urdf":
            return kinematics.read_text()
        return to_urdf(model, self.config.name)

    def command(self, twist: Twist2, now_s: float) -> None:
        """A velocity command; ignored while the robot is halted."""
        if not self.halted:
            self.base.command(twist, now_s)

    def emergency_stop(self, engage: bool) -> None:
        """Stop base and arm where they are and fail their goals, or let them move again."""
        self.stopped = engage
        if engage:
            self._stop()

    def switch(self, powered: bool) -> None:
        """Give the motors power, or take it: base and arm stop where they are and fail their goals."""
        self.powered = powered
        if not powered:
            self._stop()

    @property
    def halted(self) -> bool:
        """Whether nothing moves, whatever is asked for."""
        return self.stopped or not self.powered

    def _stop(self) -> None:
        self.base.stop()
        self.arm.stop()
        self.gripper.stop()

    def scan_m(self, time_ns: int) -> np.ndarray:
        """(Lidar.BEAMS,) ranges as the lidar measures them, noise included."""
        if self._scan is None or self._scan[0] != time_ns:
            noise_m = self.config.noise.lidar_m * self._lidar_chance.at(time_ns).standard_normal(Lidar.BEAMS)
            self._scan = time_ns, self._lidar.ranges(self.body.data) + noise_m
        return self._scan[1]

    def look_again(self) -> None:
        """Something was put somewhere: earlier views are outdated."""
        self._scan = None

    def depth_m(self, time_ns: int) -> np.ndarray:
        """(height, width) depths as the wrist's camera measures them, noise included."""
        depth_m = self.depth.image(self.body.data)
        share, chance = self.config.noise.depth_share, self._depth_chance.at(time_ns)
        return depth_m * (1 + share * chance.standard_normal(depth_m.shape, np.float32))

    def watch(self, lab: Map, time_ns: int) -> None:
        """Stop the drive under way if the lidar shows something on its route that `lab` has not."""
        way = self.base.way
        if way and blocked(way, self.unmapped(lab, time_ns)):
            self.base.block()

    def unmapped(self, lab: Map, time_ns: int) -> np.ndarray:
        """(n, 2) points in the map where the lidar sees what `lab` has not."""
        return unknown_returns(lab, self.body.pose, self._lidar.angles_rad, self.scan_m(time_ns))

    def row(self) -> list[float]:
        o, g = self.odometry, self.gripper
        # One number for both, as it was before motors could be off: older worlds are read, too.
        halt = float(self.stopped + 2 * (not self.powered))
        return [self.battery.soc, o.x_m, o.y_m, o.yaw_rad, g.position_m, g.force_n, halt]

    def restore(self, row: np.ndarray) -> None:
        soc, x, y, yaw, position_m, force_n, halt = (float(value) for value in row)
        self.battery.soc = soc
        self.odometry.x_m, self.odometry.y_m, self.odometry.yaw_rad = x, y, yaw
        self.stopped, self.powered = bool(int(halt) & 1), not int(halt) & 2
        self.gripper.position_m, self.gripper.force_n = position_m, force_n
        self.arm.hold(self.body.arm_setpoint)


class Things:
    """Items, bins and robots of the lab, as they stand in `model` and `data`."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, site: Site, robots: Mapping[str, SimRobot]
    ) -> None:
        self._model, self._data = model, data
        self._bins = [BinLayout(bin_) for bin_ in site.bins]
        self._presence = {one.name: model.site(f"{one.name}/presence").id for one in site.bins}
        self.items = {item.id: model.body(item.id).id for item in site.items}
        """Name -> MuJoCo's number of the body."""
        bare = {thing.id for thing in site.things}
        self.captured = {item: body for item, body in self.items.items() if item not in bare} | {
            robot.name: model.body(f"{robot.name}/base_link" if robot.name in robots else robot.name).id
            for robot in sorted(site.robots, key=lambda one: one.name not in robots)
        }
        """What the motion capture tracks, of a gripper the body that carries the fingers."""
        if site.lab.mocap_gripper:
            for name, robot in robots.items():
                hand = robot.body.arm_model.hand
                self.captured[gripper_body(name)] = model.body(f"{name}/{hand}").id

    def weight_n(self, bin_name: str, compartment: str) -> float:
        """What the scale under a compartment shows."""
        return scale_weight_n(self._model, self._data, bin_name, compartment)

    def presence_m(self, bin_name: str) -> float:
        """Distance from the bin's camera to the first thing in front of it; infinite beyond 2 m."""
        sensor = self._presence[bin_name]
        eye = self._data.site_xpos[sensor]
        beam = self._data.site_xmat[sensor].reshape(3, 3)[:, 2].copy()
        distance_m = mujoco.mj_ray(self._model, self._data, eye, beam, None, True, -1, None)
        return distance_m if 0 <= distance_m <= _PRESENCE_MAX_M else math.inf

    def item_pose(self, item: str) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) in m and quaternion (4,) w, x, y, z, in the map frame."""
        body = self.items[item]
        return self._data.xpos[body], self._data.xquat[body]

    def on_floor(self) -> list[tuple[float, float]]:
        """Where items lie that a base has to drive around."""
        places = (self._data.xpos[body] for body in self.items.values())
        return [
            (float(x), float(y))
            for x, y, z in places
            if z < _ON_FLOOR_M and not any(_is_at(layout, x, y) for layout in self._bins)
        ]


class Simulation:
    """The site's lab, alive.

    Args:
        time_ns: site time at which the world begins.
    """

    def __init__(self, site: Site, time_ns: int) -> None:
        self.site = site = site.model_copy(update={"items": [*site.items, *site.things]})
        """The site, with all that lies there as its items."""
        self.time_ns = time_ns
        self._stalled_ns = 0
        self._to_settle = 0
        """Further control periods at rest after which the world counts as still."""
        self._stalls_ns: list[tuple[int, int]] = []
        bodies = [robot for robot in site.robots if robot.body == "sim"]
        elsewhere = [robot for robot in site.robots if robot.body != "sim"]
        simulated = site.model_copy(update={"robots": bodies})
        spec = world_spec(simulated)
        self.entities = Entities(spec, [item.id for item in site.items], [robot.name for robot in elsewhere])
        self.model = spec.compile()
        self.data = begin(self.model, simulated)
        self.fingerprint = _fingerprint(self.model, [robot.name for robot in bodies])
        """What the saved numbers are about: the compiled world."""
        self.entities.settle(self.model, self.data)
        self.robots = {config.name: SimRobot(self.model, self.data, config, site) for config in bodies}
        items = [item.id for item in site.items]
        self.steps = Steps(self.model, self.data, list(self.robots), items, lambda: self._gripping)
        self.map = Map.of(site)
        self.supplies = {dock.name: Supply(dock) for dock in site.docks}
        self.things = Things(self.model, self.data, site, self.robots)
        self._row = np.empty(mujoco.mj_stateSize(self.model, _MJ_STATE) + len(self._extras()))

    @property
    def time_s(self) -> float:
        return self.time_ns * 1e-9

    def now_ns(self) -> int:
        return self.time_ns

    @property
    def moved_s(self) -> float:
        """Site time without the stalls that it skipped: motions, which stand still in them, go by this."""
        return (self.time_ns - self._stalled_ns) * 1e-9

    # -- going on ----------------------------------------------------------------------------------

    def step(self) -> None:
        """One control period: drivers, physics, odometry, power."""
        now_s = self.moved_s
        look = self.time_ns // PERIOD_NS % _LOOK_PERIODS == 0
        for robot in self.robots.values():
            if look:
                robot.watch(self.map, self.time_ns)
            robot.step(now_s)
        if self.entities.advance(self.model, self.data, self.time_ns + PERIOD_NS):
            self._moved_by_hand()
        self.steps.advance()
        if self._to_settle and self.steps.rests:
            self._to_settle -= 1
        self.time_ns += PERIOD_NS
        for robot in self.robots.values():
            robot.odometry.advance(robot.body.wheel_twist)
        self._power(CONTROL_PERIOD_S)

    def skip(self, lasted_ns: int = IDLE_PERIOD_NS) -> None:
        """Let time pass in which nothing moves and only power flows; see `still`."""
        self.time_ns += lasted_ns
        self._power(lasted_ns * 1e-9)

    def stall(self, lasted_ns: int) -> None:
        """Skip time in which the machine did not come to simulate. Nothing moves; power flows on."""
        before_ns = self.time_ns
        self.time_ns += lasted_ns
        self._stalled_ns += lasted_ns
        self._stalls_ns.append((before_ns, self.time_ns))
        self._power(min(lasted_ns * 1e-9, _STALL_POWERED_S))

    def take_stalls(self) -> list[tuple[int, int]]:
        """The stalls since the last call, from when to when (ns of site time)."""
        stalls, self._stalls_ns = self._stalls_ns, []
        return stalls

    @property
    def still(self) -> bool:
        """Whether nothing moves and nothing is asked to."""
        idle = all(robot.idle for robot in self.robots.values())
        return idle and self._to_settle == 0 and self.steps.rests

    @property
    def _gripping(self) -> bool:
        return not all(robot.gripper.idle for robot in self.robots.values())

    @property
    def parked(self) -> bool:
        """Whether a robot is being charged, nothing moves and nothing is asked to."""
        return any(supply.current_a > 0 for supply in self.supplies.values()) and self.still

    def halt(self) -> None:
        """End all motion under way as cancelled."""
        for robot in self.robots.values():
            robot.base.halt()
            robot.arm.halt()
            robot.gripper.halt()

    def _power(self, dt_s: float) -> None:
        supplied_a: dict[str, float] = {}
        for dock in self.site.docks:
            docked, supply = self.docked(dock), self.supplies[dock.name]
            if docked is None:
                supply.deliver(None, 0.0)
            else:
                supplied_a[docked.config.name] = supply.deliver(docked.battery, docked.load_w)
        for name, robot in self.robots.items():
            robot.battery.step(robot.load_w, supplied_a.get(name, 0.0), dt_s)

    # -- what sensors of the lab see ---------------------------------------------------------------

    def docked(self, dock: DockConfig) -> SimRobot | None:
        """The robot on the dock's contacts."""
        # Most are far from it, which is known without their whole pose.
        for robot in self.robots.values():
            x_m, y_m, _ = robot.body.position_m.tolist()
            off_m = math.hypot(x_m - dock.pose.x_m, y_m - dock.pose.y_m)
            if off_m < 2 * (BUMPER_M + dock.contact_tolerance_m) and on_contacts(dock, robot.body.pose):
                return robot
        return None

    def lab_frames(self) -> list[Transform]:
        return lab_frames(
            self.model, [bin_.name for bin_ in self.site.bins] + [dock.name for dock in self.site.docks]
        )

    def place(self, entity: str, state: EntityState) -> None:
        """Put an item, an obstacle or a robot that is not simulated somewhere. Raises UnknownEntity."""
        self.entities.place(self.model, self.data, entity, state, self.time_ns)
        self._moved_by_hand()
        for robot in self.robots.values():
            robot.look_again()

    def _moved_by_hand(self) -> None:
        self.steps.look_again()
        self._to_settle = _SETTLE_PERIODS

    # -- survival ----------------------------------------------------------------------------------

    @property
    def row_size(self) -> int:
        return len(self._row)

    def row(self) -> np.ndarray:
        """Everything that changes, for `restore`."""
        size = mujoco.mj_stateSize(self.model, _MJ_STATE)
        mujoco.mj_getState(self.model, self.data, self._row[:size], _MJ_STATE)
        self._row[size:] = self._extras()
        return self._row.copy()

    def restore(self, time_ns: int, row: np.ndarray) -> None:
        """Continue from a saved row. Motion that was under way is not resumed: the base stops, the arm
        holds."""
        size = mujoco.mj_stateSize(self.model, _MJ_STATE)
        self.time_ns = time_ns
        mujoco.mj_setState(self.model, self.data, row[:size].copy(), _MJ_STATE)
        self.entities.settle(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        self._moved_by_hand()
        switches, rest = np.split(row[size:], [2 * len(self.supplies)])
        for supply, (enabled, finished) in zip(self.supplies.values(), switches.reshape(-1, 2), strict=True):
            supply.enabled, supply.finished = bool(enabled), bool(finished)
        shares = np.split(rest, len(self.robots))
        for robot, share in zip(self.robots.values(), shares, strict=True):
            robot.restore(share)

    def _extras(self) -> list[float]:
        robots = [number for robot in self.robots.values() for number in robot.row()]
        switches = [(supply.enabled, supply.finished) for supply in self.supplies.values()]
        return [*(float(one) for pair in switches for one in pair), *robots]


def _is_at(layout: BinLayout, x_m: float, y_m: float) -> bool:
    at = layout.config.pose
    return math.hypot(x_m - at.x_m, y_m - at.y_m) <= layout.width_m / 2


def _fingerprint(model: mujoco.MjModel, robots: list[str]) -> bytes:
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes() + "".join(robots).encode()
