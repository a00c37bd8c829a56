"""The body: a MuJoCo lab with a Panther and a ViperX, speaking ROS 2 over Zenoh as the real one does."""
