#!/usr/bin/env bash
# A subscription of asyncio-for-robotics hears one message of a burst, and no latched one.
#
# asyncio-for-robotics 1.5.1 with ros-rclpy 7.1.6 and rmw_fastrtps_cpp 8.4.3, from PyPI. Its default is rclpy's
# `qos_profile_system_default`, which is not the default of ROS: every policy is the middleware's, and Fast DDS reads with
# best effort, a depth of 1 and without what was published before. `Sub(type, topic, QoSProfile(depth=10))` hears all.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=84
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-jazzy-rclpy==7.1.6 ros-rclpy==7.1.6 \
    ros-jazzy-rmw-fastrtps-cpp==8.4.3 ros-jazzy-common-interfaces==5.3.6 asyncio-for-robotics==1.5.1

cat >program.py <<'PYTHON'
import inspect
import time
from importlib.metadata import version

import asyncio_for_robotics.ros2 as afor
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_system_default
from std_msgs.msg import String

print("asyncio-for-robotics", version("asyncio-for-robotics"), "ros-rclpy", version("ros-rclpy"))
default = inspect.signature(afor.Sub.__init__).parameters["qos_profile"].default
print("its default is the system's:", default == qos_profile_system_default)
rclpy.init()
node = rclpy.create_node("both")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def heard(offered: QoSProfile, asked: QoSProfile, *, late: bool) -> int:
    got: list[String] = []
    publisher = node.create_publisher(String, f"topic{time.monotonic_ns()}", offered)
    if late:
        publisher.publish(String())
    subscription = node.create_subscription(String, publisher.topic_name, got.append, asked)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    time.sleep(1)
    for _ in range(0 if late else 10):
        publisher.publish(String())
    time.sleep(0.5)
    until = time.monotonic() + 1
    while time.monotonic() < until:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_subscription(subscription)
    return len(got)


print("of a burst of 10, by default:", heard(QoSProfile(depth=10), default, late=False))
print("of a burst of 10, depth=10:", heard(QoSProfile(depth=10), QoSProfile(depth=10), late=False))
print("of 1 latched, by default:", heard(latched, default, late=True))
print("of 1 latched, latched:", heard(latched, latched, late=True))
PYTHON

cat >expected <<'TEXT'
asyncio-for-robotics 1.5.1 ros-rclpy 7.1.6
its default is the system's: True
of a burst of 10, by default: 1
of a burst of 10, depth=10: 10
of 1 latched, by default: 0
of 1 latched, latched: 1
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
