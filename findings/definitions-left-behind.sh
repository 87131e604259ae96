#!/usr/bin/env bash
# pymcap-cli converts a bag into a file without a message, and ends with 0, though the bag has all that it lacks.
#
# pymcap-cli 0.34.0, from PyPI. A bag in sqlite3 has had the definitions of its types since Iron, in a table of its own.
# `convert` does not read it: it looks for each type in folders of ROS and in the sources of a distribution, by
# default Humble's, on the network. A type of one's own is in neither. Its topic is left out with a warning, behind
# "completed successfully". The table's text in a folder that `--extra-path` names converts all of them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple pymcap-cli==0.34.0 rosbags==0.11.9 mcap==1.6.0

cat >program.py <<'PYTHON'
import sqlite3
import subprocess
from importlib.metadata import version
from pathlib import Path

from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KIND, TEXT = "depot_msgs/msg/Gripper", "float64 width\nbool holds\n"
print("pymcap-cli", version("pymcap-cli"))
types = get_typestore(Stores.ROS2_JAZZY)
types.register(get_types_from_msg(TEXT, KIND))
with Writer(Path("bag"), version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
    topic = bag.add_connection("/gripper", KIND, typestore=types)
    for stamp in range(3):
        bag.write(topic, stamp, types.serialize_cdr(types.types[KIND](width=0.08, holds=False), KIND))
table = "SELECT topic_type, encoded_message_definition FROM message_definitions"
[(name, definition)] = sqlite3.connect("bag/bag.db3").execute(table).fetchall()
print("the bag defines", name, "with", definition.split())


def convert(what: str, *options: str) -> None:
    command = ["venv/bin/pymcap-cli", "convert", "bag/bag.db3", "-f", "-o", "out.mcap", *options]
    status = subprocess.run(command, capture_output=True, check=False).returncode
    with open("out.mcap", "rb") as file:
        print(f"{what}: status {status}, messages {len([*make_reader(file).iter_messages()])}")


convert("converted")
convert("converted for Jazzy", "--distro", "jazzy")
place = Path("own/depot_msgs/msg/Gripper.msg")
place.parent.mkdir(parents=True)
place.write_text(definition)
convert("with the bag's own text beside it", "--extra-path", "own")
PYTHON

cat >expected <<'TEXT'
pymcap-cli 0.34.0
the bag defines depot_msgs/msg/Gripper with ['float64', 'width', 'bool', 'holds']
converted: status 0, messages 0
converted for Jazzy: status 0, messages 0
with the bag's own text beside it: status 0, messages 3
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
