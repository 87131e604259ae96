"""Shared parts of tests of the whole bridge: ROS domains, engines, processes, and networks that fail."""
