"""Serialized messages, read by the descriptions of their types, or known without them. Sans-IO, without ROS."""
