"""The mind of a robot that cleans: it takes a task, brings the item to the bin, and hands in the proof.

python3 mind.py --ros-args -r __ns:=/lab/panther1 -p robot:=panther1
"""

import math
from contextlib import suppress

import numpy as np
import rclpy
import viperx
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot import OPEN, SHUT, Failed, Robot
from sensor_msgs.msg import JointState
from smart_bin import SmartBin

from rodeo_msgs.action import DoTask
from rodeo_msgs.msg import RobotOrders
from rodeo_msgs.srv import Present, RegisterService, StartRecording, StopRecording


def answered(response):
    """A response that holds an answer. Raises Failed."""
    if response.problem:
        raise Failed(f"{response.problem[0].code}: {response.problem[0].message}")
    return response


class Mind(Robot):
    def __init__(self):
        super().__init__("mind")
        self.bin = SmartBin("itrash", 5.2, 4.45, -math.pi / 2, ["blue", "yellow", "green", "grey"])
        self.orders, self.goal = RobotOrders(), None
        self.register = self.create_client(RegisterService, "register_service")
        self.start = self.create_client(StartRecording, f"{self.robot}/start_recording")
        self.present = self.create_client(Present, f"{self.robot}/present")
        self.stop = self.create_client(StopRecording, f"{self.robot}/stop_recording")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(RobotOrders, f"{self.robot}/orders", self.on_orders, latched)
        # Results are kept for a process that is started again meanwhile.
        how = {"goal_callback": self.takes, "cancel_callback": self.lets_go, "result_timeout": 7200}
        self.server = ActionServer(self, DoTask, "do_task", self.clean, **how)

    def on_orders(self, orders):
        self.orders = orders

    def takes(self, goal):
        """To accept the goal accepts the task, to reject it gives the task back."""
        free = self.goal is None and not self.orders.paused and not self.orders.stopped
        return GoalResponse.ACCEPT if free and goal.task.params.waste_disposal else GoalResponse.REJECT

    def lets_go(self, _goal):
        return CancelResponse.ACCEPT

    def check(self):
        if self.orders.cancelled or self.goal.is_cancel_requested:
            raise Failed("the task was taken back")

    def say(self, activity, progress):
        self.get_logger().info(activity)
        self.goal.publish_feedback(DoTask.Feedback(activity=activity, progress=[progress]))

    async def clean(self, goal):
        self.goal, failure = goal, ""
        attempt = {"task_id": goal.request.task.id, "attempt": goal.request.task.attempt}
        try:
            begun = await self.start.call_async(StartRecording.Request(**attempt))
            if "recording_over" not in [one.code for one in begun.problem]:
                answered(begun)
                failure = await self.work(goal.request.task.params.waste_disposal[0])
            proof = await self.stop.call_async(StopRecording.Request(failure=failure, **attempt))
            answered(proof)
        finally:
            self.goal = None
        goal.succeed()
        return DoTask.Result(proof_sha256=proof.proof_sha256, proof_uri=proof.proof_uri)

    async def work(self, item):
        """Why it failed; nothing where it did not."""
        try:
            await self.dispose(item)
        except (Failed, ValueError) as error:
            self.get_logger().error(f"gave up: {error}")
            return str(error)
        return ""

    async def dispose(self, item):
        self.say(f"driving to {item.item_id}", 0.1)
        await self.move(viperx.FOLDED)
        await self.grip(OPEN)
        x, y, _ = await self.where()
        heading = math.atan2(item.y_m - y, item.x_m - x)
        x, y = item.x_m - viperx.REACH * math.cos(heading), item.y_m - viperx.REACH * math.sin(heading)
        await self.go(x, y, heading)
        self.say(f"grasping {item.item_id}", 0.3)
        spot, top, closing = await self.find(item.x_m, item.y_m)
        await self.announce(spot, top)
        hang = viperx.grasp_height(top)
        pads = np.array([*spot, hang])
        await self.lower(pads, 0.12, closing)
        grasped = (await self.hear(JointState, f"{self.robot}/joint_states")).header.stamp
        await self.grip(SHUT)
        await self.lift(pads, 0.15, closing)
        await self.move(viperx.ASIDE)
        self.say(f"bringing {item.item_id} to {self.bin.name}", 0.5)
        await self.go(*self.bin.parking)
        x, y, z = self.bin.view
        told = await self.show(await self.seen(x, y, z + hang - top / 2), grasped)
        if told.full:
            raise Failed(f"the compartment {told.compartment} is full")
        self.say(f"dropping {item.item_id} into {told.compartment}", 0.7)
        x, y, z = self.bin.opening(told.compartment)
        pads = await self.seen(x, y, z + hang + 0.02)
        await self.lower(pads, 0.06)
        await self.grip(OPEN)
        await self.lift(pads, 0.08)
        await self.move(viperx.ASIDE)
        await self.go(*self.bin.way_out)

    async def show(self, point, grasped):
        """What the bin says of the item, which is turned until the bin is sure."""
        for turn in (0.0, 0.6, -0.6):
            answer = self.present.call_async(Present.Request(bin=self.bin.name, grasped=grasped))
            await self.move(viperx.above(*point, viperx.ACROSS + turn))
            told = answered(await answer)
            if not told.another_angle:
                break
            await self.move(viperx.ASIDE)
        return told


def main():
    rclpy.init()
    mind = Mind()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        mind.wait_for_servers(mind.register, mind.start, mind.present, mind.stop)
        offer = RegisterService.Request(kind="waste_disposal", price_iec="90", auto_accept=[False])
        offered = mind.register.call_async(offer)
        rclpy.spin_until_future_complete(mind, offered)
        # One that it made before stands; `update_service` changes its price.
        if "already_offered" not in [one.code for one in offered.result().problem]:
            answered(offered.result())
        rclpy.spin(mind)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
