"""The engine of rsb-console: bridges ROS 2 topics over sockets."""

__version__ = "0.1.0"
