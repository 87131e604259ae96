"""Serialized messages, read by the descriptions of their types. Sans-IO, without ROS."""
