"""Many publishers in one process, each at 1 Hz: ``python -m bench.many DOMAIN TOPICS``."""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

domain, count = int(sys.argv[1]), int(sys.argv[2])
context = Context()
rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
node = Node("bench_many", context=context, enable_rosout=False, start_parameter_services=False)
publishers = [node.create_publisher(String, f"/bench/topic_{number:03d}", 10) for number in range(count)]
while True:
    for publisher in publishers:
        publisher.publish(String(data="x" * 200))
        time.sleep(1 / count)
