"""The robot plane: what the simulated robot and lab publish, and the services and actions they offer."""

import logging
import math
import time
from typing import Any

import numpy as np

from rodeo import topics
from rodeo.lab.body import Twist2
from rodeo.lab.config import Pose2
from rodeo.lab.layout import wrap
from rodeo.lab.world import ARM_JOINTS
from rodeo.ros2 import ActionServer, MessageInfo, Node, Publisher, ServerGoal, types
from services.robot_sim import messages
from services.robot_sim.arm import (
    GOAL_TIME_TOLERANCE_S,
    GOAL_TOLERANCE_RAD,
    PATH_TOLERANCE_RAD,
    BadTrajectory,
    Grip,
    Motion,
    TrajectoryError,
    Waypoint,
    check,
)
from services.robot_sim.camera import BinCamera
from services.robot_sim.loop import Loop
from services.robot_sim.navigation import Drive
from services.robot_sim.planner import GoalOutsideMap, Map, PlanningFailed, Route, UnknownFrame, plan
from services.robot_sim.simulation import SimRobot

log = logging.getLogger(__name__)

_SLOW_TICKS = 5
_SECOND_TICKS = 50
"""Control periods between messages of 10 Hz and 1 Hz."""
_CLOCK_WALL_PERIOD_S = 0.01
_FEEDBACK_WALL_PERIOD_S = 0.1


class LabPlane:
    """Clock, motion capture, bin and dock."""

    def __init__(self, node: Node, loop: Loop, camera: BinCamera) -> None:
        self._loop, self._simulation, self._camera = loop, loop.simulation, camera
        site = self._simulation.site
        self._bin, self._dock = site.bin.name, site.dock.name

        def publisher(topic: topics.Topic, **names: str) -> Publisher:
            return node.publisher(topic.name(**names), topic.type)

        self._clock = publisher(topics.CLOCK)
        self._clock_sent_s = -math.inf
        self._items = {item.id: publisher(topics.MOCAP_POSE, body=item.id) for item in site.items}
        self._presence = publisher(topics.BIN_PRESENCE, bin=self._bin)
        self._loads = {
            name: publisher(topics.BIN_LOAD, bin=self._bin, compartment=name)
            for name in site.bin.compartments
        }
        self._image = publisher(topics.BIN_IMAGE, bin=self._bin)
        self._output = publisher(topics.DOCK_OUTPUT, dock=self._dock)
        node.service(topics.BIN_CAPTURE.name(bin=self._bin), topics.BIN_CAPTURE.type, self._capture)
        node.service(topics.DOCK_ENABLE.name(dock=self._dock), topics.DOCK_ENABLE.type, self._enable)

    def publish(self, tick: int, skipped: bool) -> None:
        now_ns, simulation = self._simulation.time_ns, self._simulation
        for item, mocap in self._items.items():
            mocap.publish(messages.pose_stamped(now_ns, messages.pose(*simulation.item_pose(item))), now_ns)
        if skipped or tick % _SLOW_TICKS == 0:
            self._presence.publish(messages.presence(now_ns, self._bin, simulation.presence_m()), now_ns)
            for name, scale in self._loads.items():
                frame = f"{self._bin}/{name}"
                scale.publish(messages.load(now_ns, frame, simulation.weight_n(name)), now_ns)
        if skipped or tick % _SECOND_TICKS == 0:
            self._output.publish(messages.dock_output(now_ns, simulation.supply), now_ns)

    def publish_clock(self) -> None:
        """At most every _CLOCK_WALL_PERIOD_S: whoever reads the clock needs no more than that."""
        now_s = time.monotonic()
        if now_s - self._clock_sent_s >= _CLOCK_WALL_PERIOD_S:
            self._clock_sent_s = now_s
            self._clock.publish(messages.clock(self._simulation.time_ns), self._simulation.time_ns)

    def _capture(self, _request: Any) -> Any:
        def take() -> None:
            jpeg, now_ns = self._camera.jpeg(), self._simulation.time_ns
            self._image.publish(messages.compressed_image(now_ns, f"{self._bin}/camera", jpeg), now_ns)

        self._loop.call(take)
        return types.new("std_srvs/srv/Trigger_Response", success=True)

    def _enable(self, request: Any) -> Any:
        self._loop.call(lambda: self._simulation.supply.enable(request.data))
        return types.new("std_srvs/srv/SetBool_Response", success=True)


class RobotPlane:
    """Odometry, joints, battery, velocity commands and the three actions of one robot."""

    def __init__(self, node: Node, loop: Loop, robot: SimRobot) -> None:
        self._loop, self._simulation, self._robot = loop, loop.simulation, robot
        namespace = robot.config.name

        def publisher(topic: topics.Topic, **names: str) -> Publisher:
            return node.publisher(topic.name(**names), topic.type)

        self._odom = publisher(topics.ODOM, ns=namespace)
        self._joints = publisher(topics.JOINT_STATES, ns=namespace)
        self._battery = publisher(topics.BATTERY_STATE, ns=namespace)
        self._mocap = publisher(topics.MOCAP_POSE, body=namespace)
        node.subscription(topics.CMD_VEL.name(ns=namespace), topics.CMD_VEL.type, self._on_cmd_vel)
        for action, execute in (
            (topics.NAVIGATE_TO_POSE, self._navigate),
            (topics.FOLLOW_JOINT_TRAJECTORY, self._follow_trajectory),
            (topics.GRIPPER_CMD, self._grip),
        ):
            ActionServer(node, action.name(ns=namespace), action.type, execute)

    def publish(self, tick: int, skipped: bool) -> None:
        now_ns, robot = self._simulation.time_ns, self._robot
        self._odom.publish(messages.odometry(now_ns, robot), now_ns)
        self._joints.publish(messages.joint_state(now_ns, robot.body), now_ns)
        at = messages.pose(robot.body.position_m, robot.body.quat_wxyz)
        self._mocap.publish(messages.pose_stamped(now_ns, at), now_ns)
        if skipped or tick % _SECOND_TICKS == 0:
            self._battery.publish(messages.battery_state(now_ns, robot.battery), now_ns)

    def _on_cmd_vel(self, twist: Any, _info: MessageInfo) -> None:
        command = Twist2(twist.linear.x, twist.angular.z)
        if math.isfinite(command.linear_m_s) and math.isfinite(command.angular_rad_s):
            self._loop.post(lambda: self._robot.base.command(command, self._simulation.time_s))

    # -- NavigateToPose ----------------------------------------------------------------------------

    def _navigate(self, goal: ServerGoal) -> None:
        started_ns = self._simulation.time_ns
        result = "nav2_msgs/action/NavigateToPose_Result"
        try:
            route = self._route(goal.request.pose)
        except PlanningFailed as error:
            log.warning("%s: no route: %s", self._robot.config.name, error)
            goal.abort(types.new(result, error_code=error.error_code))
            return
        drive = Drive(route, lambda: goal.is_cancel_requested)
        self._loop.call(lambda: self._robot.base.follow(drive))
        while not drive.finished.wait(_FEEDBACK_WALL_PERIOD_S):
            goal.publish_feedback(self._navigation_feedback(drive, started_ns))
        if drive.was_cancelled:
            goal.canceled(types.new(result))
        elif drive.error:
            log.warning("%s: navigation failed: %s", self._robot.config.name, drive.error.name)
            goal.abort(types.new(result, error_code=int(drive.error)))
        else:
            goal.succeed(types.new(result))

    def _route(self, target: Any) -> Route:
        frame, at, turn = target.header.frame_id, target.pose.position, target.pose.orientation
        if frame not in ("", "map"):
            raise UnknownFrame(202, "goals are in the frame map", frame=frame)
        yaw_rad = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
        if not all(map(math.isfinite, (at.x, at.y, yaw_rad))):
            raise GoalOutsideMap(204, "the goal is not a place", x=at.x, y=at.y, yaw=yaw_rad)
        here, items = self._loop.call(lambda: (self._robot.body.pose, self._simulation.items_on_floor()))
        goal = Pose2(x_m=at.x, y_m=at.y, yaw_rad=wrap(yaw_rad))
        return plan(Map.of(self._simulation.site, items), here, goal)

    def _navigation_feedback(self, drive: Drive, started_ns: int) -> Any:
        now_ns, at = self._simulation.time_ns, self._robot.body.pose
        sec, nanosec = divmod(now_ns - started_ns, 1_000_000_000)
        left_s = drive.remaining_m / self._robot.config.limits.cruise_m_s
        duration = types.msg("builtin_interfaces/msg/Duration")
        return types.new(
            "nav2_msgs/action/NavigateToPose_Feedback",
            current_pose=messages.pose_stamped(now_ns, messages.planar_pose(at.x_m, at.y_m, at.yaw_rad)),
            navigation_time=duration(sec=sec, nanosec=nanosec),
            estimated_time_remaining=duration(sec=int(left_s), nanosec=0),
            distance_remaining=drive.remaining_m,
        )

    # -- FollowJointTrajectory ---------------------------------------------------------------------

    def _follow_trajectory(self, goal: ServerGoal) -> None:
        result = "control_msgs/action/FollowJointTrajectory_Result"
        robot = self._robot
        try:
            motion = _motion(goal)
            check(motion.waypoints, robot.body.arm_ranges, robot.config.limits)
        except BadTrajectory as error:
            log.warning("%s: refused a trajectory: %s", robot.config.name, error)
            goal.abort(types.new(result, error_code=int(error.error), error_string=str(error)))
            return
        self._loop.call(lambda: robot.arm.follow(motion))
        while not motion.finished.wait(_FEEDBACK_WALL_PERIOD_S):
            goal.publish_feedback(self._arm_feedback(motion))
        if motion.was_cancelled:
            goal.canceled(types.new(result))
        elif motion.error:
            log.warning("%s: trajectory aborted: %s", robot.config.name, motion.reason)
            goal.abort(types.new(result, error_code=int(motion.error), error_string=motion.reason))
        else:
            goal.succeed(types.new(result))

    def _arm_feedback(self, motion: Motion) -> Any:
        point = "trajectory_msgs/msg/JointTrajectoryPoint"
        desired, actual = motion.desired_rad, self._robot.body.arm
        return types.new(
            "control_msgs/action/FollowJointTrajectory_Feedback",
            header=messages.header(self._simulation.time_ns, ""),
            joint_names=list(ARM_JOINTS),
            desired=types.new(point, positions=desired),
            actual=types.new(point, positions=actual),
            error=types.new(point, positions=desired - actual),
        )

    # -- GripperCommand ----------------------------------------------------------------------------

    def _grip(self, goal: ServerGoal) -> None:
        command, robot = goal.request.command, self._robot
        # As in ros2_control, no effort given means as much as the gripper has.
        force_n = command.max_effort if command.max_effort > 0 else robot.config.limits.gripper_force_n
        if not (math.isfinite(command.position) and math.isfinite(force_n)):
            log.warning("%s: refused a gripper command that is not finite", robot.config.name)
            goal.abort(self._grip_state("Result", False, False))
            return
        grip = Grip(command.position, force_n, lambda: goal.is_cancel_requested)
        self._loop.call(lambda: robot.gripper.follow(grip))
        while not grip.finished.wait(_FEEDBACK_WALL_PERIOD_S):
            goal.publish_feedback(self._grip_state("Feedback", False, False))
        state = self._grip_state("Result", grip.stalled, not (grip.stalled or grip.was_cancelled))
        if grip.was_cancelled:
            goal.canceled(state)
        else:
            # Stalling on an object is what closing a gripper is for.
            goal.succeed(state)

    def _grip_state(self, part: str, stalled: bool, reached: bool) -> Any:
        body = self._robot.body
        return types.new(
            f"control_msgs/action/GripperCommand_{part}",
            position=body.gripper_m,
            effort=abs(body.gripper_force_n),
            stalled=stalled,
            reached_goal=reached,
        )


def _motion(goal: ServerGoal) -> Motion:
    """The trajectory in a goal. Raises BadTrajectory."""
    trajectory = goal.request.trajectory
    names = list(trajectory.joint_names)
    if sorted(names) != sorted(ARM_JOINTS):
        raise BadTrajectory(TrajectoryError.INVALID_JOINTS, "the joints are not the arm's", joints=names)
    order = [names.index(name) for name in ARM_JOINTS]
    waypoints = []
    for k, point in enumerate(trajectory.points):
        values = [np.asarray(point.positions), np.asarray(point.velocities), np.asarray(point.accelerations)]
        given = [v for v in values if len(v)]
        if len(values[0]) != 6 or any(len(v) != 6 for v in given) or (len(values[2]) and not len(values[1])):
            raise BadTrajectory(TrajectoryError.INVALID_GOAL, "a point lacks joints or derivatives", point=k)
        time_s = _seconds(point.time_from_start)
        waypoints.append(Waypoint(time_s, tuple(v[order] for v in given)))
    return Motion(
        waypoints,
        lambda: goal.is_cancel_requested,
        _tolerance(goal.request.path_tolerance, PATH_TOLERANCE_RAD),
        _tolerance(goal.request.goal_tolerance, GOAL_TOLERANCE_RAD),
        _seconds(goal.request.goal_time_tolerance) or GOAL_TIME_TOLERANCE_S,
    )


def _seconds(duration: Any) -> float:
    return duration.sec + duration.nanosec * 1e-9


def _tolerance(given: list[Any], default_rad: float) -> np.ndarray:
    """control_msgs/JointTolerance: 0 means the default, negative means none."""
    by_name = {tolerance.name: tolerance.position for tolerance in given}
    values = [by_name.get(name, 0.0) for name in ARM_JOINTS]
    return np.array([default_rad if v == 0 else math.inf if v < 0 else v for v in values])
