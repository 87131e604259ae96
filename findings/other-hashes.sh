#!/usr/bin/env bash
# zenoh-ros2-sdk gives types with a char or a bounded sequence another hash than ROS does.
#
# zenoh-ros2-sdk 0.1.8, from PyPI. The hash is a part of the key under which rmw_zenoh publishes, so the two do not hear each
# other, and neither says so. ROS makes a uint8 of `char` before it hashes; here it stays a char. `float64[<=3]` is taken
# for a nested type of that name. The definitions and the hashes to compare with come from the wheels of ROS 2 Jazzy.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple zenoh-ros2-sdk==0.1.8 eclipse-zenoh==1.10.2
venv/bin/pip install -q --no-compile --no-deps --index-url https://pypi.org/simple ros-std-msgs==5.3.6 \
    ros-geometry-msgs==5.3.6 ros-shape-msgs==5.3.6 ros-service-msgs==2.0.3 ros-builtin-interfaces==2.0.3

cat >program.py <<'PYTHON'
import json
import sys
from importlib.metadata import version
from pathlib import Path

from zenoh_ros2_sdk.utils import compute_type_hash_from_msg

print("zenoh-ros2-sdk", version("zenoh-ros2-sdk"))
share = Path(sys.prefix, "share")
paths = {f"{path.parts[-3]}/msg/{path.stem}": path for path in share.glob("*/msg/*.msg")}
definitions = {name: path.read_text() for name, path in paths.items()}
TYPES = {
    "std_msgs/msg/Byte": "byte",
    "std_msgs/msg/ColorRGBA": "float32",
    "std_msgs/msg/Char": "char",
    "service_msgs/msg/ServiceEventInfo": "char[16]",
    "geometry_msgs/msg/Polygon": "Point32[]",
    "shape_msgs/msg/SolidPrimitive": "float64[<=3]",
}
for name, kind in TYPES.items():
    described = json.loads(paths[name].with_suffix(".json").read_text())
    of_ros = {each["type_name"]: each["hash_string"] for each in described["type_hashes"]}[name]
    own = compute_type_hash_from_msg(name, definitions[name], definitions)
    print(f"{name} ({kind}): {'the hash of ROS' if own == of_ros else 'another hash'}")
PYTHON

cat >expected <<'TEXT'
zenoh-ros2-sdk 0.1.8
std_msgs/msg/Byte (byte): the hash of ROS
std_msgs/msg/ColorRGBA (float32): the hash of ROS
std_msgs/msg/Char (char): another hash
service_msgs/msg/ServiceEventInfo (char[16]): another hash
geometry_msgs/msg/Polygon (Point32[]): the hash of ROS
shape_msgs/msg/SolidPrimitive (float64[<=3]): another hash
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
