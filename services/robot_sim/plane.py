"""The robot plane: what the simulated robot and lab publish, and the services they offer."""

import logging
import math
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from rodeo.host.stamps import stamp_ns
from rodeo.lab.body import Twist2, joint_names
from rodeo.lab.config import BinConfig
from rodeo.lab.world import CAMERA_SITE
from rodeo.ros2 import types
from rodeo.ros2.base import MessageInfo, Publisher
from rodeo.ros2.node import Node
from rodeo.ros2.readings import is_rotation
from rodeo.ros2.wire import DEFAULT, LATCHED
from rodeo.site import topics
from rodeo.site.providers import is_simulated
from rodeo.witness.motion_capture import MotionCapture
from services.robot_sim import messages
from services.robot_sim.camera import WristCamera, open_camera
from services.robot_sim.commander import Commander
from services.robot_sim.entities import EntityState, UnknownEntity
from services.robot_sim.frames import RobotFrames, odom_in_map, reckoned_poses
from services.robot_sim.loop import SLOW_TICKS, Loop
from services.robot_sim.periods import Periods
from services.robot_sim.simulation import SimRobot

log = logging.getLogger(__name__)

_DEPTH_TICKS = 10
_SECOND_TICKS = 50
"""Control periods between messages of 10 Hz, 5 Hz and 1 Hz."""
_CLOCK_WALL_PERIOD_S = 0.01
_TOLD_WALL_S = 0.5
"""A process that comes later hears the time again. Marks are repeated after a longer time."""
_CLOCK_PERIOD_NS = 5_000_000_000
_SHOWN_M, _FELL_N = 0.02, 0.05
"""Change of a bin's reading on which the bin may act."""
_NOTHING_SHOWN = -1e3
_FINGER_SIDES = np.array([1.0, -1.0])

Column = tuple[Publisher, list[bytes | None]]
"""What one topic shows, in CDR, for each of the last periods; None where nothing is shown."""


class BinPlane:
    """One bin's sensors and its camera."""

    def __init__(self, node: Node, loop: Loop, config: BinConfig) -> None:
        self._loop, self._simulation = loop, loop.simulation
        self._name = config.name
        self._camera = open_camera(self._simulation, config)
        presence, load, image = topics.BIN_PRESENCE, topics.BIN_LOAD, topics.BIN_IMAGE
        self._presence = node.publisher(presence.name(bin=self._name), presence.type)
        self._presence_cdr = messages.presence_template(self._name)
        self._loads = {
            name: (
                node.publisher(load.name(bin=self._name, compartment=name), load.type),
                messages.load_template(f"{self._name}/{name}"),
            )
            for name in config.compartments
        }
        self._told = np.full(1 + len(self._loads), np.nan)
        self._image = node.publisher(image.name(bin=self._name), image.type)
        node.service(topics.BIN_CAPTURE.name(bin=self._name), topics.BIN_CAPTURE.type, self._capture)

    def publish(self) -> None:
        seen, add = self._simulation, self._loop.publish_queue.add
        now_ns, presence_m = seen.time_ns, seen.things.presence_m(self._name)
        add(self._presence.publish_cdr, self._presence_cdr.encode(now_ns, presence_m), now_ns)
        weights_n = {name: seen.things.weight_n(self._name, name) for name in self._loads}
        for name, (scale, load) in self._loads.items():
            weight = messages.LOAD_Z, (weights_n[name],)
            add(scale.publish_cdr, load.encode(now_ns, weight), now_ns)
        # Where nothing reflects the sensor says infinity.
        shown = presence_m / _SHOWN_M if math.isfinite(presence_m) else _NOTHING_SHOWN
        self._watch(np.array([shown, *(weight_n / _FELL_N for weight_n in weights_n.values())]))

    def _watch(self, readings: np.ndarray) -> None:
        """The bin acts on readings that change."""
        if not np.abs(readings - self._told).max() < 1:
            self._told = readings
            self._loop.sent()

    def _capture(self, _request: Any) -> Any:
        def take() -> None:
            jpeg, now_ns = self._camera.jpeg(), self._simulation.time_ns
            image = messages.compressed_image(now_ns, f"{self._name}/camera", jpeg)
            self._loop.publish_queue.then(lambda: self._image.publish(image, now_ns))

        self._loop.call(take)
        return types.new("std_srvs/srv/Trigger_Response", success=True)


class DockPlane:
    """One dock's terminals and its contactor."""

    def __init__(self, node: Node, loop: Loop, name: str) -> None:
        self._loop, self._simulation = loop, loop.simulation
        self._supply = loop.simulation.supplies[name]
        self._told = False, False
        self._output_cdr = messages.DockOutput(name)
        output, enable = topics.DOCK_OUTPUT, topics.DOCK_ENABLE
        self._output = node.publisher(output.name(dock=name), output.type)
        node.service(enable.name(dock=name), enable.type, self._enable)

    def publish(self) -> None:
        """What the dock reads at its terminals."""
        now_ns, supply = self._simulation.time_ns, self._supply
        self._loop.publish_queue.add(
            self._output.publish_cdr, self._output_cdr.encode(now_ns, supply), now_ns
        )
        self._watch((supply.connected, supply.current_a > 0))

    def _watch(self, stands: tuple[bool, bool]) -> None:
        """The dock acts on robots and on power that come or go. The dock itself announces when it acts on how
        much has come."""
        if stands != self._told:
            self._told = stands
            self._loop.sent()

    def _enable(self, request: Any) -> Any:
        self._loop.call(lambda: self._supply.enable(request.data))
        return types.new("std_srvs/srv/SetBool_Response", success=True)


class LabPlane:
    """The clock, and what is simulated of motion capture, bins and docks."""

    def __init__(self, node: Node, loop: Loop, mocap: MotionCapture | None) -> None:
        self._loop, self._simulation = loop, loop.simulation
        site = self._simulation.site

        def publisher(topic: topics.Topic, **names: str) -> Publisher:
            return node.publisher(topic.name(**names), topic.type)

        self._clock, self._clock_cdr = publisher(topics.CLOCK), messages.clock_template()
        self._told_s = -math.inf
        """Wall time (monotonic) at which the time was told last."""
        self._told_ns = 0
        self._mocap = mocap
        self._mocap_poses = {
            body: publisher(topics.MOCAP_POSE, body=body)
            for body in (() if mocap is None else self._simulation.things.captured)
            if "/" not in body  # of a gripper only what is signed is of use
        }
        self._pose = messages.pose_template()
        self._bins = [
            BinPlane(node, loop, config) for config in site.bins if is_simulated(site, "bin", config.name)
        ]
        self._docks = [
            DockPlane(node, loop, config.name)
            for config in site.docks
            if is_simulated(site, "dock", config.name)
        ]
        node.service(topics.SET_ENTITY_STATE.name(), topics.SET_ENTITY_STATE.type, self._set_entity_state)
        static = node.publisher(topics.TF_STATIC.name(), topics.TF_STATIC.type, LATCHED)
        static.publish(
            messages.transforms(self._simulation.time_ns, self._simulation.lab_frames()),
            self._simulation.time_ns,
        )

    def stall(self, stalls_ns: Sequence[tuple[int, int]]) -> None:
        """Time was skipped. Messages stamped afterwards must not reach anybody before the time does."""
        for stall_ns in stalls_ns:
            if self._mocap is not None:
                self._mocap.stall(*stall_ns)
        self.publish_clock(at_once=True)

    def publish(self, tick: int, everything: bool) -> None:
        """Publish what is not published in each period, or `everything` now."""
        if everything or tick % SLOW_TICKS == 0:
            for bin_ in self._bins:
                bin_.publish()
        if everything or tick % _SECOND_TICKS == 0:
            self.publish_power()

    def columns(self, periods: Periods) -> list[Column]:
        """The poses that motion capture sees, of what somebody looks at."""
        looked_at = {body: one for body, one in self._mocap_poses.items() if one.matched}
        if not looked_at:
            return []
        bodies, poses, seen = periods.captured()
        shown = [number for number, body in enumerate(bodies) if body in looked_at]
        stamps = np.repeat(periods.time_ns, len(shown))
        messages_ = self._pose.encode(stamps, (0, poses[:, shown].reshape(-1, 7)))
        columns: list[Column] = []
        for place, number in enumerate(shown):
            poses_cdr: list[bytes | None] = [*messages_[place :: len(shown)]]
            for row in np.flatnonzero(~seen[:, number]).tolist():
                poses_cdr[row] = None
            columns.append((looked_at[bodies[number]], poses_cdr))
        return columns

    def see(self, periods: Periods) -> None:
        """Have motion capture sign what it saw."""
        if self._mocap is not None and self._mocap_poses:
            self._mocap.see(*periods.captured(), periods.time_ns)

    def publish_power(self) -> None:
        for dock in self._docks:
            dock.publish()

    def publish_clock(self, at_once: bool) -> None:
        """While only power flows: `at_once`, or as often as those need who only read the clock."""
        now_ns = self._simulation.time_ns
        is_due = time.monotonic() - self._told_s >= _CLOCK_WALL_PERIOD_S
        if at_once or is_due or self.is_long_since_told(now_ns):
            self._loop.publish_queue.add(lambda time_ns, _: self.tell_time(time_ns), now_ns, now_ns)

    def is_long_since_told(self, now_ns: int) -> bool:
        """Whether recorders would leave out messages that are stamped so much later than the time that they
        heard last."""
        return now_ns - self._told_ns > _CLOCK_PERIOD_NS

    def tell_time(self, now_ns: int) -> None:
        """Publish /clock at once, unless everybody there has just heard this time."""
        now_s = time.monotonic()
        if now_ns == self._told_ns and now_s - self._told_s < _TOLD_WALL_S:
            return
        self._told_ns, self._told_s = now_ns, now_s
        self._clock.publish_cdr(self._clock_cdr.encode(now_ns), now_ns)

    def _set_entity_state(self, request: Any) -> Any:
        frame = request.state.header.frame_id
        if frame not in ("", "map", "world"):
            return _entity_result(_OPERATION_FAILED, f"the pose must be in the frame map, not {frame!r}")
        state = _entity_state(request.state)
        if state is None:
            return _entity_result(_OPERATION_FAILED, "the pose or the twist is not finite")
        try:
            self._loop.call(lambda: self._simulation.place(request.entity, state))
        except UnknownEntity as error:
            return _entity_result(_NOT_FOUND, str(error))
        return _entity_result(_OK)


def _entity_state(state: Any) -> EntityState | None:
    """From a simulation_interfaces/EntityState; None for what is none."""
    at, turn, twist, stamp = state.pose.position, state.pose.orientation, state.twist, state.header.stamp
    quat_wxyz = np.array([turn.w, turn.x, turn.y, turn.z])
    position_m, linear_m_s, angular_rad_s = vectors = np.array([
        [vector.x, vector.y, vector.z] for vector in (at, twist.linear, twist.angular)
    ])  # fmt: skip
    if not np.isfinite(vectors).all() or not is_rotation(*quat_wxyz):
        return None
    norm = float(np.linalg.norm(quat_wxyz))
    time_ns = stamp_ns(stamp)
    return EntityState(position_m, quat_wxyz / norm, linear_m_s, angular_rad_s, time_ns)


_OK, _NOT_FOUND, _OPERATION_FAILED = 1, 2, 4
"""simulation_interfaces/msg/Result."""


def _entity_result(result: int, message: str = "") -> Any:
    outcome = types.new("simulation_interfaces/msg/Result", result=result, error_message=message)
    return types.new(f"{topics.SET_ENTITY_STATE.type}_Response", result=outcome)


def _publisher(node: Node, robot: SimRobot, topic: topics.Topic) -> Publisher:
    name = topic.name(ns=robot.config.namespace)
    return node.publisher(name, topic.type, LATCHED if topic.latched else DEFAULT)


class MotionPlane:
    """How one robot moved: odometry, joint states, its pose where no motion capture has it, and tf."""

    def __init__(self, node: Node, loop: Loop, robot: SimRobot) -> None:
        self._robot = robot
        self._number = list(loop.simulation.robots.values()).index(robot)
        ns, publisher = robot.config.namespace, partial(_publisher, node, robot)
        self._odom = publisher(topics.ODOM)
        self._odometry = messages.odometry_template(ns, robot.config.noise)
        self._joints = publisher(topics.JOINT_STATES)
        self._joint_states = messages.joint_state_template(joint_names(robot.body.arm_model))
        self._pose = None if loop.simulation.site.lab.mocap else publisher(topics.POSE)
        self._pose_cdr = messages.pose_template()
        self._tf = publisher(topics.TF)
        self._frames = RobotFrames(loop.simulation.model, robot.config.name, ns)
        odom, base = f"{ns}/odom", f"{ns}/base_link"
        self._transforms = messages.transforms_template([("map", odom), (odom, base), *self._frames.moving])
        now_ns = loop.simulation.time_ns
        publisher(topics.TF_STATIC).publish(messages.transforms(now_ns, self._frames.fixed()), now_ns)

    def columns(self, periods: Periods) -> list[Column]:
        time_ns, body = periods.time_ns, self._robot.body
        reckoned = periods.reckoned[:, self._number]
        odometry, twist = reckoned_poses(reckoned)
        odom = self._odometry.encode(time_ns, (0, odometry), (messages.ODOMETRY_TWIST, twist))
        joints = self._joint_states.encode(
            time_ns,
            periods.positions[:, body.positions_at],
            periods.velocities[:, body.velocities_at],
            periods.efforts[:, body.velocities_at],
        )
        columns: list[Column] = [(self._odom, [*odom]), (self._joints, [*joints])]
        if self._pose is not None:
            poses = periods.poses(np.array([body.base]))[:, 0]
            columns.append((self._pose, [*self._pose_cdr.encode(time_ns, (0, poses))]))
        if self._tf.matched:
            base_m, base_quat = periods.places_m[:, body.base], periods.quaternions[:, body.base]
            odom_poses = odom_in_map(base_m, base_quat, reckoned)
            links = self._frames.poses(periods.places_m, periods.quaternions, periods.turns)
            frames = np.concatenate((odom_poses[:, None], odometry[:, None], links), axis=1)
            columns.append((self._tf, [*self._transforms.encode(time_ns, frames)]))
        return columns


class SensorPlane:
    """One robot's lidar and cameras, which measure only for who listens."""

    def __init__(self, node: Node, loop: Loop, robot: SimRobot) -> None:
        self._loop, self._robot, self._ns = loop, robot, robot.config.namespace
        publisher, lens = partial(_publisher, node, robot), robot.depth.lens
        self._scan, self._scan_cdr = publisher(topics.SCAN), messages.scan_template(self._ns)
        self._depth, self._depth_info = publisher(topics.WRIST_DEPTH), publisher(topics.WRIST_DEPTH_INFO)
        self._depth_cdr = messages.depth_image_template(self._ns, lens)
        self._depth_info_cdr = messages.camera_info_template(self._ns, lens)
        self._image = publisher(topics.WRIST_IMAGE)
        self._camera = WristCamera(loop.simulation.model, f"{robot.config.name}/wrist_camera")

    def publish(self, tick: int, skipped: bool) -> None:
        seen, robot, add = self._loop.simulation, self._robot, self._loop.publish_queue.add
        now_ns = seen.time_ns
        if (skipped or tick % SLOW_TICKS == 0) and self._scan.matched_now:
            add(self._scan.publish_cdr, self._scan_cdr.encode(now_ns, robot.scan_m(now_ns)), now_ns)
        if (skipped or tick % _DEPTH_TICKS == 0) and self._depth.matched_now:
            add(self._depth_info.publish_cdr, self._depth_info_cdr.encode(now_ns), now_ns)
            depth = robot.depth_m(now_ns).astype("<f4").view(np.uint8).ravel()
            add(self._depth.publish_cdr, self._depth_cdr.encode(now_ns, depth), now_ns)
            self._loop.sent()
        if (skipped or tick % _SECOND_TICKS == 0) and self._image.matched_now:
            jpeg = self._camera.jpeg(seen.data)
            if jpeg is not None:
                frame = f"{self._ns}/{CAMERA_SITE}"
                add(self._image.publish, messages.compressed_image(now_ns, frame, jpeg), now_ns)


class RobotPlane:
    """What one robot publishes, velocity commands, emergency stop and motor power; its actions are
    `Actions`."""

    def __init__(
        self,
        node: Node,
        loop: Loop,
        robot: SimRobot,
        commander: Commander,
    ) -> None:
        self._loop, self._simulation, self._robot = loop, loop.simulation, robot
        self._commander = commander
        self.motion, self._sensors = MotionPlane(node, loop, robot), SensorPlane(node, loop, robot)
        self._ns, arm = robot.config.namespace, robot.body.arm_model
        publisher = partial(_publisher, node, robot)
        self._arm, self._gripper = publisher(topics.ARM_STATE), publisher(topics.GRIPPER_STATE)
        self._arm_state = messages.controller_state_template(arm.joints)
        self._gripper_state = messages.controller_state_template(arm.fingers)
        self._battery = publisher(topics.BATTERY_STATE)
        self._battery_state = messages.BatteryState(self._ns, robot.config.battery)
        description = types.new(topics.ROBOT_DESCRIPTION.type, data=robot.description)
        publisher(topics.ROBOT_DESCRIPTION).publish(description, self._simulation.time_ns)
        node.subscription(topics.CMD_VEL.name(ns=self._ns), topics.CMD_VEL.type, self._on_cmd_vel)
        stop = topics.EMERGENCY_STOP
        node.service(stop.name(ns=self._ns), stop.type, self._on_emergency_stop)
        power = topics.MOTOR_POWER
        node.service(power.name(ns=self._ns), power.type, self._on_motor_power)

    def publish(self, tick: int, skipped: bool) -> None:
        """Publish what is not published in each period, unless time was `skipped`."""
        if tick % SLOW_TICKS == 0:
            self._publish_controllers(self._simulation.time_ns)
        if skipped or tick % _SECOND_TICKS == 0:
            self.publish_power()
        self._sensors.publish(tick, skipped)

    def publish_power(self) -> None:
        now_ns = self._simulation.time_ns
        state = self._battery_state.encode(now_ns, self._robot.battery)
        self._loop.publish_queue.add(self._battery.publish_cdr, state, now_ns)

    def _publish_controllers(self, now_ns: int) -> None:
        robot, add, body = self._robot, self._loop.publish_queue.add, self._robot.body
        position = body.positions
        arm = self._arm_state.encode(now_ns, robot.arm.reference_rad, position[body.arm_columns])
        add(self._arm.publish_cdr, arm, now_ns)
        fingers = self._gripper_state.encode(
            now_ns, robot.gripper.position_m * _FINGER_SIDES, position[body.finger_columns]
        )
        add(self._gripper.publish_cdr, fingers, now_ns)

    def _on_cmd_vel(self, twist: Any, info: MessageInfo) -> None:
        if not self._commander.follows(info.gid):
            return
        command = Twist2(twist.linear.x, twist.angular.z)
        if math.isfinite(command.linear_m_s) and math.isfinite(command.angular_rad_s):
            self._loop.command(lambda: self._robot.command(command, self._simulation.moved_s))

    def _on_emergency_stop(self, request: Any) -> Any:
        log.warning("%s: emergency stop %s", self._ns, "engaged" if request.data else "released")
        self._loop.call(lambda: self._robot.emergency_stop(request.data))
        return types.new("std_srvs/srv/SetBool_Response", success=True)

    def _on_motor_power(self, request: Any) -> Any:
        if request.data != self._robot.powered:
            log.info("%s: motors switched %s", self._ns, "on" if request.data else "off")
        self._loop.call(lambda: self._robot.switch(request.data))
        return types.new("std_srvs/srv/SetBool_Response", success=True)
