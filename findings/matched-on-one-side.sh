#!/usr/bin/env bash
# A subscription of a type with a key counts a publisher of Cyclone DDS that does not count it, and hears nothing.
#
# ros-rclpy 9.1.2 with rmw_fastrtps_cpp 9.3.3 (ROS 2 Kilted), and cyclonedds 11.0.1, from PyPI. Both have the same type: `key`
# is its key. rmw_fastrtps announces the type's fields without the key (ros2/rmw_fastrtps#848, mended in rolling), so
# Cyclone DDS takes the types for different ones, and says nothing; Fast DDS compares less, and matches. ROS's number of
# matched publishers is 1 for ever, and `wait for a publisher` ends. Without a key, both match and it hears all.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=87
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-kilted-rclpy==9.1.2 ros-rclpy==9.1.2 \
    ros-kilted-rmw-fastrtps-cpp==9.3.3 ros-kilted-test-msgs==2.3.0 ros-kilted-common-interfaces==5.5.1 cyclonedds==11.0.1
export CYCLONEDDS_URI="<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>64</MaxAutoParticipantIndex><Peers><Peer address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"

cat >program.py <<'PYTHON'
import os
import subprocess
import sys
from importlib.metadata import version

WRITER = """
import sys, time
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

keyed = sys.argv[1] == "keyed"
fields = {"key": str, "value": str} if keyed else {"data": str}
name = "test_msgs::msg::dds_::KeyedString_" if keyed else "std_msgs::msg::dds_::String_"
kind = make_idl_struct("Kind", name, fields, field_annotations={"key": {"key": True}} if keyed else {})
qos = Qos(Policy.DataRepresentation(use_cdrv0_representation=True), Policy.Reliability.Reliable(duration(seconds=1)))
participant = DomainParticipant(87)
writer = DataWriter(participant, Topic(participant, "rt/text", kind), qos)
for _ in range(40):
    writer.write(kind(**dict.fromkeys(fields, "a")))
    time.sleep(0.1)
print(len(writer.get_matched_subscriptions()))
"""

import rclpy
from std_msgs.msg import String
from test_msgs.msg import KeyedString

print("ros-rclpy", version("ros-rclpy"), "cyclonedds", version("cyclonedds"))
for name, kind in {"plain": String, "keyed": KeyedString}.items():
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("hears", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    got = []
    subscription = node.create_subscription(kind, "text", got.append, 10)
    with subprocess.Popen([sys.executable, "-c", WRITER, name], stdout=subprocess.PIPE, text=True, env=os.environ) as writer:
        matched = 0
        while writer.poll() is None:
            executor.spin_once(timeout_sec=0.1)
            matched = max(matched, subscription.get_publisher_count())
        print(name, "the subscription counts", matched, "the writer", writer.stdout.read().strip(), "heard:", bool(got))
    rclpy.shutdown(context=context)
PYTHON

cat >expected <<'TEXT'
ros-rclpy 9.1.2 cyclonedds 11.0.1
plain the subscription counts 1 the writer 1 heard: True
keyed the subscription counts 1 the writer 0 heard: False
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
