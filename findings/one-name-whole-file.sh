#!/usr/bin/env bash
# A profile of Fast DDS that Jazzy takes is refused whole by Kilted, for the name of one element, and the reverse.
#
# ros-fastrtps 2.14.5 (ROS 2 Jazzy) and ros-fastdds 3.2.3 (Kilted), from PyPI. Fast DDS 3 calls `heartbeatPeriod`
# `heartbeat_period`, and other times alike. Either version refuses the whole file then, also its transports: the node
# starts with the defaults, with lines of `XMLPARSER Error` in its output, and a shared memory of 512 KiB in place of 32 MiB.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=86
"${PYTHON:-python3}" -m venv jazzy
jazzy/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-jazzy-rclpy==7.1.6 ros-rclpy==7.1.6 \
    ros-jazzy-rmw-fastrtps-cpp==8.4.3 ros-fastrtps==2.14.5
"${PYTHON:-python3}" -m venv kilted
kilted/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-kilted-rclpy==9.1.2 ros-rclpy==9.1.2 \
    ros-kilted-rmw-fastrtps-cpp==9.3.3 ros-fastdds==3.2.3

for name in heartbeatPeriod heartbeat_period; do
    cat >$name.xml <<XML
<?xml version="1.0" encoding="UTF-8" ?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>large</transport_id><type>SHM</type><segment_size>33554432</segment_size>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="large" is_default_profile="true">
    <rtps>
      <useBuiltinTransports>false</useBuiltinTransports>
      <userTransports><transport_id>large</transport_id></userTransports>
    </rtps>
  </participant>
  <data_writer profile_name="writer" is_default_profile="true">
    <times><$name><sec>1</sec></$name></times>
  </data_writer>
</profiles>
XML
done
cat >program.py <<'PYTHON'
import sys

import rclpy

rclpy.init()
node = rclpy.create_node("node")
sizes = []
with open("/proc/self/maps") as maps:
    for line in maps:
        if "/dev/shm/fast" in line and "port" not in line:
            begin, end = (int(each, 16) for each in line.split()[0].split("-"))
            sizes.append(end - begin)
print(*sys.argv[1:], "shared memory of", "32 MiB" if max(sizes) > 30 << 20 else "less than 1 MiB")
PYTHON

cat >expected <<'TEXT'
jazzy heartbeatPeriod shared memory of 32 MiB
jazzy heartbeat_period shared memory of less than 1 MiB
kilted heartbeatPeriod shared memory of less than 1 MiB
kilted heartbeat_period shared memory of 32 MiB
TEXT
for each in jazzy kilted; do
    for name in heartbeatPeriod heartbeat_period; do
        variable=$([ $each = jazzy ] && echo FASTRTPS_DEFAULT_PROFILES_FILE || echo FASTDDS_DEFAULT_PROFILES_FILE)
        env "$variable=$PWD/$name.xml" $each/bin/python program.py $each $name 2>&1 | grep "shared memory"
    done
done | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
