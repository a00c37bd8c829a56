"""Interfaces as a vendor's robot has them: texts of the ROS 2 packages and the hashes that they install.

Standard messages come from rosbags' type store, which zenoh-ros2-sdk brings along.
"""

# ruff: noqa: E501 - hashes are as long as they are

from __future__ import annotations

from typing import Any

from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession

JAZZY = get_typestore(Stores.ROS2_JAZZY)

PARTS = {
    "control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort\n",
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n",
    "control_msgs/msg/JointComponentTolerance": (
        "string joint_name\nuint16 component\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n"
    ),
    "control_msgs/msg/JointTrajectoryControllerState": (
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint reference\ntrajectory_msgs/JointTrajectoryPoint feedback\n"
        "trajectory_msgs/JointTrajectoryPoint error\ntrajectory_msgs/JointTrajectoryPoint output\n"
        "string[] multi_dof_joint_names\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output\n"
        "float64 speed_scaling_factor\n"
    ),
    "simulation_interfaces/msg/Result": "uint8 result\nstring error_message\n",
    "simulation_interfaces/msg/EntityState": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose\ngeometry_msgs/Twist twist\n"
        "geometry_msgs/Accel acceleration\n"
    ),
}
"""Messages of which the services below are made."""

ACTIONS = {
    "nav2_msgs/action/NavigateToPose": (
        "geometry_msgs/PoseStamped pose\nstring behavior_tree\n",
        "uint16 error_code\n",
        "geometry_msgs/PoseStamped current_pose\nbuiltin_interfaces/Duration navigation_time\n"
        "builtin_interfaces/Duration estimated_time_remaining\nint16 number_of_recoveries\n"
        "float32 distance_remaining\n",
    ),
    "control_msgs/action/FollowJointTrajectory": (
        "trajectory_msgs/JointTrajectory trajectory\n"
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory\n"
        "control_msgs/JointTolerance[] path_tolerance\n"
        "control_msgs/JointComponentTolerance[] component_path_tolerance\n"
        "control_msgs/JointTolerance[] goal_tolerance\n"
        "control_msgs/JointComponentTolerance[] component_goal_tolerance\n"
        "builtin_interfaces/Duration goal_time_tolerance\n",
        "int32 error_code\nstring error_string\n",
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint desired\ntrajectory_msgs/JointTrajectoryPoint actual\n"
        "trajectory_msgs/JointTrajectoryPoint error\nstring[] multi_dof_joint_names\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error\n",
    ),
    "control_msgs/action/GripperCommand": (
        "control_msgs/GripperCommand command\n",
        "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal\n",
        "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal\n",
    ),
}
"""Goal, result and feedback."""

SERVICES = {
    "action_msgs/srv/CancelGoal": (
        "action_msgs/GoalInfo goal_info\n",
        "int8 return_code\naction_msgs/GoalInfo[] goals_canceling\n",
    ),
    "std_srvs/srv/SetBool": ("bool data\n", "bool success\nstring message\n"),
    "simulation_interfaces/srv/SetEntityState": (
        "string entity\nsimulation_interfaces/EntityState state\n",
        "simulation_interfaces/Result result\n",
    ),
}

HASHES = {
    "control_msgs/msg/JointTrajectoryControllerState": "51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480",
    "nav2_msgs/action/NavigateToPose_SendGoal": "a4fcb3bee1bf32e21a0e541a943b221aa0826996e2c98f079b47022b256f48b5",
    "nav2_msgs/action/NavigateToPose_GetResult": "12dc670d3dac446019bb61a2bef1fd92ada02d582ca70922706d933a54b07f1c",
    "nav2_msgs/action/NavigateToPose_FeedbackMessage": "9d1f6fa2eb975ce733b419ac2e97b134d8ff92b6478b6559feed9a50bdfd82b3",
    "control_msgs/action/FollowJointTrajectory_SendGoal": "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
    "control_msgs/action/FollowJointTrajectory_GetResult": "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage": "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    "control_msgs/action/GripperCommand_SendGoal": "6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212",
    "control_msgs/action/GripperCommand_GetResult": "7e60a7606063d4a2728d21badac099e68b734a196ac3ab42d1d4c668eb0bb3cd",
    "control_msgs/action/GripperCommand_FeedbackMessage": "392ff03fcd872f9dc2405cbeb2897fcf011ad9998458b6aa85c603b8a49e431d",
    "action_msgs/srv/CancelGoal": "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    "std_srvs/srv/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "simulation_interfaces/srv/SetEntityState": "ca210e7d2b66629ae133c8e1edf5246e618106d75c78ed0556c0e7a33c59ee5e",
}
"""RIHS01 of what rosbags does not know, as ROS 2 Jazzy has it."""


class Network:
    """One session, one type store, and the SDK's endpoints with everything spelled out for them."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._session = ZenohSession.get_instance("127.0.0.1", port)
        self._session.store.register(JAZZY.fielddefs)
        for name, text in PARTS.items():
            self._session.register_message_type(text, name)

    def new(self, typename: str, **fields: Any) -> Any:
        return self._session.store.types[typename](**fields)

    @staticmethod
    def seconds(stamp: Any) -> float:
        """A time or a duration."""
        return float(stamp.sec + stamp.nanosec * 1e-9)

    def publisher(self, topic: str, typename: str, **more: Any) -> ROS2Publisher:
        return ROS2Publisher(f"/{topic}", typename, **self._message(typename), **more)

    def subscriber(self, topic: str, typename: str, callback: Any) -> ROS2Subscriber:
        return ROS2Subscriber(f"/{topic}", typename, callback, **self._message(typename))

    def server(self, name: str, typename: str, texts: tuple[str, str], **more: Any) -> ROS2ServiceServer:
        return ROS2ServiceServer(f"/{name}", typename, **self._service(typename, texts), **more)

    def client(self, name: str, typename: str) -> ROS2ServiceClient:
        return ROS2ServiceClient(f"/{name}", typename, **self._service(typename, SERVICES[typename]))

    def define(self, typename: str, text: str) -> None:
        """Make a message that rosbags does not know."""
        self._session.register_message_type(text, typename)

    def _message(self, typename: str) -> dict[str, Any]:
        if typename in HASHES:
            # Already defined by whoever publishes it; the SDK asks for a text all the same.
            return {
                "msg_definition": "",
                "type_hash": f"RIHS01_{HASHES[typename]}",
                "router_port": self._port,
            }
        text, _ = JAZZY.generate_msgdef(typename, ros_version=2)
        return {
            "msg_definition": text,
            "type_hash": JAZZY.hash_rihs01(typename),
            "router_port": self._port,
        }

    def _service(self, typename: str, texts: tuple[str, str]) -> dict[str, Any]:
        return {
            "request_definition": texts[0],
            "response_definition": texts[1],
            "type_hash": f"RIHS01_{HASHES[typename]}",
            "router_port": self._port,
        }
