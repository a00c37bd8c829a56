"""The robot's mind: takes tasks, moves a body through ROS 2 interfaces, proves the work, buys its charge."""
