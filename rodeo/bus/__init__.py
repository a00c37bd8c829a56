"""The organization's bus: the session on it, its messages and its queries.

Which keys there are is in `rodeo.site.topics`; commands are in `rodeo.commands`, ROS 2 in `rodeo.ros2`.
"""
