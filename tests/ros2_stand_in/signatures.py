"""What the stand-in for rclpy offers: names and parameters of rclpy for ROS 2 Jazzy, with where they stand.

A name that is not here is not in the stand-in, and a parameter that is not here is not taken, although
rclpy may have it: `tests/unit/ros2/test_stand_in.py` compares both ways. So a node that calls what rclpy
lacks fails here, too.
"""

SOURCE = "https://github.com/ros2/rclpy/blob/jazzy/rclpy/rclpy/"

SIGNATURES: dict[str, tuple[str, dict[str, str]]] = {
    "rclpy": (
        SOURCE + "__init__.py",
        {
            "init": "*, args",
            "ok": "",
            "spin": "node",
            "spin_until_future_complete": "node, future, *, timeout_sec",
            "try_shutdown": "",
        },
    ),
    "rclpy.node.Node": (
        SOURCE + "node.py",
        {
            "__init__": "node_name",
            "create_client": "srv_type, srv_name",
            "create_publisher": "msg_type, topic, qos_profile",
            "create_subscription": "msg_type, topic, callback, qos_profile",
            "create_timer": "timer_period_sec, callback",
            "declare_parameter": "name, value",
            "destroy_subscription": "subscription",
            "get_logger": "",
        },
    ),
    "rclpy.node.Logger": (
        SOURCE + "impl/rcutils_logger.py",
        {"info": "message", "warning": "message", "error": "message"},
    ),
    "rclpy.node.Publisher": (SOURCE + "publisher.py", {"publish": "msg"}),
    "rclpy.node.Subscription": (SOURCE + "subscription.py", {"destroy": ""}),
    "rclpy.node.Client": (
        SOURCE + "client.py",
        {"call_async": "request", "wait_for_service": "timeout_sec"},
    ),
    "rclpy.action.ActionClient": (
        SOURCE + "action/client.py",
        {
            "__init__": "node, action_type, action_name",
            "send_goal_async": "goal, feedback_callback, goal_uuid",
            "wait_for_server": "timeout_sec",
        },
    ),
    "rclpy.action.ClientGoalHandle": (
        SOURCE + "action/client.py",
        {"accepted": "", "cancel_goal_async": "", "get_result_async": ""},
    ),
    "rclpy.action.ActionServer": (
        SOURCE + "action/server.py",
        {
            "__init__": "node, action_type, action_name, execute_callback, *, goal_callback, "
            "cancel_callback, result_timeout"
        },
    ),
    "rclpy.action.ServerGoalHandle": (
        SOURCE + "action/server.py",
        {
            "abort": "",
            "canceled": "",
            "is_active": "",
            "is_cancel_requested": "",
            "publish_feedback": "feedback",
            "request": "",
            "status": "",
            "succeed": "",
        },
    ),
    "rclpy.action.GoalResponse": (SOURCE + "action/server.py", {"ACCEPT": "", "REJECT": ""}),
    "rclpy.action.CancelResponse": (SOURCE + "action/server.py", {"ACCEPT": "", "REJECT": ""}),
    "rclpy.task.Future": (
        SOURCE + "task.py",
        {
            "add_done_callback": "callback",
            "done": "",
            "exception": "",
            "result": "",
            "set_exception": "exception",
            "set_result": "result",
        },
    ),
    "rclpy.qos.QoSProfile": (SOURCE + "qos.py", {"__init__": "*, depth, reliability, durability"}),
    "rclpy.qos.DurabilityPolicy": (SOURCE + "qos.py", {"TRANSIENT_LOCAL": "", "VOLATILE": ""}),
    "rclpy.qos.ReliabilityPolicy": (SOURCE + "qos.py", {"BEST_EFFORT": "", "RELIABLE": ""}),
    "rclpy.executors.ExternalShutdownException": (SOURCE + "executors.py", {}),
}
"""Class or module -> its source, and each public name with its parameters. Of an attribute they are empty."""
