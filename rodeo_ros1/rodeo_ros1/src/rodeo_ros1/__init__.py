"""A relay between a ROS 1 graph and the keys of ROS 2 over Zenoh, by rospy, actionlib and eclipse-zenoh.

errors      what a message, a file or the other side can be wrong in
config      the YAML file that says what is relayed
layouts     the generated table: how ROS 2 lays messages out, and its hashes
cdr         messages of ROS 1 to ROS 2's CDR, and back
bus         a session on the site's router: keys, attachments and tokens as rmw_zenoh writes them
health      counts, losses and states, in the log and on /diagnostics
topics, services, actions    what carries each of them
relay       the node
"""
