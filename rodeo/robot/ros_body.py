"""The robot's joints, base and battery as ROS 2 offers them. Real or simulated looks the same."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rodeo.host.clock import Clock, Patience
from rodeo.lab.arm import ArmModel
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.geometry import on_plane, quaternion_of
from rodeo.lab.layout import on_contacts
from rodeo.lab.world import CONTROL_PERIOD_S, arm_model
from rodeo.robot.arm import Trajectory, Vector
from rodeo.robot.errors import BodySilent, MotionFailed
from rodeo.robot.interrupts import Interrupts
from rodeo.ros2 import plain, types
from rodeo.ros2.action import ActionClient, ClientGoal
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.errors import (
    ActionServerLost,
    ActionServerUnavailable,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    MalformedMessage,
    Ros2Error,
    ServiceTimeout,
)
from rodeo.ros2.node import Node
from rodeo.ros2.readings import unknown_charge, unknown_joints, unknown_pose
from rodeo.site import topics
from rodeo.site.config import Site

log = logging.getLogger(__name__)

_SLICE_S = 0.1
_SILENT_AFTER_S = 10.0
"""Without a message until the body counts as silent, see `Patience`."""
_FRESH_S = 0.1
"""Site time for which a message tells how things are now, unless a motion ended since it came."""
_CLOCK_BEHIND_S = 1.0
"""Site time by which a simulated clock is heard late at most: no stamp is believed that is further ahead."""
_GOAL_TIME_TOLERANCE_S = 3


@dataclass(frozen=True)
class Joints:
    """`arm_rad`, one for each joint from the base to the hand, and half the gap between the fingers."""

    arm_rad: Vector
    gripper_m: float


@dataclass(frozen=True)
class Battery:
    soc: float
    charging: bool


@dataclass(frozen=True)
class Grip:
    """How a gripper command ended."""

    position_m: float
    stalled: bool


class _Arrival(NamedTuple):
    """The newest message, replaced as a whole; the body sends hundreds a second, of which few are read."""

    cdr: bytes
    number: int
    wall_s: float
    site_s: float
    """When it came, by the wall's clock and by the site's."""


class Latest:
    """The newest message of one topic; decoded when it is asked for.

    Args:
        unknown: why a message cannot be used, "" if it can.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        typename: str,
        clock: Clock,
        interrupts: Interrupts,
        simulated: bool,
        unknown: Callable[[Any], str] = lambda _message: "",
    ) -> None:
        self.topic = topic
        self.problem = ""
        """Why the message that was decoded last cannot be used."""
        self._unknown = unknown
        self._simulated = simulated
        self._interrupts = interrupts
        types.prepare(typename)
        self._clock = clock
        self._typename = typename
        self._newest = _Arrival(b"", 0, -math.inf, -math.inf)
        # Inline, because a message that waits in a queue of its own while the result of a motion overtakes
        # it would show the arm where it was before.
        node.raw_subscription(topic, typename, self._on_message, inline=True)

    def _on_message(self, info: MessageInfo) -> None:
        self._newest = _Arrival(info.cdr, self._newest.number + 1, time.monotonic(), self._clock.now_s())

    def recent(self) -> Any:
        """The newest message without waiting, None when it cannot be used or is older than `_SILENT_AFTER_S`.
        While the site's clock stands nobody says more, and it gets no older."""
        newest = self._newest
        age_s = min(time.monotonic() - newest.wall_s, self._clock.now_s() - newest.site_s)
        return self._decoded(newest.cdr) if age_s < _SILENT_AFTER_S else None

    def since(self, moved_s: float) -> Any:
        """The newest message if it is fresh and came after `moved_s`, else the next. Raises BodySilent.

        What is asked after a motion has ended must not be answered with what was sent before. A simulated
        body says how it is at the end of a motion before it says that it has ended, so a message with the
        stamp of that moment will do.
        """
        newest = self._newest
        arrived_s = self._arrived_s(newest)
        told = arrived_s > moved_s or (self._simulated and self._stamp_s(newest) == moved_s)
        if told and self._clock.now_s() - arrived_s < _FRESH_S:
            message = self._decoded(newest.cdr)
            if message is not None:
                return message
        return self.next()

    def _arrived_s(self, newest: _Arrival) -> float:
        """Site time at which it came."""
        if self._simulated:
            # A simulated clock is published less often than what is stamped with it.
            return min(max(newest.site_s, self._stamp_s(newest)), newest.site_s + _CLOCK_BEHIND_S)
        return newest.site_s

    @staticmethod
    def _stamp_s(newest: _Arrival) -> float:
        """Its own time; that of its arrival where it is malformed, which decoding reports."""
        with suppress(MalformedMessage):
            return float(plain.stamp_ns(newest.cdr) * 1e-9)
        return newest.site_s

    def next(self) -> Any:
        """The first message that arrives from now on and can be used. Raises BodySilent."""
        patience = Patience(self._clock, _SILENT_AFTER_S)
        seen = self._newest
        while not patience.is_over:
            # A body tells its state each period; a simulated one has told it when that has passed.
            self._clock.wait_until(self._clock.now_s() + CONTROL_PERIOD_S)
            before, seen = seen, self._newest
            if seen.number != before.number and (message := self._decoded(seen.cdr)) is not None:
                return message
            self._interrupts.check()
        said = f"no fresh message on {self.topic}" + (f" can be used: {self.problem}" if self.problem else "")
        raise BodySilent(said, topic=self.topic, silent_s=_SILENT_AFTER_S)

    def _decoded(self, cdr: bytes) -> Any:
        try:
            message = types.deserialize(cdr, self._typename)
            problem = self._unknown(message)
        except MalformedMessage as error:
            message, problem = None, str(error)
        if problem and not self.problem:
            log.warning("ignored a message on %s: %s", self.topic, problem)
        elif self.problem and not problem:
            log.info("messages on %s can be used again", self.topic)
        self.problem = problem
        return None if problem else message


class RosBody:
    """What a robot tells of itself over ROS 2, and the motions that it offers.

    Motions block until the body reports their end; while the body is away they wait for it and start
    again. They raise MotionFailed when the body gives up, and whatever `interrupts` raise.
    """

    def __init__(
        self, node: Node, site: Site, robot: RobotConfig, clock: Clock, interrupts: Interrupts
    ) -> None:
        self.interrupts = interrupts
        names, simulated = {"ns": robot.namespace}, site.clock.source == "sim"

        def latest(name: str, topic: topics.Topic, unknown: Callable[[Any], str]) -> Latest:
            return Latest(node, name, topic.type, clock, interrupts, simulated, unknown)

        arm = self._arm_model = arm_model(robot.kinematics)
        self._joint_states = latest(
            topics.JOINT_STATES.name(**names),
            topics.JOINT_STATES,
            lambda state: unknown_joints(state, (*arm.joints, *arm.fingers)),
        )
        self._battery = latest(topics.BATTERY_STATE.name(**names), topics.BATTERY_STATE, unknown_charge)
        pose = topics.MOCAP_POSE.name(body=robot.name) if site.lab.mocap else topics.POSE.name(**names)
        self._pose = latest(pose, topics.MOCAP_POSE, lambda message: unknown_pose(message.pose))
        self._clock = clock
        self._docks = site.docks
        self._navigate, self._follow, self._grip = (
            ActionClient(node, action.name(**names), action.type, clock=clock)
            for action in (topics.NAVIGATE_TO_POSE, topics.FOLLOW_JOINT_TRAJECTORY, topics.GRIPPER_CMD)
        )
        self._moved_s = -math.inf
        """Site time at which the last motion ended."""
        self._stop_client = node.client(topics.EMERGENCY_STOP.name(**names), topics.EMERGENCY_STOP.type)
        self._power_client = node.client(topics.MOTOR_POWER.name(**names), topics.MOTOR_POWER.type)
        self._powered: bool | None = None
        """As the body confirmed it last; None before it did."""
        self._said_unswitched = False

    # -- perception ------------------------------------------------------------------------------------

    def base_pose(self) -> Pose2:
        """Where the base stands now. Raises BodySilent."""
        return on_plane(self._pose.since(self._moved_s).pose)

    def joints(self) -> Joints:
        """Raises BodySilent."""
        return _joints(self._joint_states.since(self._moved_s), self._arm_model)

    def recent_gripper_m(self) -> float | None:
        """Half the gap between the fingers a moment ago, None when nobody says so."""
        message = self._joint_states.recent()
        return None if message is None else _joints(message, self._arm_model).gripper_m

    def battery(self) -> Battery:
        """Raises BodySilent."""
        # At 1 Hz a recent one is as good as the next, and an assignment need not wait for it.
        message = self._battery.recent() or self._battery.next()
        return Battery(min(float(message.percentage), 1.0), message.power_supply_status == 1)

    def vitals(self) -> dict[str, Any]:
        """State of charge and whether the robot is docked, as far as recently heard, and what is unknown
        because of what the body says, for the robot's status."""
        heard: dict[str, Any] = {}
        battery, pose = self._battery.recent(), self._pose.recent()
        if battery is not None:
            heard["soc"] = round(min(float(battery.percentage), 1.0), 3)
        if pose is not None:
            base = on_plane(pose.pose)
            heard["docked"] = any(on_contacts(dock, base) for dock in self._docks)
        if unknown := self.unknown:
            heard["unknown"] = unknown
        return heard

    @property
    def unknown(self) -> str:
        """What the body says that cannot be used, and why; "" if there is none."""
        heard = (self._battery, self._pose, self._joint_states)
        return "; ".join(f"{one.topic}: {one.problem}" for one in heard if one.problem)

    def recent_base_pose(self) -> Pose2 | None:
        """Where the base stood a moment ago, None when nobody says so."""
        pose = self._pose.recent()
        return None if pose is None else on_plane(pose.pose)

    # -- motion ----------------------------------------------------------------------------------------

    def navigate(self, goal: Pose2, feedback: Callable[[Any], None] | None = None) -> None:
        """Drive the base to `goal` in the map."""
        pose = types.new("geometry_msgs/msg/PoseStamped")
        pose.header.frame_id = "map"
        pose.pose.position.x, pose.pose.position.y = goal.x_m, goal.y_m
        pose.pose.orientation.w, _, _, pose.pose.orientation.z = quaternion_of(goal.yaw_rad)
        message = types.new(f"{topics.NAVIGATE_TO_POSE.type}_Goal", pose=pose)
        self._execute(self._navigate, lambda: message, feedback)

    def follow(self, plan: Callable[[Vector], Trajectory]) -> None:
        """Move the arm along `plan(current joint angles)`, planned anew whenever it has to start again."""

        def goal() -> Any:
            return _follow_goal(plan(self.joints().arm_rad), self._arm_model)

        self._execute(self._follow, goal)

    def emergency_stop(self, engage: bool) -> None:
        """Have the body itself hold still, or let go. A body without that service is only told to stop."""
        if not self._stop_client.wait_for_server(0.0):
            return
        try:
            self._stop_client.call(types.new(f"{topics.EMERGENCY_STOP.type}_Request", data=engage))
        except Ros2Error as error:
            log.warning("the emergency stop does not answer: %s", error)

    def switch_off(self) -> None:
        """Cut the motors' power. A body without that service keeps it, which is said once."""
        if self._power_client.wait_for_server(0.0):
            self._switch(False)
        elif not self._said_unswitched:
            self._said_unswitched = True
            log.info("the robot does not offer %s: its motors stay on", topics.MOTOR_POWER.key)

    def switch_on(self) -> bool:
        """Give the motors power, unless they are known to have it; whether they have it only now."""
        if self._powered or not self._power_client.wait_for_server(0.0):
            return False
        return self._switch(True)

    def _switch(self, on: bool) -> bool:
        """Whether the body did it. Work continues either way: what needs power fails by itself."""
        self._powered = None
        try:
            reply = self._power_client.call(types.new(f"{topics.MOTOR_POWER.type}_Request", data=on))
        except Ros2Error as error:
            log.warning("the motors were not switched %s: %s", "on" if on else "off", error)
            return False
        if not reply.success:
            log.warning("the motors were not switched %s: %s", "on" if on else "off", reply.message)
            return False
        self._powered = on
        return True

    def grip(self, position_m: float, force_n: float) -> Grip:
        """Move each finger to `position_m` from the middle, pushing with at most `force_n`."""
        command = types.new("control_msgs/msg/GripperCommand", position=position_m, max_effort=force_n)
        goal = types.new(f"{topics.GRIPPER_CMD.type}_Goal", command=command)
        result = self._execute(self._grip, lambda: goal)
        if not math.isfinite(result.position):
            raise MotionFailed("the gripper does not say where its fingers are", position=result.position)
        return Grip(float(result.position), bool(result.stalled))

    def _execute(
        self,
        client: ActionClient,
        make_goal: Callable[[], Any],
        feedback: Callable[[Any], None] | None = None,
    ) -> Any:
        refused = False
        while True:
            self.interrupts.check()
            if not client.wait_for_server(_SLICE_S):
                continue
            self.switch_on()
            try:
                return self._finish(client.send_goal(make_goal(), feedback))
            except (ActionServerLost, ActionServerUnavailable, ServiceTimeout, BodySilent) as error:
                log.warning("%s; starting this motion again", error)
            except (GoalAborted, GoalCanceled) as error:
                raise MotionFailed(error.message, action=client.name, result=_plain(error.result)) from error
            except GoalRejected as error:
                # Somebody else may have switched the motors off.
                self._powered = None
                if refused or not self.switch_on():
                    raise MotionFailed(error.message, action=client.name) from error
                refused = True
            finally:
                self._moved_s = self._clock.now_s()

    def _finish(self, goal: ClientGoal) -> Any:
        """Wait for the goal's end; when an interrupt raises, it stops the body first."""
        try:
            goal.wait(self.interrupts.check)
        except Exception:  # whatever it is, it is raised again
            _cancel(goal)
            raise
        return goal.result()


def _joints(message: Any, arm: ArmModel) -> Joints:
    position = dict(zip(message.name, message.position, strict=False))
    left, right = (position[name] for name in arm.fingers)
    return Joints(np.array([position[name] for name in arm.joints]), float(left - right) / 2)


def _cancel(goal: ClientGoal) -> None:
    try:
        goal.cancel()
        goal.result(2.0)
    except Ros2Error as error:
        # It is being given up for a reason of its own, which the caller raises.
        log.info("gave up a motion: %s", error)


def _plain(result: Any) -> dict[str, Any]:
    # Constants of the definition are attributes too, in capitals.
    return {name: value for name, value in vars(result).items() if name.islower() and name[0] != "_"}


def _follow_goal(trajectory: Trajectory, arm: ArmModel) -> Any:
    points = [
        types.new(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=position,
            velocities=velocity,
            time_from_start=types.duration_message(round(float(time_s) * 1e9)),
        )
        for time_s, position, velocity in _rows(trajectory)
    ]
    message = types.new("trajectory_msgs/msg/JointTrajectory", joint_names=list(arm.joints), points=points)
    tolerance = types.new("builtin_interfaces/msg/Duration", sec=_GOAL_TIME_TOLERANCE_S)
    return types.new(
        f"{topics.FOLLOW_JOINT_TRAJECTORY.type}_Goal", trajectory=message, goal_time_tolerance=tolerance
    )


def _rows(trajectory: Trajectory) -> Sequence[tuple[float, Vector, Vector]]:
    return list(zip(trajectory.times_s, trajectory.positions, trajectory.velocities, strict=True))
