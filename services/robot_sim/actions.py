"""The three actions of a simulated robot: drive, move the arm, move the fingers."""

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np

from rodeo.host.stamps import SECOND_NS, stamp_s
from rodeo.lab.arm import ArmModel
from rodeo.lab.config import Pose2
from rodeo.lab.geometry import on_plane
from rodeo.ros2 import types
from rodeo.ros2.action import ActionServer, ServerGoal
from rodeo.ros2.node import Node
from rodeo.ros2.readings import Unknown, pose
from rodeo.ros2.wire import LATCHED
from rodeo.site import topics
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
from services.robot_sim.commander import Commander
from services.robot_sim.loop import Loop
from services.robot_sim.navigation import Drive
from services.robot_sim.planner import GoalOutsideMap, Map, PlanningFailed, Route, UnknownFrame, plan
from services.robot_sim.simulation import SimRobot
from services.robot_sim.turns import Turn

log = logging.getLogger(__name__)

_FEEDBACK_WALL_PERIOD_S = 0.1
_REPLANS = 8
"""A goal that needs more new routes than this is given up."""
_BLOCKED_WAIT_S = 2.0
"""Site time until a way that is blocked altogether is looked at again: people walk on."""
_BLOCKED_LOOKS = 3
_GIVEN_UP = 208
"""Nav2's NO_VALID_PATH."""


class Actions:
    """Serves the robot's actions; each goal runs in a thread of its own and leaves motion to the loop."""

    def __init__(self, node: Node, loop: Loop, robot: SimRobot, commander: Commander) -> None:
        self._loop, self._simulation, self._robot = loop, loop.simulation, robot
        namespace = robot.config.namespace
        self._plan = node.publisher(topics.PLAN.name(ns=namespace), topics.PLAN.type, LATCHED)
        for action, execute in (
            (topics.NAVIGATE_TO_POSE, self._navigate),
            (topics.FOLLOW_JOINT_TRAJECTORY, self._follow_trajectory),
            (topics.GRIPPER_CMD, self._grip),
        ):
            name = action.name(ns=namespace)
            run = self._in_turn(execute)
            ActionServer(node, name, action.type, run, self._accept, commander.follows, self._turns())

    def _accept(self, _goal: Any) -> bool:
        return not self._robot.halted

    @staticmethod
    def _in_turn(execute: Callable[[ServerGoal, Turn], None]) -> Callable[[ServerGoal], None]:
        return lambda goal: execute(goal, goal.around)

    def _turns(self) -> Callable[[], AbstractContextManager[Turn]]:
        """Gives turns to one action's goals, each after the one before."""
        before: Turn | None = None

        @contextmanager
        def take() -> Iterator[Turn]:
            nonlocal before
            with self._loop.turn(before) as turn:
                before = turn
                yield turn

        return take

    # -- NavigateToPose ----------------------------------------------------------------------------

    def _navigate(self, goal: ServerGoal, turn: Turn) -> None:
        started_ns = self._simulation.time_ns
        result = "nav2_msgs/action/NavigateToPose_Result"
        replans = 0
        while True:
            try:
                route = self._route(goal, turn)
            except PlanningFailed as error:
                log.warning("%s: no route: %s", self._robot.config.name, error)
                goal.abort(types.new(result, error_code=error.error_code))
                return
            if route is None:
                goal.canceled(types.new(result))
                return
            drive = self._drive(goal, turn, route, started_ns, replans)
            if not drive.was_blocked or replans == _REPLANS:
                break
            replans += 1
            log.info("%s: the path is blocked; planning another", self._robot.config.name)
        if drive.was_cancelled:
            goal.canceled(types.new(result))
        elif drive.error or drive.was_blocked:
            log.warning("%s: navigation failed: %s", self._robot.config.name, drive.error.name)
            goal.abort(types.new(result, error_code=int(drive.error) or _GIVEN_UP))
        else:
            goal.succeed(types.new(result))

    def _drive(self, goal: ServerGoal, turn: Turn, route: Route, started_ns: int, replans: int) -> Drive:
        """Follow the route to its end, whatever that is."""
        drive = Drive(route, lambda: goal.is_cancel_requested)
        self._loop.call(lambda: self._start(drive, turn))
        while not drive.finished.wait(_FEEDBACK_WALL_PERIOD_S):
            goal.publish_feedback(self._navigation_feedback(drive, started_ns, replans))
        self._loop.settle()
        return drive

    def _start(self, drive: Drive, turn: Turn) -> None:
        self._robot.base.follow(drive)
        turn.begins(drive.finished)
        now_ns = self._simulation.time_ns
        path = messages.path(now_ns, self._robot.base.way)
        self._loop.publish_queue.then(lambda: self._plan.publish(path, now_ns))
        if self._robot.halted:
            self._robot.base.stop()

    def _route(self, goal: ServerGoal, turn: Turn) -> Route | None:
        """A route around everything that is known or seen; None when cancelled while the way was blocked.

        Raises PlanningFailed.
        """
        turn.goes_on()
        pose = _goal_pose(goal.request.pose)
        for look in range(_BLOCKED_LOOKS + 1):
            here, lab = self._loop.call(self._look)
            try:
                return plan(lab, here, pose)
            except PlanningFailed:
                # What the map alone forbids will not change; what was seen in the way may go.
                if look == _BLOCKED_LOOKS or not self._possible(here, pose):
                    raise
            if not self._wait(goal, turn):
                return None
        raise AssertionError("the last look returns or raises")

    def _look(self) -> tuple[Pose2, Map]:
        simulation, robot = self._simulation, self._robot
        seen = [(float(x), float(y)) for x, y in robot.unmapped(simulation.map, simulation.time_ns)]
        return robot.body.pose, simulation.map.with_items([*simulation.things.on_floor(), *seen])

    def _possible(self, here: Pose2, goal: Pose2) -> bool:
        try:
            plan(self._simulation.map, here, goal)
        except PlanningFailed:
            return False
        return True

    def _wait(self, goal: ServerGoal, turn: Turn) -> bool:
        """Let _BLOCKED_WAIT_S of site time pass; False when the goal is cancelled meanwhile."""

        def begin() -> threading.Event:
            until_ns = self._simulation.time_ns + round(_BLOCKED_WAIT_S * 1e9)
            return turn.waits(until_ns, lambda: goal.is_cancel_requested)

        self._loop.call(begin).wait()
        return not goal.is_cancel_requested

    def _navigation_feedback(self, drive: Drive, started_ns: int, replans: int) -> Any:
        now_ns, at = self._simulation.time_ns, self._robot.body.pose
        left_s = drive.remaining_m / self._robot.config.limits.cruise_m_s
        return types.new(
            "nav2_msgs/action/NavigateToPose_Feedback",
            current_pose=messages.pose_stamped(now_ns, messages.planar_pose(at.x_m, at.y_m, at.yaw_rad)),
            navigation_time=types.duration_message(now_ns - started_ns),
            estimated_time_remaining=types.duration_message(int(left_s) * SECOND_NS),
            number_of_recoveries=replans,
            distance_remaining=drive.remaining_m,
        )

    # -- FollowJointTrajectory ---------------------------------------------------------------------

    def _follow_trajectory(self, goal: ServerGoal, turn: Turn) -> None:
        result = "control_msgs/action/FollowJointTrajectory_Result"
        robot = self._robot
        try:
            motion = _motion(goal, robot.body.arm_model)
            check(motion.waypoints, robot.body.arm_model, robot.config.limits)
        except BadTrajectory as error:
            log.warning("%s: refused a trajectory: %s", robot.config.name, error)
            goal.abort(types.new(result, error_code=int(error.error), error_string=str(error)))
            return
        self._loop.call(lambda: self._begin(robot.arm, motion, turn))
        while not motion.finished.wait(_FEEDBACK_WALL_PERIOD_S):
            goal.publish_feedback(self._arm_feedback(motion))
        self._loop.settle()
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
            joint_names=list(self._robot.body.arm_model.joints),
            desired=types.new(point, positions=desired),
            actual=types.new(point, positions=actual),
            error=types.new(point, positions=desired - actual),
        )

    # -- GripperCommand ----------------------------------------------------------------------------

    def _grip(self, goal: ServerGoal, turn: Turn) -> None:
        command, robot = goal.request.command, self._robot
        # As in ros2_control, no effort given means as much as the gripper has.
        force_n = command.max_effort if command.max_effort > 0 else robot.config.limits.gripper_force_n
        if not (math.isfinite(command.position) and math.isfinite(force_n)):
            log.warning("%s: refused a gripper command that is not finite", robot.config.name)
            goal.abort(self._grip_state("Result", False, False))
            return
        grip = Grip(command.position, force_n, lambda: goal.is_cancel_requested)
        self._loop.call(lambda: self._begin(robot.gripper, grip, turn))
        while not grip.finished.wait(_FEEDBACK_WALL_PERIOD_S):
            goal.publish_feedback(self._grip_state("Feedback", False, False))
        self._loop.settle()
        state = self._grip_state(
            "Result", grip.stalled, not (grip.stalled or grip.was_cancelled or grip.was_stopped)
        )
        if grip.was_cancelled:
            goal.canceled(state)
        elif grip.was_stopped:
            goal.abort(state)
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

    def _begin(self, driver: Any, motion: Motion | Grip, turn: Turn) -> None:
        driver.follow(motion)
        turn.begins(motion.finished)
        # It may have been stopped or switched off since the goal was accepted.
        if self._robot.halted:
            driver.stop()


def _goal_pose(target: Any) -> Pose2:
    """Raises UnknownFrame, GoalOutsideMap."""
    frame = target.header.frame_id
    if frame not in ("", "map"):
        raise UnknownFrame(202, "the goal must be in the frame map", frame=frame)
    try:
        return on_plane(pose(target.pose))
    except Unknown as error:
        raise GoalOutsideMap(204, f"the goal is no pose: {error.message}") from error


def _motion(goal: ServerGoal, arm: ArmModel) -> Motion:
    """The trajectory in a goal. Raises BadTrajectory that names the joints that it should be for."""
    trajectory = goal.request.trajectory
    names = list(trajectory.joint_names)
    if sorted(names) != sorted(arm.joints):
        raise BadTrajectory(
            TrajectoryError.INVALID_JOINTS,
            "the trajectory names other joints than the arm's",
            joints=names,
            expected=list(arm.joints),
        )
    count, order = len(names), [names.index(name) for name in arm.joints]
    waypoints = []
    for k, point in enumerate(trajectory.points):
        values = [np.asarray(point.positions), np.asarray(point.velocities), np.asarray(point.accelerations)]
        given = [v for v in values if len(v)]
        wrong = any(len(v) != count for v in (values[0], *given))
        if wrong or (len(values[2]) and not len(values[1])):
            raise BadTrajectory(
                TrajectoryError.INVALID_GOAL, "a trajectory point lacks joints or derivatives", point=k
            )
        time_s = stamp_s(point.time_from_start)
        waypoints.append(Waypoint(time_s, tuple(v[order] for v in given)))
    return Motion(
        waypoints,
        lambda: goal.is_cancel_requested,
        _tolerance(goal.request.path_tolerance, arm, PATH_TOLERANCE_RAD),
        _tolerance(goal.request.goal_tolerance, arm, GOAL_TOLERANCE_RAD),
        stamp_s(goal.request.goal_time_tolerance) or GOAL_TIME_TOLERANCE_S,
    )


def _tolerance(given: list[Any], arm: ArmModel, default_rad: float) -> np.ndarray:
    """control_msgs/JointTolerance: 0 means the default, negative means none."""
    by_name = {tolerance.name: tolerance.position for tolerance in given}
    values = [by_name.get(name, 0.0) for name in arm.joints]
    return np.array([default_rad if v == 0 else math.inf if v < 0 else v for v in values])
