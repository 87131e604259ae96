"""The engine of rsb-console: bridges ROS 2 topics over sockets."""
