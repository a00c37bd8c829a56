"""A minimal robot operator in process: IK, trajectories, a straight drive, and the whole work on one item.

It steps the world by itself and is what the lab's geometry was proved with; the robot's agent does the same
work over the bus.
"""

import math

import mink
import mujoco
import numpy as np

from rodeo.lab.body import Body, Twist2
from rodeo.lab.config import ItemConfig, Pose2, RobotConfig
from rodeo.lab.geometry import seen_from, wrap
from rodeo.lab.items import shape_of, top_grasps
from rodeo.lab.layout import SHOULDER_M, BinLayout
from rodeo.lab.world import CONTROL_PERIOD_S, CONTROL_STEPS, GRIPPER_OPEN_M, robot_model
from rodeo.robot.arm import RestToRest
from rodeo.robot.navigation import in_base_frame


def pointing_down(point_m: tuple[float, float, float], closing_yaw_rad: float) -> mink.SE3:
    """The gripper at a point of the base frame, pointing down, closing along this direction."""
    c, s = math.cos(closing_yaw_rad), math.sin(closing_yaw_rad)
    turn = np.array([[0, c, s], [0, s, -c], [-1, 0, 0]])
    return mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(turn), np.array(point_m))


class Operator:
    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, body: Body, robot: RobotConfig) -> None:
        self.model, self.data, self.body = model, data, body
        self.stowed_rad = np.array(robot.postures.stowed_rad)
        self.working_rad = np.array(robot.postures.ready_rad)
        self.kinematics = robot_model(robot.kinematics)
        self.arm_qpos = [self.kinematics.joint(name).qposadr[0] for name in body.arm_model.joints]
        self.grip = (GRIPPER_OPEN_M, 5.0)
        self.setpoint = body.arm_setpoint

    def solve(self, target: mink.SE3, from_rad: np.ndarray) -> np.ndarray:
        """Joints that put the gripper there, pointing down: of several solutions the nearest."""
        x, y, _ = target.translation()
        closing = target.rotation().as_matrix()[:, 1]
        seeds = [from_rad]
        for posture in (self.working_rad, self.stowed_rad):
            # The waist turned towards the target, the wrist turned for the fingers.
            waist = math.atan2(y, x - SHOULDER_M)
            wrist = math.remainder(math.pi / 2 - math.atan2(closing[1], closing[0]) + waist, math.pi)
            seed = posture.copy()
            seed[0] += waist
            seed[-1] += wrist
            seeds.append(seed)
        solutions = [found for seed in seeds if (found := self._descend(target, seed)) is not None]
        if not solutions:
            raise AssertionError(f"no IK solution for {target.translation()}")
        return min(solutions, key=lambda found: np.abs(found - from_rad).max())

    def _descend(self, target: mink.SE3, seed_rad: np.ndarray) -> np.ndarray | None:
        q = np.zeros(self.kinematics.nq)
        q[self.arm_qpos] = seed_rad
        configuration = mink.Configuration(self.kinematics, q)
        task = mink.FrameTask("grasp", "site", position_cost=10.0, orientation_cost=1.0)
        task.set_target(target)
        for _ in range(100):
            velocity = mink.solve_ik(configuration, [task], 0.1, "daqp", damping=1e-4)
            configuration.integrate_inplace(velocity, 0.1)
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < 5e-4 and np.linalg.norm(error[3:]) < 5e-3:
                return configuration.q[self.arm_qpos]
        return None

    def tick(self) -> None:
        self.body.move_arm(self.setpoint)
        self.body.move_gripper(*self.grip)
        mujoco.mj_step(self.model, self.data, nstep=CONTROL_STEPS)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * 50)):
            self.tick()

    def move(self, target_rad: np.ndarray, speed: float = 1.2) -> None:
        start_rad = self.setpoint
        way_rad = target_rad - start_rad
        longest_rad = float(np.abs(way_rad).max())
        if longest_rad > 0:
            # All joints begin and end together; the one with the longest way sets the pace.
            profile = RestToRest(longest_rad, speed, 2.5, 15.0)
            periods = math.floor(profile.duration_s / CONTROL_PERIOD_S) + 1
            places, _ = profile.at(np.arange(1, periods + 1) * np.float64(CONTROL_PERIOD_S))
            for share in places / longest_rad:
                self.setpoint = start_rad + share * way_rad
                self.tick()
        self.wait(0.3)

    def reach(self, point_m: tuple[float, float, float], closing_yaw_rad: float, speed: float = 1.2) -> None:
        """Move the gripper, pointing down, to a point of the base frame."""
        self.move(self.solve(pointing_down(point_m, closing_yaw_rad), self.setpoint), speed)

    def grasp(self, force_n: float) -> None:
        self.grip = (0.0, force_n)
        self.wait(1.0)

    def open(self) -> None:
        self.grip = (GRIPPER_OPEN_M, 5.0)
        self.wait(1.0)

    def turn_to(self, yaw_rad: float) -> None:
        for _ in range(1000):
            error = wrap(yaw_rad - self.body.pose.yaw_rad)
            if abs(error) < 0.01:
                break
            self.body.drive(Twist2(0.0, float(np.clip(2 * error, -0.8, 0.8))))
            self.tick()
        self.body.drive(Twist2())
        self.wait(0.3)

    def drive_to(self, goal: Pose2) -> None:
        """Turn, drive straight, turn: for places with nothing in between."""
        start = self.body.pose
        self.turn_to(math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m))
        for _ in range(3000):
            pose = self.body.pose
            dx, dy = goal.x_m - pose.x_m, goal.y_m - pose.y_m
            along, _ = seen_from(pose, goal.x_m, goal.y_m)
            if along < 0.01:
                break
            steer = wrap(math.atan2(dy, dx) - pose.yaw_rad) if along > 0.15 else 0.0
            self.body.drive(Twist2(min(0.6, 1.2 * along), 2 * steer))
            self.tick()
        self.body.drive(Twist2())
        self.wait(0.3)
        self.turn_to(goal.yaw_rad)

    # -- one item, from the floor into the bin ---------------------------------------------------------

    def pick(self, item: ItemConfig, force_n: float = 5.0) -> None:
        """Take the item, which lies PICK_DISTANCE_M ahead, and lift it."""
        held = self.data.body(item.id)
        grasp = top_grasps(item, held.xpos, held.xquat)[0]
        x, y, z = in_base_frame(self.body.pose, grasp.point_m)
        closing = math.pi / 2 if grasp.yaw_rad is None else (grasp.yaw_rad - self.body.pose.yaw_rad) % math.pi
        self.open()
        self.reach((x, y, z + 0.12), closing)
        self.reach((x, y, z), closing, speed=0.6)
        self.grasp(force_n)
        self.reach((x, y, z + 0.15), closing, speed=0.8)
        self.move(self.stowed_rad)

    def show(self, item: ItemConfig, layout: BinLayout) -> None:
        """Hold the item in front of the bin's camera; the robot is parked at the bin."""
        x, y, z = in_base_frame(self.body.pose, layout.show_point)
        self.reach((x, y, z + self._hang_m(item)), math.pi / 2)
        self.wait(0.5)

    def drop(self, item: ItemConfig, layout: BinLayout, compartment: str) -> None:
        shape = shape_of(item)
        x, y, rim_m = in_base_frame(self.body.pose, layout.compartment(compartment))
        below_m = self._hang_m(item) + shape.half_m[0 if shape.lies else 2]
        self.reach((x, y, rim_m + below_m + 0.08), math.pi / 2)
        self.reach((x, y, rim_m + below_m + 0.02), math.pi / 2)
        self.open()
        self.reach((x, y, rim_m + below_m + 0.10), math.pi / 2)
        self.move(self.stowed_rad)

    def _hang_m(self, item: ItemConfig) -> float:
        """Distance of the item's centre below the pads."""
        tool = self.data.site(f"{self.body.name}/grasp")
        return float(tool.xpos[2] - self.data.body(item.id).xpos[2])
