#!/usr/bin/env bash
# With RMW_FASTRTPS_USE_QOS_FROM_XML=1, a topic with a key takes messages of ten keys, and refuses the others'.
#
# ros-rclpy 9.1.2 with rmw_fastrtps_cpp 9.3.3 (ROS 2 Kilted, the first one with keys), from PyPI. By itself, rmw_fastrtps lifts
# Fast DDS's limit of ten instances where a type has a key. The variable has it leave all to a profile, which is usually
# there for memory or publish mode and names no limit, or is not there at all. Then the limit of ten counts. With three times
# 0 for `max_samples`, `max_instances` and `max_samples_per_instance` in the profile, all cross.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=85
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-kilted-rclpy==9.1.2 ros-rclpy==9.1.2 \
    ros-kilted-rmw-fastrtps-cpp==9.3.3 ros-kilted-test-msgs==2.3.0

cat >program.py <<'PYTHON'
import sys
import time
from importlib.metadata import version

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.qos import QoSProfile
from test_msgs.msg import KeyedString

print(sys.argv[1], "ros-rclpy", version("ros-rclpy"))
rclpy.init()
node = rclpy.create_node("both")
got, refused = [], 0
publisher = node.create_publisher(KeyedString, "robots", QoSProfile(depth=10))
node.create_subscription(KeyedString, "robots", got.append, QoSProfile(depth=10))
while not publisher.get_subscription_count():
    time.sleep(0.05)
time.sleep(0.5)
for number in range(15):
    try:
        publisher.publish(KeyedString(key=f"robot{number}"))
    except RCLError:
        refused += 1
    rclpy.spin_once(node, timeout_sec=0.1)
until = time.monotonic() + 1
while time.monotonic() < until:
    rclpy.spin_once(node, timeout_sec=0.1)
print("of 15 keys: heard", len(got), "refused", refused)
PYTHON

cat >limits.xml <<'XML'
<?xml version="1.0" encoding="UTF-8" ?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <data_writer profile_name="writer" is_default_profile="true">
    <topic><resourceLimitsQos>
      <max_samples>0</max_samples><max_instances>0</max_instances><max_samples_per_instance>0</max_samples_per_instance>
    </resourceLimitsQos></topic>
  </data_writer>
  <data_reader profile_name="reader" is_default_profile="true">
    <topic><resourceLimitsQos>
      <max_samples>0</max_samples><max_instances>0</max_instances><max_samples_per_instance>0</max_samples_per_instance>
    </resourceLimitsQos></topic>
  </data_reader>
</profiles>
XML
cat >expected <<'TEXT'
without: ros-rclpy 9.1.2
of 15 keys: heard 15 refused 0
with: ros-rclpy 9.1.2
of 15 keys: heard 10 refused 5
with limits: ros-rclpy 9.1.2
of 15 keys: heard 15 refused 0
TEXT
{
    venv/bin/python program.py without:
    RMW_FASTRTPS_USE_QOS_FROM_XML=1 venv/bin/python program.py with:
    RMW_FASTRTPS_USE_QOS_FROM_XML=1 FASTDDS_DEFAULT_PROFILES_FILE=$PWD/limits.xml venv/bin/python program.py "with limits:"
} | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
