"""What rclpy.executors has for nodes that one thread spins."""


class ExternalShutdownException(Exception):
    """The context was shut down while somebody was spinning."""
