"""The organization's bus: the session on it, and what is said there, messages and queries.

Which keys there are is in `rodeo.site.topics`; commands are in `rodeo.commands`, ROS 2 in `rodeo.ros2`.
"""
