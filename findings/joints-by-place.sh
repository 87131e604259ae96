#!/usr/bin/env bash
# mcap-bag-parser puts a joint's position into the column of another joint.
#
# mcap-bag-parser 0.3.1, from PyPI; rosbags 0.11.9 writes the file. `to_dataframe` names the columns of a JointState by
# the first message of the topic, and fills them by place. An arm and a gripper that publish on one topic, or a driver
# that changes the order of its joints, get mixed. Messages of different topics with the same time of recording become
# one row, and of two of one topic with the same time only the first is left.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple mcap-bag-parser==0.3.1 mcap==1.6.0 rosbags==0.11.9 \
    pandas==3.1.1

cat >program.py <<'PYTHON'
import contextlib
import io
from importlib.metadata import version
from pathlib import Path

import numpy as np
from mcap_bag import BagFileParser
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

print("mcap-bag-parser", version("mcap-bag-parser"), "rosbags", version("rosbags"))
store = get_typestore(Stores.ROS2_JAZZY)
types = store.types
KIND, TEXT, NONE = "sensor_msgs/msg/JointState", "std_msgs/msg/String", np.array([], np.float64)


def joints(**positions: float):
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](7, 0), "")
    return types[KIND](header, [*positions], np.array([*positions.values()]), NONE, NONE)


with Writer("bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    topic = bag.add_connection("/joints", KIND, typestore=store)
    log = bag.add_connection("/log", TEXT, typestore=store)
    for stamp, message in enumerate((joints(arm=1.0, hand=2.0), joints(hand=2.0, arm=1.0), joints(hand=2.0))):
        bag.write(topic, stamp, store.serialize_cdr(message, KIND))
    for text in ("first", "second"):
        bag.write(log, 10, store.serialize_cdr(types[TEXT](text), TEXT))
with contextlib.redirect_stdout(io.StringIO()):
    frame = BagFileParser(Path("bag/bag.mcap")).to_dataframe()
for _, row in frame.iterrows():
    print(*(f"{name}={row[name]}" for name in ("/joints.position.arm", "/joints.position.hand", "/log.data")))
PYTHON

cat >expected <<'TEXT'
mcap-bag-parser 0.3.1 rosbags 0.11.9
/joints.position.arm=1.0 /joints.position.hand=2.0 /log.data=nan
/joints.position.arm=2.0 /joints.position.hand=1.0 /log.data=nan
/joints.position.arm=2.0 /joints.position.hand=nan /log.data=nan
/joints.position.arm=nan /joints.position.hand=nan /log.data=first
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
