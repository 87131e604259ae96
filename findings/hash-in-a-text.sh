#!/usr/bin/env bash
# A constant "#ff0000" is empty in ROS, and in recordings it is not.
#
# ros-rosidl-adapter 4.6.6 (of ROS 2 Jazzy), rosbags 0.11.9 and ros-parser 0.9.0, from PyPI. The adapter reads .msg files for ROS's
# generators. It cuts each line at the first `#`, quoted or not, and no build fails: colours are empty, topics of MQTT end
# early and begin with a quote. That holds for constants and for defaults. Readers of recordings, which have the same
# definition, keep the `#`. rosbags also reads 010 as octal, and takes the comment after an unquoted text for a part of it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple rosbags==0.11.9 ros-parser==0.9.0
venv/bin/pip install -q --no-compile --no-deps --index-url https://pypi.org/simple ros-rosidl-adapter==4.6.6

cat >program.py <<'PYTHON'
from importlib.metadata import version

from ros_parser import ros2_msg
from rosbags.typesys import get_types_from_msg
from rosidl_adapter.parser import parse_message_string

print(*(f"{name} {version(name)}" for name in ("ros-rosidl-adapter", "rosbags", "ros-parser")))
LINES = (
    'string VALUE="red"',
    'string VALUE="#ff0000"',
    'string VALUE="robot/#"  # a comment',
    "string VALUE=red  # a comment",
    "int32 VALUE=010",
    'string value "#ff0000"',
)


def by_adapter(line: str) -> object:
    message = parse_message_string("our_msgs", "Light", line)
    return message.constants[0].value if message.constants else message.fields[0].default_value


def by_rosbags(line: str) -> object:
    constants, _ = get_types_from_msg(line, "our_msgs/msg/Light")["our_msgs/msg/Light"]
    return constants[0][2] if constants else "not kept"


def by_ros_parser(line: str) -> object:
    message = ros2_msg.parse_message_string(line)
    return message.constants[0].value if message.constants else message.fields[0].default_value


for line in LINES:
    print(f"{line}: ROS {by_adapter(line)!r}, rosbags {by_rosbags(line)!r}, ros-parser {by_ros_parser(line)!r}")
PYTHON

cat >expected <<'TEXT'
ros-rosidl-adapter 4.6.6 rosbags 0.11.9 ros-parser 0.9.0
string VALUE="red": ROS 'red', rosbags 'red', ros-parser 'red'
string VALUE="#ff0000": ROS '', rosbags '#ff0000', ros-parser '#ff0000'
string VALUE="robot/#"  # a comment: ROS '"robot/', rosbags 'robot/#', ros-parser 'robot/#'
string VALUE=red  # a comment: ROS 'red', rosbags 'red  # a comment', ros-parser 'red'
int32 VALUE=010: ROS 10, rosbags 8, ros-parser 10
string value "#ff0000": ROS '', rosbags 'not kept', ros-parser '#ff0000'
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
