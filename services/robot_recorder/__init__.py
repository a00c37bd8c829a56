"""The recorder of a robot whose mind is a ROS 2 node: it has the key, records, signs, and takes orders."""
