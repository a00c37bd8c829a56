"""Interface definitions that the rosbags type store for ROS 2 Jazzy lacks, field by field.

Sources: nav2_msgs (Navigation2, branch jazzy), control_msgs (ros2_control, branch jazzy), std_srvs and
example_interfaces (ros2, branch jazzy), action_msgs (rcl_interfaces, branch jazzy), simulation_interfaces
(ros-simulation, 2.0, as released for jazzy). Field order, names and types decide the RIHS01 hash, so a
change here makes us invisible to real robots; tests compare with hashes published by ROS 2.
"""

MESSAGES: dict[str, str] = {
    "control_msgs/msg/GripperCommand": """
float64 position
float64 max_effort
""",
    "control_msgs/msg/JointTolerance": """
string name
float64 position
float64 velocity
float64 acceleration
""",
    "control_msgs/msg/JointComponentTolerance": """
uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
""",
    "control_msgs/msg/JointTrajectoryControllerState": """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output
float64 speed_scaling_factor
""",
    "simulation_interfaces/msg/Result": """
uint8 FEATURE_UNSUPPORTED=0
uint8 OK=1
uint8 NOT_FOUND=2
uint8 INCORRECT_STATE=3
uint8 OPERATION_FAILED=4
uint8 result
string error_message
""",
    "simulation_interfaces/msg/EntityState": """
std_msgs/Header header
geometry_msgs/Pose pose
geometry_msgs/Twist twist
geometry_msgs/Accel acceleration
""",
}

SERVICES: dict[str, str] = {
    "std_srvs/srv/Trigger": """
---
bool success
string message
""",
    "std_srvs/srv/SetBool": """
bool data
---
bool success
string message
""",
    "simulation_interfaces/srv/SetEntityState": """
string entity
simulation_interfaces/EntityState state
---
simulation_interfaces/Result result
""",
    "example_interfaces/srv/AddTwoInts": """
int64 a
int64 b
---
int64 sum
""",
    "action_msgs/srv/CancelGoal": """
action_msgs/GoalInfo goal_info
---
int8 ERROR_NONE=0
int8 ERROR_REJECTED=1
int8 ERROR_UNKNOWN_GOAL_ID=2
int8 ERROR_GOAL_TERMINATED=3
int8 return_code
action_msgs/GoalInfo[] goals_canceling
""",
}

ACTIONS: dict[str, str] = {
    "nav2_msgs/action/NavigateToPose": """
geometry_msgs/PoseStamped pose
string behavior_tree
---
uint16 NONE=0
uint16 error_code
---
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
""",
    "control_msgs/action/FollowJointTrajectory": """
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointComponentTolerance[] component_path_tolerance
control_msgs/JointTolerance[] goal_tolerance
control_msgs/JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 SUCCESSFUL=0
int32 INVALID_GOAL=-1
int32 INVALID_JOINTS=-2
int32 OLD_HEADER_TIMESTAMP=-3
int32 PATH_TOLERANCE_VIOLATED=-4
int32 GOAL_TOLERANCE_VIOLATED=-5
int32 error_code
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
""",
    "control_msgs/action/GripperCommand": """
control_msgs/GripperCommand command
---
float64 position
float64 effort
bool stalled
bool reached_goal
---
float64 position
float64 effort
bool stalled
bool reached_goal
""",
}
