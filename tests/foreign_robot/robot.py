"""A robot of another make: ROS 2 by zenoh-ros2-sdk alone, kinematics instead of physics, no import of RODEO.

It is both the robot and the world that it acts on. As the robot it publishes odometry, joints, battery, scan
and depth, and serves the three actions and the emergency stop. As the world it tells the simulated lab where
the robot is, and where the item is while the robot carries it (`lab/set_entity_state`).

python tests/foreign_robot/robot.py --port 7447 --namespace arthur --body arthur --urdf robot.urdf
    --pose 1.8 1.6 0 --item item1 --item-radius 0.0265 --item-half-height 0.05
"""

from __future__ import annotations

import argparse
import math
import queue
from typing import Any

import mujoco
import numpy as np
from actions import ABORTED, CANCELED, SUCCEEDED, ActionServer, Goal
from interfaces import SERVICES, Network

STEP_S = 0.02
LATE_S = 0.03
"""Behind the lab's clock by more than this it slows down, to a stand if need be."""
PACE_PER_STEP = 0.1
"""How fast it slows down and speeds up again: what it holds must not feel a jerk."""
ARM = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")
FINGERS = ("left_finger", "right_finger")
WHEELS = ("fl_wheel_joint", "fr_wheel_joint", "rl_wheel_joint", "rr_wheel_joint")
STOWED_RAD = (0.0, -1.1, 0.55, 0.0, 1.77, 0.0)
CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
OPEN_M, CLOSED_M, PAD_M = 0.057, 0.021, 0.008
GRIP_N = 5.0
SPEED_M_S, SPEED_UP_M_S2 = 0.4, 0.5
TURN_RAD_S, TURN_UP_RAD_S2 = 0.6, 1.0
IN_AND_OUT_M = 0.5
"""A goal is driven into, and left, straight along its heading for this far."""
WHEEL_M = 0.1852
ROOM_M = (7.0, 5.0)
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 96, 72, 55.0


def wrap(angle_rad: float) -> float:
    return math.remainder(angle_rad, math.tau)


def hermite(time_s: float, times_s: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The cubic through `values` (n, k) at `times_s` (n,) with `slopes` (n, k), as ros2_control has it."""
    k = min(max(int(np.searchsorted(times_s, time_s, "right")) - 1, 0), max(len(times_s) - 2, 0))
    if len(times_s) == 1:
        return values[0]
    span_s = times_s[k + 1] - times_s[k]
    u = (time_s - times_s[k]) / span_s
    ahead = values[k + 1] - values[k]
    begin, end = slopes[k] * span_s - ahead, ahead - slopes[k + 1] * span_s
    return values[k] + u * ahead + u * (1 - u) * (begin * (1 - u) + end * u)


class Base:
    """Where it stands, and the legs of the drive under way: ("turn", yaw) or ("go", x, y, sign)."""

    def __init__(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        self.x_m, self.y_m, self.yaw_rad = x_m, y_m, yaw_rad
        self.speed_m_s, self.turn_rad_s, self.way_m = 0.0, 0.0, 0.0
        self.fastest_m_s, self.fastest_rad_s = SPEED_M_S, TURN_RAD_S
        self.legs: list[tuple[Any, ...]] = []
        self.parked = False
        """Whether it leaves where it stands straight back."""
        self.straight_m = IN_AND_OUT_M
        """How far it drives straight at the end of a way."""

    def drive_to(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        begin = (x_m - self.straight_m * c, y_m - self.straight_m * s)
        self.legs = []
        here = (self.x_m, self.y_m)
        if self.parked:
            back = math.cos(self.yaw_rad) * IN_AND_OUT_M, math.sin(self.yaw_rad) * IN_AND_OUT_M
            here = (self.x_m - back[0], self.y_m - back[1])
            self.legs.append(("go", *here, -1))
        if math.dist(here, begin) > 0.01:
            bearing = math.atan2(begin[1] - here[1], begin[0] - here[0])
            self.legs += [("turn", bearing), ("go", *begin, 1)]
        self.legs += [("turn", yaw_rad), ("go", x_m, y_m, 1)]
        self.parked = True

    def stop(self) -> None:
        self.legs, self.speed_m_s, self.turn_rad_s = [], 0.0, 0.0

    def step(self, dt_s: float) -> None:
        if not self.legs:
            self.speed_m_s = self.turn_rad_s = 0.0
            return
        kind, *target = self.legs[0]
        if kind == "turn":
            self.speed_m_s = 0.0
            error = wrap(target[0] - self.yaw_rad)
            step = math.copysign(
                self._ramp(self.turn_rad_s, self.fastest_rad_s, TURN_UP_RAD_S2, abs(error), dt_s), error
            )
            self.yaw_rad, self.turn_rad_s = wrap(self.yaw_rad + step), step / dt_s
            if abs(error) - abs(step) < 1e-6:
                self.legs.pop(0)
                self.turn_rad_s = 0.0
            return
        x_m, y_m, sign = target
        left_m = math.dist((self.x_m, self.y_m), (x_m, y_m))
        step = self._ramp(self.speed_m_s, self.fastest_m_s, SPEED_UP_M_S2, left_m, dt_s)
        if left_m > 0:
            self.x_m += (x_m - self.x_m) / left_m * step
            self.y_m += (y_m - self.y_m) / left_m * step
        self.speed_m_s = sign * step / dt_s
        self.way_m += sign * step
        if left_m - step < 1e-6:
            self.legs.pop(0)

    @staticmethod
    def _ramp(speed: float, fastest: float, acceleration: float, left: float, dt_s: float) -> float:
        """How far to go in this step: faster and slower gently, and not beyond what is left."""
        wanted = min(fastest, abs(speed) + acceleration * dt_s, math.sqrt(2 * acceleration * left))
        return min(left, max(wanted, 0.02) * dt_s)


class Robot:
    def __init__(self, arguments: argparse.Namespace, network: Any) -> None:
        """`network` is a `Network`, or has the same methods."""
        self._body_name, self._item_name = arguments.body, arguments.item
        self._ns = arguments.namespace
        self._radius_m, self._half_height_m = arguments.item_radius, arguments.item_half_height
        self.base = Base(*arguments.pose)
        self.arm = np.array(STOWED_RAD)
        self.gripper_m, self._holding = OPEN_M, False
        self._wanted_m = OPEN_M
        self._joints = self._joint_positions()
        self._in_hand: tuple[np.ndarray, np.ndarray] | None = None
        self._item: tuple[np.ndarray, np.ndarray] | None = None
        self._let_go: tuple[np.ndarray, np.ndarray] | None = None
        """Where the hand has just opened."""
        self._told: tuple[float, float, float] | None = None
        """Where the lab was last told that the base is."""
        self.stopped = False
        self.voltage_v, self.current_a, self.soc, self.capacity_ah = 41.0, -2.0, 0.9, 20.0
        self._time_s: float | None = None
        self.stamps_ahead_s, self.odometry_share = 0.0, 1.0
        """By how much its clock is off, and what its odometry shows of the way."""
        self._pace, self._moved_s = 1.0, 0.0
        """How fast its own time goes, and how much of it has passed."""
        self._tick = 0
        self._drive: Goal | None = None
        self._trajectory: tuple[Goal, float, np.ndarray, np.ndarray, np.ndarray] | None = None
        self._grip: Goal | None = None
        spec = mujoco.MjSpec.from_file(str(arguments.urdf))
        spec.compiler.fusestatic = False
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._network = network
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._open_publishers()
        self._serve()
        self._join_lab()

    def _join_lab(self) -> None:
        """Hear of the lab's time and item, and open what tells it of the robot."""
        network = self._network
        self._entity = network.client("lab/set_entity_state", "simulation_interfaces/srv/SetEntityState")
        network.subscriber(f"mocap/{self._item_name}/pose", "geometry_msgs/msg/PoseStamped", self._on_item)
        network.subscriber("clock", "rosgraph_msgs/msg/Clock", self._inbox.put)

    def _open_publishers(self) -> None:
        self._publishers = {
            name: self._network.publisher(f"{self._ns}/{name}", typename)
            for name, typename in (
                ("odom", "nav_msgs/msg/Odometry"),
                ("joint_states", "sensor_msgs/msg/JointState"),
                ("arm_controller/controller_state", CONTROLLER_STATE),
                ("gripper_controller/controller_state", CONTROLLER_STATE),
                ("battery_state", "sensor_msgs/msg/BatteryState"),
                ("scan", "sensor_msgs/msg/LaserScan"),
                ("wrist_camera/depth/image_rect_raw", "sensor_msgs/msg/Image"),
                ("wrist_camera/depth/camera_info", "sensor_msgs/msg/CameraInfo"),
            )
        }

    def _serve(self) -> None:
        network, name = self._network, self._ns

        def refuse() -> bool:
            return self.stopped

        def put(kind: str) -> Any:
            return lambda goal: self._inbox.put((kind, goal))

        self._drives = ActionServer(
            network,
            f"{name}/navigate_to_pose",
            "nav2_msgs/action/NavigateToPose",
            put("drive"),
            refuse,
            {"error_code": 0},
        )
        self._motions = ActionServer(
            network,
            f"{name}/arm_controller/follow_joint_trajectory",
            "control_msgs/action/FollowJointTrajectory",
            put("arm"),
            refuse,
            {"error_code": 0, "error_string": ""},
        )
        self._grips = ActionServer(
            network,
            f"{name}/gripper_controller/gripper_cmd",
            "control_msgs/action/GripperCommand",
            put("grip"),
            refuse,
            {"position": 0.0, "effort": 0.0, "stalled": False, "reached_goal": False},
        )
        stop = "std_srvs/srv/SetBool"
        network.server(f"{name}/emergency_stop", stop, SERVICES[stop], callback=self._on_stop)

    def _on_stop(self, request: Any) -> Any:
        self.stopped = bool(request.data)
        return self._network.new("std_srvs/srv/msg/SetBool_Response", success=True, message="")

    def _on_item(self, message: Any) -> None:
        p, q = message.pose.position, message.pose.orientation
        self._item = np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z])

    # -- going on ----------------------------------------------------------------------------------

    def run(self) -> None:
        """Live by the lab's clock."""
        while True:
            self.live_until(self._listen())

    def live_until(self, now_s: float) -> None:
        """Do in steps of 20 ms what happens meanwhile."""
        if self._time_s is None:
            self._time_s = now_s - STEP_S
        while self._time_s + STEP_S <= now_s + 1e-4:
            self._time_s += STEP_S
            # On a machine that is late the robot waits: the lab must see all that it does.
            change = PACE_PER_STEP if now_s - self._time_s < LATE_S else -PACE_PER_STEP
            self._pace = min(1.0, max(0.0, self._pace + change))
            if self._pace > 0:
                self._moved_s += STEP_S * self._pace
                self._move(STEP_S * self._pace)
            self._publish(self._time_s)
            self._tick += 1
        self._tell_the_lab()

    def _listen(self) -> float:
        """The newest time of the lab's clock; goals that came meanwhile are begun."""
        now_s: float | None = None
        while now_s is None or not self._inbox.empty():
            message = self._inbox.get()
            if isinstance(message, tuple):
                self._begin(*message)
            else:
                now_s = self._network.seconds(message.clock)
        return now_s

    def _begin(self, kind: str, goal: Goal) -> None:
        if kind == "drive":
            at, q = goal.request.pose.pose.position, goal.request.pose.pose.orientation
            if self._drive is not None:
                self._drive.end(CANCELED)
            self._drive = goal
            self.base.drive_to(at.x, at.y, 2 * math.atan2(q.z, q.w))
        elif kind == "arm":
            trajectory = goal.request.trajectory
            order = [list(trajectory.joint_names).index(name) for name in ARM]
            points = trajectory.points
            times = np.array([self._network.seconds(p.time_from_start) for p in points])
            positions = np.array([np.asarray(p.positions)[order] for p in points])
            speeds = np.array([np.asarray(p.velocities)[order] for p in points])
            if self._trajectory is not None:
                self._trajectory[0].end(CANCELED)
            if times[0] > 0:
                times, positions = np.r_[0.0, times], np.vstack([self.arm, positions])
                speeds = np.vstack([np.zeros(6), speeds])
            self._trajectory = goal, self._moved_s, times, positions, speeds
        else:
            if self._grip is not None:
                self._grip.end(CANCELED, position=self.gripper_m)
            self._grip = goal

    def _move(self, dt_s: float) -> None:
        if self.stopped:
            self._abort()
        self.base.step(dt_s)
        self._step_drive()
        self._step_arm()
        self._step_gripper(dt_s)
        self._place()
        if self._in_hand is not None:
            self._item = self._carried()

    def _abort(self) -> None:
        self.base.stop()
        if self._drive is not None:
            self._drive.end(ABORTED, error_code=100)
        if self._trajectory is not None:
            self._trajectory[0].end(ABORTED, error_code=-1, error_string="emergency stop")
        if self._grip is not None:
            self._grip.end(ABORTED, position=self.gripper_m)
        self._drive = self._trajectory = self._grip = None

    def _step_drive(self) -> None:
        goal = self._drive
        if goal is None:
            return
        if goal.cancel:
            self.base.stop()
            goal.end(CANCELED)
            self._drive = None
        elif not self.base.legs:
            goal.end(SUCCEEDED)
            self._drive = None
        elif self._tick % 10 == 0:
            new, none = self._network.new, {"sec": 0, "nanosec": 0}
            pose = self._pose(np.array([self.base.x_m, self.base.y_m, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]))
            self._drives.feedback(
                goal,
                current_pose=new(
                    "geometry_msgs/msg/PoseStamped",
                    header=self._header(self._time_s or 0.0, "map"),
                    pose=pose,
                ),
                navigation_time=new("builtin_interfaces/msg/Duration", **none),
                estimated_time_remaining=new("builtin_interfaces/msg/Duration", **none),
                number_of_recoveries=0,
                distance_remaining=float(len(self.base.legs)),
            )

    def _step_arm(self) -> None:
        if self._trajectory is None:
            return
        goal, began_s, times, positions, speeds = self._trajectory
        elapsed_s = self._moved_s - began_s
        self.arm = hermite(min(elapsed_s, times[-1]), times, positions, speeds)
        if goal.cancel or elapsed_s >= times[-1]:
            goal.end(CANCELED if goal.cancel else SUCCEEDED)
            self._trajectory = None

    def _step_gripper(self, dt_s: float) -> None:
        goal = self._grip
        if goal is None:
            return
        wanted = min(OPEN_M, max(CLOSED_M, goal.request.command.position))
        self._wanted_m = wanted
        stops_m = self._radius_m + PAD_M if self._item_between_pads() else CLOSED_M
        step = 0.06 * dt_s
        target = max(wanted, stops_m)
        self.gripper_m += max(-step, min(step, target - self.gripper_m))
        there = abs(self.gripper_m - target) < 1e-4
        blocked = there and target > wanted + 1e-4
        if blocked and stops_m > CLOSED_M and self._in_hand is None:
            self._take()
        if wanted > self.gripper_m + 1e-4 or (there and not blocked):
            if self._in_hand is not None:
                self._let_go = self._carried()
            self._holding, self._in_hand = False, None
        if there or goal.cancel:
            stalled = goal.request.command.position < target - 1e-3
            goal.end(
                CANCELED if goal.cancel else SUCCEEDED,
                position=self.gripper_m,
                effort=GRIP_N,
                stalled=stalled,
                reached_goal=not stalled,
            )
            self._grip = None

    # -- the world ---------------------------------------------------------------------------------

    def _place(self) -> None:
        joints = self._data.joint
        for name, position in zip(ARM, self.arm, strict=True):
            joints(name).qpos[0] = position
        for name, side in zip(FINGERS, (1, -1), strict=True):
            joints(name).qpos[0] = side * self.gripper_m
        mujoco.mj_kinematics(self._model, self._data)

    def _in_map(self, link: str) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and rotation (3, 3) of a link."""
        base = self.base
        c, s = math.cos(base.yaw_rad), math.sin(base.yaw_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        body = self._data.body(link)
        return turn @ body.xpos + (base.x_m, base.y_m, 0.0), turn @ body.xmat.reshape(3, 3)

    def _item_between_pads(self) -> bool:
        if self._in_hand is not None:
            return True
        if self._item is None:
            return False
        grasp, _ = self._in_map("grasp")
        offset = self._item[0] - grasp
        return math.hypot(offset[0], offset[1]) < 0.03 and abs(offset[2]) < self._half_height_m + 0.02

    def _take(self) -> None:
        assert self._item is not None
        grasp, rotation = self._in_map("grasp")
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, self._item[1])
        self._in_hand = rotation.T @ (self._item[0] - grasp), rotation.T @ turn.reshape(3, 3)
        # The pads centre what they close on.
        self._in_hand[0][1] = 0.0
        self._holding = True

    def _carried(self) -> tuple[np.ndarray, np.ndarray]:
        assert self._in_hand is not None
        grasp, rotation = self._in_map("grasp")
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, (rotation @ self._in_hand[1]).ravel())
        return grasp + rotation @ self._in_hand[0], quat

    def _tell_the_lab(self) -> None:
        base, half, now_s = self.base, self.base.yaw_rad / 2, self._time_s or 0.0
        pose = base.x_m, base.y_m, base.yaw_rad
        if pose != self._told:
            self._told = pose
            upright = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
            self._set_entity(self._body_name, np.array([base.x_m, base.y_m, 0.0]), upright, now_s)
        if self._let_go is not None:
            self._set_entity(self._item_name, *self._let_go, 0.0)
            self._let_go = None
        elif self._in_hand is not None:
            self._set_entity(self._item_name, *self._carried(), now_s)

    def _set_entity(self, name: str, position_m: np.ndarray, quat_wxyz: np.ndarray, time_s: float) -> None:
        new = self._network.new
        vector = new("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        state = new(
            "simulation_interfaces/msg/EntityState",
            header=self._header(time_s, "map"),
            pose=self._pose(position_m, quat_wxyz),
            twist=new("geometry_msgs/msg/Twist", linear=vector, angular=vector),
            acceleration=new("geometry_msgs/msg/Accel", linear=vector, angular=vector),
        )
        # Not before the lab has seen this does the robot move on: to its sensors it never jumps.
        self._entity.call(entity=name, state=state)

    # -- what it tells ------------------------------------------------------------------------------

    def _header(self, time_s: float, frame: str) -> Any:
        new = self._network.new
        nanoseconds = round((time_s + self.stamps_ahead_s) * 1e9)
        stamp = new("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _pose(self, position_m: np.ndarray, quat_wxyz: np.ndarray) -> Any:
        new = self._network.new
        x, y, z = map(float, position_m)
        qw, qx, qy, qz = map(float, quat_wxyz)
        return new(
            "geometry_msgs/msg/Pose",
            position=new("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        )

    def _publish(self, now_s: float) -> None:
        self._publish_odometry(now_s)
        force = GRIP_N if self._holding else 0.0
        joints = self._joint_positions()
        self._publishers["joint_states"].publish(
            header=self._header(now_s, ""),
            name=[*ARM, *FINGERS, *WHEELS],
            position=joints,
            velocity=(joints - self._joints) / STEP_S,
            effort=np.array([*[0.0] * 6, -force, force, *[0.0] * 4]),
        )
        if self._tick % 5 == 0:
            fingers = np.array([1.0, -1.0])
            self._publish_controller(now_s, "arm", ARM, self.arm, self.arm)
            self._publish_controller(
                now_s, "gripper", FINGERS, self._wanted_m * fingers, self.gripper_m * fingers
            )
            self._publish_scan(now_s)
        if self._tick % 10 == 0:
            self._publish_depth(now_s)
        if self._tick % 50 == 0:
            self._publish_battery(now_s)
        self._joints = joints

    def _joint_positions(self) -> np.ndarray:
        """(12,) of arm, fingers and wheels."""
        wheels = [self.base.way_m / WHEEL_M] * 4
        return np.array([*self.arm, self.gripper_m, -self.gripper_m, *wheels])

    def _publish_odometry(self, now_s: float) -> None:
        new, base = self._network.new, self.base
        half = base.yaw_rad / 2
        share = self.odometry_share
        pose = self._pose(
            np.array([share * base.x_m, share * base.y_m, 0.0]),
            np.array([math.cos(half), 0.0, 0.0, math.sin(half)]),
        )
        linear = new("geometry_msgs/msg/Vector3", x=share * base.speed_m_s * self._pace, y=0.0, z=0.0)
        angular = new("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=base.turn_rad_s * self._pace)
        twist = new("geometry_msgs/msg/Twist", linear=linear, angular=angular)
        self._publishers["odom"].publish(
            header=self._header(now_s, f"{self._ns}/odom"),
            child_frame_id=f"{self._ns}/base_link",
            pose=new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def _publish_controller(
        self, now_s: float, part: str, joints: tuple[str, ...], wanted: np.ndarray, measured: np.ndarray
    ) -> None:
        new, none = self._network.new, np.zeros(0)
        still = new("builtin_interfaces/msg/Duration", sec=0, nanosec=0)

        def point(positions: np.ndarray) -> Any:
            return new(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=positions,
                velocities=none,
                accelerations=none,
                effort=none,
                time_from_start=still,
            )

        nowhere = new(
            "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
            transforms=[],
            velocities=[],
            accelerations=[],
            time_from_start=still,
        )
        self._publishers[f"{part}_controller/controller_state"].publish(
            header=self._header(now_s, ""),
            joint_names=list(joints),
            reference=point(wanted),
            feedback=point(measured),
            error=point(wanted - measured),
            output=point(none),
            multi_dof_joint_names=[],
            multi_dof_reference=nowhere,
            multi_dof_feedback=nowhere,
            multi_dof_error=nowhere,
            multi_dof_output=nowhere,
            speed_scaling_factor=1.0,
        )

    def _publish_battery(self, now_s: float) -> None:
        nan = math.nan
        self._publishers["battery_state"].publish(
            header=self._header(now_s, f"{self._ns}/base_link"),
            voltage=self.voltage_v,
            temperature=nan,
            current=self.current_a,
            charge=self.soc * self.capacity_ah,
            capacity=self.capacity_ah,
            design_capacity=self.capacity_ah,
            percentage=self.soc,
            power_supply_status=1 if self.current_a > 0 else 2,
            power_supply_health=1,
            power_supply_technology=2,
            present=True,
            cell_voltage=np.zeros(0, np.float32),
            cell_temperature=np.zeros(0, np.float32),
            location="",
            serial_number="",
        )

    def _publish_scan(self, now_s: float) -> None:
        angles = np.linspace(-math.pi, math.pi, 120, endpoint=False)
        c, s = np.cos(angles + self.base.yaw_rad), np.sin(angles + self.base.yaw_rad)
        with np.errstate(divide="ignore"):
            to_x = np.where(c > 0, (ROOM_M[0] - self.base.x_m) / c, -self.base.x_m / c)
            to_y = np.where(s > 0, (ROOM_M[1] - self.base.y_m) / s, -self.base.y_m / s)
        self._publishers["scan"].publish(
            header=self._header(now_s, f"{self._ns}/lidar_link"),
            angle_min=-math.pi,
            angle_max=float(angles[-1]),
            angle_increment=math.tau / 120,
            time_increment=0.0,
            scan_time=0.0,
            range_min=0.3,
            range_max=10.0,
            ranges=np.minimum(np.abs(to_x), np.abs(to_y)).astype(np.float32),
            intensities=np.zeros(0, np.float32),
        )

    def _publish_depth(self, now_s: float) -> None:
        header = self._header(now_s, f"{self._ns}/wrist_camera_optical_frame")
        matrix = np.array([[FOCAL_PX, 0, WIDTH_PX / 2], [0, FOCAL_PX, HEIGHT_PX / 2], [0, 0, 1.0]])
        new = self._network.new
        region = new(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        self._publishers["wrist_camera/depth/camera_info"].publish(
            header=header,
            height=HEIGHT_PX,
            width=WIDTH_PX,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=matrix.ravel(),
            r=np.eye(3).ravel(),
            p=np.hstack([matrix, np.zeros((3, 1))]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=region,
        )
        self._publishers["wrist_camera/depth/image_rect_raw"].publish(
            header=header,
            height=HEIGHT_PX,
            width=WIDTH_PX,
            encoding="32FC1",
            is_bigendian=0,
            step=4 * WIDTH_PX,
            data=np.frombuffer(self._depth(matrix).astype("<f4").tobytes(), np.uint8),
        )

    def _depth(self, matrix: np.ndarray) -> np.ndarray:
        """The floor and the item, an upright cylinder, along the optical axis."""
        u, v = np.meshgrid(np.arange(WIDTH_PX), np.arange(HEIGHT_PX))
        pixels = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3).astype(float)
        eye, rotation = self._in_map("wrist_camera_optical_frame")
        rays = pixels @ np.linalg.inv(matrix).T @ rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(rays[:, 2] < 0, -eye[2] / rays[:, 2], np.inf)
            if self._item is not None and self._in_hand is None:
                centre, top = self._item[0], self._item[0][2] + self._half_height_m
                lid = (top - eye[2]) / rays[:, 2]
                at = eye + lid[:, None] * rays
                on_lid = (np.hypot(at[:, 0] - centre[0], at[:, 1] - centre[1]) < self._radius_m) & (lid > 0)
                depth = np.where(on_lid, np.minimum(depth, lid), depth)
                offset = eye[:2] - centre[:2]
                a = (rays[:, :2] ** 2).sum(axis=1)
                b = rays[:, :2] @ offset
                root = np.sqrt(b * b - a * (offset @ offset - self._radius_m**2))
                side = (-b - root) / a
                height = eye[2] + side * rays[:, 2]
                on_side = (side > 0) & (height > 0) & (height < top)
                depth = np.where(on_side, np.fmin(depth, side), depth)
        depth[depth > 2.0] = np.inf
        return depth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--port",
        type=int,
        default=7447,
        help="of the Zenoh router, unless ZENOH_CONFIG_OVERRIDE names it",
    )
    parser.add_argument("--namespace", required=True)
    parser.add_argument("--body", required=True, help="its name in the motion capture")
    parser.add_argument("--urdf", required=True)
    parser.add_argument("--pose", type=float, nargs=3, required=True, metavar=("X", "Y", "YAW"))
    parser.add_argument("--item", required=True, help="an upright cylinder that it can take")
    parser.add_argument("--item-radius", type=float, required=True)
    parser.add_argument("--item-half-height", type=float, required=True)
    arguments = parser.parse_args()
    Robot(arguments, Network(arguments.port)).run()


if __name__ == "__main__":
    main()
