"""The engine of rsb-console: bridges ROS 2 topics over sockets."""

__version__ = "1.0.0.dev0"
