"""Definitions of ROS 1 packages that Debian has not. The sums that genpy makes of them are Noetic's."""

from __future__ import annotations

from pathlib import Path

POINTS = "trajectory_msgs/JointTrajectoryPoint"
GRIPPER = "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal\n"

# As released for Noetic: control_msgs 1.5, move_base_msgs 1.14.
DEFINITIONS = {
    "control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort\n",
    "control_msgs/msg/JointTolerance": (
        "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n"
    ),
    "control_msgs/msg/JointTrajectoryControllerState": (
        "Header header\nstring[] joint_names\n" + f"{POINTS} desired\n{POINTS} actual\n{POINTS} error\n"
    ),
    "control_msgs/action/GripperCommand": (
        f"control_msgs/GripperCommand command\n---\n{GRIPPER}---\n{GRIPPER}"
    ),
    "control_msgs/action/FollowJointTrajectory": (
        "trajectory_msgs/JointTrajectory trajectory\ncontrol_msgs/JointTolerance[] path_tolerance\n"
        "control_msgs/JointTolerance[] goal_tolerance\nduration goal_time_tolerance\n"
        "---\nint32 error_code\nint32 SUCCESSFUL = 0\nint32 INVALID_GOAL = -1\nint32 INVALID_JOINTS = -2\n"
        "int32 OLD_HEADER_TIMESTAMP = -3\nint32 PATH_TOLERANCE_VIOLATED = -4\n"
        "int32 GOAL_TOLERANCE_VIOLATED = -5\nstring error_string\n"
        f"---\nHeader header\nstring[] joint_names\n{POINTS} desired\n{POINTS} actual\n{POINTS} error\n"
    ),
    "move_base_msgs/action/MoveBase": (
        "geometry_msgs/PoseStamped target_pose\n---\n---\ngeometry_msgs/PoseStamped base_position\n"
    ),
    # The world's part of the robot, and in no release for ROS 1.
    "simulation_interfaces/msg/Result": "uint8 result\nstring error_message\n",
    "simulation_interfaces/msg/EntityState": (
        "Header header\ngeometry_msgs/Pose pose\ngeometry_msgs/Twist twist\n"
        "geometry_msgs/Accel acceleration\n"
    ),
    "simulation_interfaces/srv/SetEntityState": (
        "string entity\nsimulation_interfaces/EntityState state\n---\nsimulation_interfaces/Result result\n"
    ),
}


def messages_of(name: str, text: str) -> dict[str, str]:
    """The messages that an action stands for, as actionlib_msgs' genaction makes them."""
    parts = dict(zip(("Goal", "Result", "Feedback"), text.split("---\n"), strict=True))
    status = "actionlib_msgs/GoalStatus status\n"
    before = {"Goal": "actionlib_msgs/GoalID goal_id\n", "Result": status, "Feedback": status}
    made = {f"{name}{part}": content for part, content in parts.items()}
    made |= {
        f"{name}Action{part}": f"Header header\n{before[part]}{name}{part} {part.lower()}\n" for part in parts
    }
    actions = [f"{name}Action{part} action_{part.lower()}\n" for part in parts]
    return made | {f"{name}Action": "".join(actions)}


def definitions(rodeo_msgs: Path) -> dict[str, str]:
    files = [path for form in ("msg", "srv", "action") for path in sorted((rodeo_msgs / form).iterdir())]
    return DEFINITIONS | {f"rodeo_msgs/{path.parent.name}/{path.stem}": path.read_text() for path in files}
