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

from rodeo.bus.messages import ClockOffset
from rodeo.checks.counts import COUNTS
from rodeo.evidence.container import Limits
from rodeo.host.clock import Clock, Patience
from rodeo.lab.arm import ArmModel
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.geometry import on_plane, quaternion_of
from rodeo.lab.layout import on_contacts
from rodeo.lab.world import CONTROL_PERIOD_S, GRIPPER_CLOSED_M, GRIPPER_OPEN_M, arm_model
from rodeo.recording.pace import LEAST_WORK_S, Pace
from rodeo.robot.arm import Trajectory, Vector
from rodeo.robot.errors import BodySilent, MotionFailed
from rodeo.robot.interrupts import Interrupts
from rodeo.ros2 import plain, readings, types
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
from rodeo.ros2.readings import MOST_PUBLISHERS, SILENT_WALL_S, Unknown
from rodeo.ros2.service import Client
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.sections import GRIPPER_TRAJECTORY, STOP_RESET, STOP_TRIGGER, interface_of

log = logging.getLogger(__name__)

_SLICE_S = 0.1
_SILENT_AFTER_S = 10.0
"""Without a message until the body counts as silent, see `Patience`."""
_FRESH_S = 0.1
"""Site time for which a message tells how things are now, unless a motion ended since it came."""
_LASTING_S = 2.0
"""Invalid values for this time are more than a single bad message. A driver that starts publishes zeros
before its first measurement."""
_CLOCK_BEHIND_S = 1.0
"""Site time by which a simulated clock is heard late at most: no stamp is believed that is further ahead."""
_GOAL_TIME_TOLERANCE_S = 3
_GRIP_S = 1.0
"""For a gripper that follows trajectories: time to close or open."""
STALLED_M = 0.001
"""A finger that stops this far from its goal has met something."""
NOTHING_HELD_M = GRIPPER_CLOSED_M + 0.001
OPEN_ENOUGH_M = GRIPPER_OPEN_M - 0.004


@dataclass(frozen=True)
class Joints:
    """`arm_rad`, one for each joint from the base to the hand, and half the gap between the fingers."""

    arm_rad: Vector
    gripper_m: float
    efforts_nm: Vector | None = None
    """(joints,) of the arm; None where nobody says all of them."""


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

    gid: bytes
    cdr: bytes
    number: int
    wall_s: float
    site_s: float
    """When it came, by the wall's clock and by the site's."""


class _Said(NamedTuple):
    """What publishers of joint states say together."""

    joints: Joints
    without_effort: list[str]
    """Fingers of which nobody says the effort."""


Read = Callable[[list[Any]], tuple[Any, frozenset[int]]]


class Latest:
    """The newest message of one topic; decoded when it is asked for.

    Args:
        read: what the newest messages of the publishers that are followed say, and which of them say it.
            Raises Unknown.
        publishers: how many are followed, in the order in which they were heard first.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        typename: str,
        clock: Clock,
        interrupts: Interrupts,
        simulated: bool,
        read: Read = lambda messages: (messages[0], frozenset({0})),
        publishers: int = 1,
    ) -> None:
        self.topic = topic
        self.problem = ""
        """Why the messages that were decoded last cannot be used."""
        self._problem_s = math.inf
        """Site time since which there is one."""
        self._read, self._publishers = read, publishers
        self._simulated = simulated
        self._interrupts = interrupts
        types.prepare(typename)
        self._clock = clock
        self._typename = typename
        self._newest: dict[bytes, _Arrival] = {}
        """By publisher."""
        self._decoded: dict[bytes, tuple[int, Any]] = {}
        """Publisher -> its last message that was decoded, and the number of that."""
        # Inline, because a message that waits in a queue of its own while the result of a motion overtakes
        # it would show the arm where it was before.
        node.raw_subscription(topic, typename, self._on_message, inline=True)

    def _on_message(self, info: MessageInfo) -> None:
        before, wall_s, site_s = self._newest.get(info.gid), time.monotonic(), self._clock.now_s()
        if before is None:
            silent = [gid for gid, one in self._newest.items() if wall_s - one.wall_s >= SILENT_WALL_S]
            if len(self._newest) - len(silent) >= self._publishers:
                return  # another speaks already
            # Replaced as a whole: others look meanwhile.
            self._newest = {gid: one for gid, one in self._newest.items() if gid not in silent}
        number = 1 if before is None else before.number + 1
        self._newest[info.gid] = _Arrival(info.gid, info.cdr, number, wall_s, site_s)

    def recent(self) -> Any:
        """What is known without waiting, None when that cannot be used or is older than `_SILENT_AFTER_S`.
        While the site's clock stands nobody says more, and it gets no older."""
        wall_s, site_s = time.monotonic(), self._clock.now_s()
        newest = [
            one
            for one in self._newest.copy().values()
            if min(wall_s - one.wall_s, site_s - one.site_s) < _SILENT_AFTER_S
        ]
        return self._said(newest)[0]

    def lasting_problem(self) -> str:
        """Why nothing can be used that was said for a while; "" while there is no such reason."""
        self.recent()
        lasts = self.problem and self._clock.now_s() - self._problem_s >= _LASTING_S
        return self.problem if lasts else ""

    def since(self, moved_s: float) -> Any:
        """What is known, if all of it is fresh and came after `moved_s`, else what comes next.

        Raises BodySilent. What is asked after a motion must not be answered with what was sent before it.
        A simulated body says how it is at the end of a motion before it says that it has ended, so a message
        with the stamp of that moment will do.
        """
        said, used = self._said([*self._newest.copy().values()])
        return said if said is not None and all(self._tells(one, moved_s) for one in used) else self.next()

    def _tells(self, newest: _Arrival, moved_s: float) -> bool:
        arrived_s = self._arrived_s(newest)
        told = arrived_s > moved_s or (self._simulated and self._stamp_s(newest) == moved_s)
        return told and self._clock.now_s() - arrived_s < _FRESH_S

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
        """What is said from now on and can be used. Raises BodySilent."""
        patience = Patience(self._clock, _SILENT_AFTER_S)
        before = {gid: one.number for gid, one in self._newest.copy().items()}
        seen = sum(before.values())
        while not patience.is_over:
            # A body tells its state each period; a simulated one has told it when that has passed.
            patience.pause(CONTROL_PERIOD_S)
            newest = [*self._newest.copy().values()]
            if (now := sum(one.number for one in newest)) != seen:
                seen = now
                said, used = self._said(newest)
                if said is not None and all(one.number != before.get(one.gid) for one in used):
                    return said
            self._interrupts.check()
        said = f"no fresh message on {self.topic}" + (f" can be used: {self.problem}" if self.problem else "")
        raise BodySilent(said, topic=self.topic, silent_s=_SILENT_AFTER_S)

    def _said(self, newest: Sequence[_Arrival]) -> tuple[Any, list[_Arrival]]:
        """What these say, None where that cannot be used, and which of them say it."""
        problem, known, messages = "", list[_Arrival](), list[Any]()
        for one in newest:
            number, message = self._decoded.get(one.gid, (0, None))
            if number != one.number:
                try:
                    message = types.deserialize(one.cdr, self._typename)
                except MalformedMessage as error:
                    problem = str(error)
                    continue
                self._decoded[one.gid] = one.number, message
            known.append(one)
            messages.append(message)
        said, used = None, frozenset[int]()
        if messages:
            try:
                said, used = self._read(messages)
                problem = ""
            except Unknown as error:
                problem = error.message
        elif not newest:
            return None, []
        if problem and not self.problem:
            self._problem_s = self._clock.now_s()
            log.warning("ignored a message on %s: %s", self.topic, problem)
        elif self.problem and not problem:
            log.info("messages on %s can be used again", self.topic)
        self.problem = problem
        return said, [known[number] for number in used]


class Gauge(Latest):
    """The newest message of the battery, and how much of its charge is believed."""

    def __init__(
        self, node: Node, robot: RobotConfig, clock: Clock, interrupts: Interrupts, simulated: bool
    ) -> None:
        topic, full = topics.BATTERY_STATE, robot.battery.percentage_full
        self._charge, self._soc = readings.Charge(robot.battery.capacity_ah), math.nan

        def read(messages: list[Any]) -> tuple[Any, frozenset[int]]:
            return readings.battery(messages[0], full), frozenset({0})

        name = topic.name(ns=robot.namespace)
        super().__init__(node, name, topic.type, clock, interrupts, simulated, read)

    def _on_message(self, info: MessageInfo) -> None:
        super()._on_message(info)
        if (said := self.recent()) is not None:
            self._soc = self._charge.believed(said)

    def believed(self, said: readings.Battery) -> float:
        """State of charge, that of the message where no other one came yet."""
        return said.soc if math.isnan(self._soc) else self._soc


class Switches:
    """The services by which a body holds still (`sections.InterfaceConfig`), and `power` of its motors."""

    def __init__(self, node: Node, robot: RobotConfig) -> None:
        self.power = node.client(topics.MOTOR_POWER.name(ns=robot.namespace), topics.MOTOR_POWER.type)
        self._calls: dict[bool, tuple[Client, Any]] = {}
        """Whether to engage it -> whom to ask, and what."""
        if interface_of(robot).emergency_stop == "husarion":
            for engage, one in ((True, STOP_TRIGGER), (False, STOP_RESET)):
                client = node.client(one.name(ns=robot.namespace), one.type)
                self._calls[engage] = client, types.new(f"{one.type}_Request")
            return
        topic = topics.EMERGENCY_STOP
        client = node.client(topic.name(ns=robot.namespace), topic.type)
        for engage in (True, False):
            self._calls[engage] = client, types.new(f"{topic.type}_Request", data=engage)

    def stop(self, engage: bool) -> None:
        """Hold still, or let go. A body without that service is only told to stop."""
        client, request = self._calls[engage]
        if not client.wait_for_server(0.0):
            return
        try:
            answer = client.call(request)
        except Ros2Error as error:
            log.warning("the emergency stop does not answer: %s", error)
            return
        if not answer.success:
            log.warning("the emergency stop was not %s: %s", "set" if engage else "released", answer.message)


class Gripper:
    """The fingers' controller (`sections.InterfaceConfig`), as goals and results of an action."""

    def __init__(self, node: Node, robot: RobotConfig, fingers: tuple[str, str], clock: Clock) -> None:
        self._fingers = fingers
        self.follows = interface_of(robot).gripper == "trajectory"
        """Whether it follows trajectories, and says nothing of its own of what it holds."""
        action = GRIPPER_TRAJECTORY if self.follows else topics.GRIPPER_CMD
        self.client = ActionClient(node, action.name(ns=robot.namespace), action.type, clock=clock)

    def goal(self, position_m: float, force_n: float) -> Any:
        """To move each finger to `position_m` from the middle."""
        if not self.follows:
            command = types.new("control_msgs/msg/GripperCommand", position=position_m, max_effort=force_n)
            return types.new(f"{topics.GRIPPER_CMD.type}_Goal", command=command)
        until = types.duration_message(round(_GRIP_S * 1e9))
        point = types.new(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=np.array([position_m, -position_m]),
            time_from_start=until,
        )
        message = types.new(
            "trajectory_msgs/msg/JointTrajectory", joint_names=list(self._fingers), points=[point]
        )
        tolerance = types.new("builtin_interfaces/msg/Duration", sec=_GOAL_TIME_TOLERANCE_S)
        return types.new(f"{GRIPPER_TRAJECTORY.type}_Goal", trajectory=message, goal_time_tolerance=tolerance)

    def ended(self, result: Any) -> Grip:
        """How a command ended, by the result of a gripper that says so. Raises MotionFailed."""
        try:
            return Grip(readings.JOINT.known(result.position), bool(result.stalled))
        except Unknown as error:
            raise MotionFailed(f"the gripper does not say where its fingers are: {error.message}") from error


class RosBody:
    """What a robot tells of itself over ROS 2, and the motions that it offers.

    Motions block until the body reports their end; while the body is away they wait for it and start
    again. They raise MotionFailed when the body gives up, and whatever `interrupts` raise.
    """

    def __init__(
        self,
        node: Node,
        site: Site,
        robot: RobotConfig,
        clock: Clock,
        interrupts: Interrupts,
        offset: Callable[[], ClockOffset | None] = lambda: None,
    ) -> None:
        """`offset` is how far `clock` is off the site's time, None where nobody knows."""
        self.interrupts = interrupts
        names, simulated = {"ns": robot.namespace}, site.clock.source == "sim"

        def latest(topic: topics.Topic, read: Read, name: str, publishers: int = 1) -> Latest:
            return Latest(node, name, topic.type, clock, interrupts, simulated, read, publishers)

        arm = self._arm_model = arm_model(robot.kinematics)
        wanted = (*arm.joints, *arm.fingers) if interface_of(robot).arm else ()
        most = COUNTS.limits(Limits().file_bytes)
        self._pace = Pace(node, site, robot, clock, wanted, most, offset)

        def gather(messages: list[Any]) -> tuple[Any, frozenset[int]]:
            if not wanted:
                return None, frozenset()
            found, used = readings.joints(messages, wanted)
            efforts = readings.efforts(messages)
            silent = [finger for finger in arm.fingers if finger not in efforts]
            return _Said(_joints(found, arm, efforts), silent), used

        self._joint_states = latest(
            topics.JOINT_STATES, gather, topics.JOINT_STATES.name(**names), MOST_PUBLISHERS
        )
        self._battery = Gauge(node, robot, clock, interrupts, simulated)
        pose = topics.MOCAP_POSE.name(body=robot.name) if site.lab.mocap else topics.POSE.name(**names)
        self._pose = latest(
            topics.MOCAP_POSE, lambda messages: (readings.pose(messages[0].pose), frozenset({0})), pose
        )
        self._clock = clock
        self._docks = site.docks
        self._navigate, self._follow = (
            ActionClient(node, action.name(**names), action.type, clock=clock)
            for action in (topics.NAVIGATE_TO_POSE, topics.FOLLOW_JOINT_TRAJECTORY)
        )
        self._gripper = Gripper(node, robot, arm.fingers, clock)
        self._moved_s = -math.inf
        """Site time at which the last motion ended."""
        self._switches = Switches(node, robot)
        self._powered: bool | None = None
        """As the body confirmed it last; None before it did."""
        self._said_unswitched = False

    # -- perception ------------------------------------------------------------------------------------

    def base_pose(self) -> Pose2:
        """Where the base stands now. Raises BodySilent."""
        return on_plane(self._pose.since(self._moved_s))

    def joints(self) -> Joints:
        """Raises BodySilent."""
        said: _Said = self._joint_states.since(self._moved_s)
        return said.joints

    def recent_gripper_m(self) -> float | None:
        """Half the gap between the fingers a moment ago, None when nobody says so."""
        said: _Said | None = self._joint_states.recent()
        return None if said is None else said.joints.gripper_m

    def recent_efforts_nm(self) -> Vector | None:
        """Torques of the arm's joints a moment ago, None when nobody says them."""
        said: _Said | None = self._joint_states.recent()
        return None if said is None else said.joints.efforts_nm

    def battery(self) -> Battery:
        """Raises BodySilent."""
        # At 1 Hz a recent one is as good as the next, and an assignment need not wait for it.
        message = self._battery.recent() or self._battery.next()
        return Battery(self._battery.believed(message), message.charging)

    def vitals(self) -> dict[str, Any]:
        """State of charge and whether the robot is docked, as far as recently heard, and what is unknown
        because of what the body says, for the robot's status."""
        heard: dict[str, Any] = {}
        battery, pose = self._battery.recent(), self._pose.recent()
        if battery is not None:
            heard["soc"] = round(self._battery.believed(battery), 3)
        if pose is not None:
            base = on_plane(pose)
            heard["docked"] = any(on_contacts(dock, base) for dock in self._docks)
        if unknown := self.unknown:
            heard["unknown"] = unknown
        return heard

    @property
    def unknown(self) -> str:
        """What the body says that cannot be used, and why; "" if there is none."""
        heard = (self._battery, self._pose, self._joint_states)
        return "; ".join(f"{one.topic}: {one.problem}" for one in heard if one.problem)

    @property
    def wrong_clock(self) -> str:
        """Which of the robot's computers does not have the site's time; "" while none is known."""
        return self._pace.stamps.problem

    def unfit(self, work_s: float = LEAST_WORK_S) -> str:
        """Why no work of `work_s` can be proved with a body that speaks so, as far as it was heard; "" if it
        can."""
        if said := self._pace.misfit(self._clock.now_s(), work_s):
            return said
        for one in (self._battery, self._pose, self._joint_states):
            if said := one.lasting_problem():
                return f"{one.topic}: {said}"
        joints: _Said | None = self._joint_states.recent()
        if joints is not None and joints.without_effort:
            return f"{self._joint_states.topic}: no effort of {', '.join(joints.without_effort)}"
        return ""

    def recent_base_pose(self) -> Pose2 | None:
        """Where the base stood a moment ago, None when nobody says so."""
        pose = self._pose.recent()
        return None if pose is None else on_plane(pose)

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
        self._switches.stop(engage)

    def switch_off(self) -> None:
        """Cut the motors' power. A body without that service keeps it, which is said once."""
        if self._switches.power.wait_for_server(0.0):
            self._switch(False)
        elif not self._said_unswitched:
            self._said_unswitched = True
            log.info("the robot does not offer %s: its motors stay on", topics.MOTOR_POWER.key)

    def switch_on(self) -> bool:
        """Give the motors power, unless they are known to have it; whether they have it only now."""
        if self._powered or not self._switches.power.wait_for_server(0.0):
            return False
        return self._switch(True)

    def _switch(self, on: bool) -> bool:
        """Whether the body did it. Work continues either way: what needs power fails by itself."""
        self._powered = None
        try:
            reply = self._switches.power.call(types.new(f"{topics.MOTOR_POWER.type}_Request", data=on))
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
        goal = self._gripper.goal(position_m, force_n)
        try:
            result = self._execute(self._gripper.client, lambda: goal)
        except MotionFailed as error:
            # A controller of trajectories gives up where something is between the fingers.
            if not self._gripper.follows or not isinstance(error.__cause__, GoalAborted):
                raise
        if not self._gripper.follows:
            return self._gripper.ended(result)
        reached_m = self.joints().gripper_m
        return Grip(reached_m, abs(reached_m - position_m) > STALLED_M)

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
            goal.wait(check=self.interrupts.check)
        except Exception:  # whatever it is, it is raised again
            _cancel(goal)
            raise
        return goal.result()


def holds_something(gripper_m: float) -> bool:
    """Whether fingers, half a gap of `gripper_m` apart, closed on something: neither closed nor open."""
    return NOTHING_HELD_M < gripper_m < OPEN_ENOUGH_M


def _joints(position: dict[str, float], arm: ArmModel, effort: dict[str, float]) -> Joints:
    left, right = (position[name] for name in arm.fingers)
    known = np.array([effort[name] for name in arm.joints]) if {*arm.joints} <= effort.keys() else None
    return Joints(np.array([position[name] for name in arm.joints]), float(left - right) / 2, known)


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
