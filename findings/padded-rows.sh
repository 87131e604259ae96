#!/usr/bin/env bash
# Padding at the end of a row becomes pixels and points.
#
# rosbags-image 0.10.4 and pypcd4 1.5.1, from PyPI. `step` of an Image and `row_step` of a PointCloud2 are the bytes from
# one row to the next, and may be more than a row needs: cameras align rows, organized clouds may, too. Both readers
# take the data as if there were no padding. pypcd4 also reads clouds whose `is_bigendian` is set as little-endian.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple "rosbags-image[opencv-headless]==0.10.4" pypcd4==1.5.1 \
    rosbags==0.11.9

cat >program.py <<'PYTHON'
from importlib.metadata import version

import numpy as np
from pypcd4 import PointCloud
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

print("rosbags-image", version("rosbags-image"), "pypcd4", version("pypcd4"))
types = get_typestore(Stores.ROS2_JAZZY).types
header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](7, 0), "front")
X = [types["sensor_msgs/msg/PointField"]("x", 0, 7, 1)]


def points(height: int, row_step: int, data: bytes, *, big: bool = False) -> list[float]:
    width = 4 // height
    rows = np.frombuffer(data, np.uint8)
    cloud = types["sensor_msgs/msg/PointCloud2"](header, height, width, X, big, 4, row_step, rows, True)
    return [round(each, 3) for each in PointCloud.from_msg(cloud).numpy()[:, 0].tolist()]


image = types["sensor_msgs/msg/Image"](header, 2, 2, "mono8", 0, 4, np.array([1, 2, 99, 99, 3, 4, 99, 99], np.uint8))
print("image of 1 2 and 3 4, padded by 99:", message_to_cvimage(image).tolist())
plain = np.array([1, 2, 3, 4], "<f4").tobytes()
print("points 1 2 3 4:", points(2, 8, plain))
print("points 1 2 3 4 in two padded rows:", points(2, 12, plain[:8] + bytes(4) + plain[8:] + bytes(4)))
print("points 1 2 3 4, big-endian:", points(1, 16, np.array([1, 2, 3, 4], ">f4").tobytes(), big=True))
PYTHON

cat >expected <<'TEXT'
rosbags-image 0.10.4 pypcd4 1.5.1
image of 1 2 and 3 4, padded by 99: [[1, 2], [99, 99]]
points 1 2 3 4: [1.0, 2.0, 3.0, 4.0]
points 1 2 3 4 in two padded rows: [1.0, 2.0, 0.0, 3.0, 4.0, 0.0]
points 1 2 3 4, big-endian: [0.0, 0.0, 0.0, 0.0]
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
