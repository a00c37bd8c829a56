"""A dashboard: balances as they are, and each event of the organization exactly once.

    python3 balances.py --ros-args -r __ns:=/lab/anna -p after:=0

The topic `events` only wakes the node. What it has dealt with is the number `after`, and it asks for what
comes behind that: so it misses nothing and counts nothing twice, however long it was away.
"""

from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from rodeo_msgs.msg import DaoEvent, Wallets
from rodeo_msgs.srv import GetEvents

PAGE = 100
ASK_AGAIN_S = 5.0
"""A request or its answer is lost when the network fails, and so is the message that would wake."""


class Dashboard(Node):
    def __init__(self):
        super().__init__("dashboard")
        self.after = self.declare_parameter("after", 0).value
        self.history = self.create_client(GetEvents, "get_events")
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(Wallets, "balances", self.on_balances, latched)
        self.create_subscription(DaoEvent, "events", self.ask, latched)
        self.create_timer(ASK_AGAIN_S, self.ask)

    def on_balances(self, message):
        balances = ", ".join(f"{wallet.name} {wallet.balance_iec}" for wallet in message.wallets)
        self.get_logger().info(f"balances in IEC: {balances}")

    def ask(self, _event=None):
        request = GetEvents.Request(after=self.after, limit=[PAGE])
        self.history.call_async(request).add_done_callback(self.on_history)

    def on_history(self, answered):
        response = answered.result()
        for problem in response.problem:
            self.get_logger().warning(f"{problem.code}: {problem.message}")
        for page in response.answer:
            # Several answers may be on their way: the first that holds an event counts.
            news = [event for event in page.events if event.seq > self.after]
            for event in news:
                self.on_event(event)
                self.after = event.seq
            if news and self.after < page.last_seq:
                self.ask()

    def on_event(self, event):
        """Deal with an event. Keep its `seq` where it survives, and hand it over as `after` next time."""
        self.get_logger().info(f"event {event.seq}: {event.name} {event.args}")


def main():
    rclpy.init()
    dashboard = Dashboard()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(dashboard)
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
