"""A ROS node in a process of its own that publishes until it is told to stop. usage: talker.py DOMAIN TOPIC HZ"""

import sys
import time

import rclpy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

domain, topic, rate = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
publisher = rclpy.create_node("talker").create_publisher(String, topic, 10)
while True:
    publisher.publish(String(data="x" * 200))
    time.sleep(1 / rate)
