"""The organization as ROS 2 services, topics and actions, for the nodes of one owner's participants."""
