#!/usr/bin/env bash
# rosbag-resurrector reads images, joint efforts and some Imus from wrong places, without an error.
#
# rosbag-resurrector 0.8.7, from PyPI; rosbags 0.11.9 writes the file. Its decoder goes on at the next multiple of four
# after each string, and at the next multiple of eight after each length of a sequence of doubles. CDR aligns a value only
# where it stands: no byte is left out before `is_bigendian`, and none in an empty sequence; but doubles stand at
# multiples of eight, also behind a short name of a frame. The step of an image of `rgb8` then is its size, its picture is
# None, efforts are missing where there are no velocities, and an Imu depends on the length of its frame's name.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple rosbag-resurrector==0.8.7 rosbags==0.11.9 mcap==1.6.0

cat >program.py <<'PYTHON'
from importlib.metadata import version
from pathlib import Path

import numpy as np
from resurrector.ingest.parser import get_image_array, parse_bag
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

print("rosbag-resurrector", version("rosbag-resurrector"), "rosbags", version("rosbags"))
store = get_typestore(Stores.ROS2_JAZZY)
types = store.types


def header(frame: str):
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](7, 0), frame)


def image(encoding: str, pixel: int):
    data = np.arange(4 * pixel, dtype=np.uint8)
    return types["sensor_msgs/msg/Image"](header("camera"), 2, 2, encoding, 0, 2 * pixel, data)


def imu(frame: str):
    zeros, still = np.zeros(9), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    turns, falls = (types["geometry_msgs/msg/Vector3"](0.0, 0.0, each) for each in (0.5, 9.81))
    return types["sensor_msgs/msg/Imu"](header(frame), still, zeros, turns, zeros, falls, zeros)


none = np.array([], np.float64)
joints = types["sensor_msgs/msg/JointState"](header(""), ["wheel"], np.array([1.0]), none, np.array([9.0]))
with Writer("bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    for topic, message in {
        "/rgb8": image("rgb8", 3),
        "/joints": joints,
        "/imu/of_base_link": imu("base_link"),
        "/imu/of_camera": imu("camera"),
    }.items():
        kind = message.__msgtype__
        bag.write(bag.add_connection(topic, kind, typestore=store), 0, store.serialize_cdr(message, kind))
for message in parse_bag(Path("bag/bag.mcap")).read_messages():
    data = message.data
    if "step" in data:
        picture = get_image_array(message)
        print(message.topic, "step", data["step"], "length", data["data_length"], "big endian", data["is_bigendian"])
        print(message.topic, "picture:", picture if picture is None else picture.tolist())
    elif "orientation" in data:
        print(message.topic, "w", data["orientation"]["w"], "falls", round(data["linear_acceleration"]["z"], 3))
    else:
        print(message.topic, "position", data["position"], "effort", data["effort"])
PYTHON

cat >expected <<'TEXT'
rosbag-resurrector 0.8.7 rosbags 0.11.9
/rgb8 step 12 length 50462976 big endian True
/rgb8 picture: None
/joints position [1.0] effort []
/imu/of_base_link w 1.0 falls 9.81
/imu/of_camera w 0.0 falls 4.2769804971223216e+86
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
