"""Post a cleaning and wait for its end.

python3 post_a_task.py --ros-args -r __ns:=/lab/anna -p item:=item1 -p place:="[4.6, 1.2]"

The goal's UUID is the ID of the request: who gets no answer repeats it with `-p goal:=UUID`, and pays once.
"""

import sys
import uuid

import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from unique_identifier_msgs.msg import UUID

from rodeo_msgs.action import CreateTask
from rodeo_msgs.msg import TaskParams, WasteDisposalParams

GIVES_UP_S = 60.0
ASK_AGAIN_S = 10.0
"""The process that follows the task may be restarted meanwhile: it keeps the goal, not who waits for it."""


class Poster(Node):
    def __init__(self):
        super().__init__("poster")
        item = self.declare_parameter("item", "item1").value
        x_m, y_m = self.declare_parameter("place", [4.6, 1.2]).value
        place = WasteDisposalParams(item_id=item, x_m=x_m, y_m=y_m)
        self.goal = CreateTask.Goal(kind="waste_disposal", params=TaskParams(waste_disposal=[place]))
        self.goal.reward_iec = self.declare_parameter("reward_iec", "100").value
        self.id = uuid.UUID(self.declare_parameter("goal", str(uuid.uuid4())).value)
        self.client = ActionClient(self, CreateTask, "create_task")

    def post(self):
        """The goal's handle, once it is accepted."""
        self.client.wait_for_server()
        self.get_logger().info(f"goal {self.id}")
        sent = self.client.send_goal_async(self.goal, self.on_feedback, UUID(uuid=list(self.id.bytes)))
        rclpy.spin_until_future_complete(self, sent, timeout_sec=GIVES_UP_S)
        return sent.result() if sent.done() else sys.exit(f"no answer: repeat it with -p goal:={self.id}")

    def on_feedback(self, message):
        task = message.feedback.task
        who = task.executor_name[0] if task.executor_name else "nobody"
        self.get_logger().info(f"task {task.id} is {task.state}; {who} has it")

    def wait(self, handle):
        """How the goal ended."""
        while True:
            ended = handle.get_result_async()
            rclpy.spin_until_future_complete(self, ended, timeout_sec=ASK_AGAIN_S)
            if ended.done():
                return ended.result()

    def tell(self, ended):
        """What became of the task; whether it was done."""
        for problem in ended.result.problem:
            self.get_logger().error(f"{problem.code}: {problem.message}")
        for task in ended.result.task:
            verdict = task.verdict[0] if task.verdict else "none"
            self.get_logger().info(f"task {task.id}: {task.paid_iec} IEC paid, verdict {verdict}")
        self.get_logger().info(f"transactions: {' '.join(ended.result.transactions)}")
        return ended.status == GoalStatus.STATUS_SUCCEEDED


def main():
    rclpy.init()
    poster = Poster()
    try:
        handle = poster.post()
        if not handle.accepted:
            sys.exit("the goal was rejected")
        return 0 if poster.tell(poster.wait(handle)) else 1
    except KeyboardInterrupt:
        return 1
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
