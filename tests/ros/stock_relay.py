"""A stock rclpy program: publishes all messages of /odom_in on /odom_out, until SIGTERM.

usage: stock_relay.py DOMAIN
"""

import contextlib
import os
import sys

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException

rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("relay")
publisher = node.create_publisher(Odometry, "/odom_out", 10)
subscription = node.create_subscription(Odometry, "/odom_in", publisher.publish, 10)
with contextlib.suppress(ExternalShutdownException):
    rclpy.spin(node)
