#!/usr/bin/env bash
# A writer whose nackSupressionDuration is 0.1 s is seconds behind after its reader has stood still for tenths.
#
# ros-rclpy 7.1.6 with rmw_fastrtps_cpp 8.4.3 on Fast DDS 2.14.5, from PyPI. For that time after a message was sent, the
# writer takes none of the reader's requests for it; the default is 0. It looks like a cheap way to spare wake-ups: a
# writer at 10 Hz then has fewer timers. But shared memory holds few messages of 100 kB, and a reader that is stopped for
# 0.1 s loses some. While they are not sent again, more come, and are lost, too.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=87
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-jazzy-rclpy==7.1.6 ros-rclpy==7.1.6 \
    ros-jazzy-rmw-fastrtps-cpp==8.4.3 ros-fastrtps==2.14.5 ros-jazzy-common-interfaces==5.3.6

profile() {
    cat <<XML
<?xml version="1.0" encoding="UTF-8" ?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <data_writer profile_name="writer" is_default_profile="true">
    <qos>
      <publishMode><kind>SYNCHRONOUS</kind></publishMode>
      <data_sharing><kind>OFF</kind></data_sharing>
    </qos>
    <times>
      <heartbeatPeriod><nanosec>500000000</nanosec></heartbeatPeriod>
      <nackSupressionDuration><nanosec>$1</nanosec></nackSupressionDuration>
    </times>
    <historyMemoryPolicy>DYNAMIC</historyMemoryPolicy>
  </data_writer>
  <data_reader profile_name="reader" is_default_profile="true">
    <qos><data_sharing><kind>OFF</kind></data_sharing></qos>
    <historyMemoryPolicy>DYNAMIC_REUSABLE</historyMemoryPolicy>
  </data_reader>
</profiles>
XML
}

cat >program.py <<'PYTHON'
import signal
import subprocess
import sys
import threading
import time
from importlib.metadata import version

import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt8MultiArray

ROUNDS, STOPS = 10, 4
rclpy.init()
node = rclpy.create_node(sys.argv[1])
if sys.argv[1] == "hears":
    heard = node.create_subscription(UInt8MultiArray, "scans", lambda _: None, QoSProfile(depth=5000), raw=True)
    rclpy.spin(node)
print(sys.argv[2], "ros-rclpy", version("ros-rclpy"), "ros-fastrtps", version("ros-fastrtps"))
publisher = node.create_publisher(UInt8MultiArray, "scans", QoSProfile(depth=2000))
message = serialize_message(UInt8MultiArray(data=bytes(100_000)))
hears = subprocess.Popen([sys.executable, __file__, "hears"])
while not publisher.get_subscription_count():
    time.sleep(0.05)
time.sleep(0.5)


def stop_now_and_then() -> None:
    for _ in range(STOPS):
        hears.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        hears.send_signal(signal.SIGCONT)
        time.sleep(0.05)


late = 0.0
for _ in range(ROUNDS):
    stops = threading.Thread(target=stop_now_and_then)
    stops.start()
    for _ in range(1000):
        publisher.publish(message)
        time.sleep(0.001)
    stops.join()
    began = time.monotonic()
    acknowledged = publisher.wait_for_all_acked(Duration(seconds=60))
    late += time.monotonic() - began
    assert acknowledged
print("behind by more than a second in ten rounds:", late > 1)
print(f"{late:.2f} s", file=sys.stderr)
hears.kill()
PYTHON

cat >expected <<'TEXT'
0 ros-rclpy 7.1.6 ros-fastrtps 2.14.5
behind by more than a second in ten rounds: False
100000000 ros-rclpy 7.1.6 ros-fastrtps 2.14.5
behind by more than a second in ten rounds: True
TEXT
for duration in 0 100000000; do
    profile "$duration" >profile.xml
    FASTRTPS_DEFAULT_PROFILES_FILE=$PWD/profile.xml RMW_FASTRTPS_USE_QOS_FROM_XML=1 venv/bin/python program.py sends "$duration"
done | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
