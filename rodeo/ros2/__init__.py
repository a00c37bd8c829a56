"""ROS 2 in pure Python: topics, services and actions in the wire format of rmw_zenoh.

No ROS installation is needed on our side; nodes that run ROS 2 with rmw_zenoh on the same Zenoh network
see ours as their own kind, and the other way round. Which topics a robot has is in `rodeo.site.topics`.
"""
