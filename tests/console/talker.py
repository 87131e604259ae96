"""A ROS node in a process of its own that publishes until SIGTERM. usage: talker.py DOMAIN TOPIC HZ"""

import signal
import sys
import threading

import rclpy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

domain, topic, rate = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
stopping = threading.Event()
signal.signal(signal.SIGTERM, lambda *_: stopping.set())
rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
publisher = rclpy.create_node("talker").create_publisher(String, topic, 10)
while not stopping.wait(1 / rate):
    publisher.publish(String(data="x" * 200))
rclpy.shutdown()
