#!/usr/bin/env bash
# A node started with a parameter file gets other values than a running node that loads the same file.
#
# ros-rclpy 7.1.6, from PyPI. `--params-file` is read by rcl, in C. `ros2 param load` and `AsyncParameterClient.load_parameter_file`
# read by `parameter_dict_from_yaml_file`, which makes text of each value that YAML has given it, and reads the text as YAML
# again. Quotes are gone by then, times become minutes, and doubles turn to text. What YAML calls a number the two do not
# agree on either. A file is read alike if its doubles are written as 0.001, and none of its texts looks like something else.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=84
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-jazzy-rclpy==7.1.6 ros-rclpy==7.1.6 \
    ros-jazzy-rmw-fastrtps-cpp==8.4.3

cat >program.py <<'PYTHON'
from importlib.metadata import version
from pathlib import Path

import rclpy
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python

print("ros-rclpy", version("ros-rclpy"))
VALUES = ("0.001", "1e-3", "-.5", ".inf", "'1'", "'true'", "0123", "08", "1_000", "n", "no", "12:30", "2026-11-29", "~")
path = Path("parameters.yaml")
lines = [f"    value{place}: {text}\n" for place, text in enumerate(VALUES)]
path.write_text("/node:\n  ros__parameters:\n" + "".join(lines))
rclpy.init(args=["--ros-args", "--params-file", str(path)])
node = rclpy.create_node("node", automatically_declare_parameters_from_overrides=True)
loaded = parameter_dict_from_yaml_file(str(path))
for place, text in enumerate(VALUES):
    started = node.get_parameter(f"value{place}").value
    print(f"{text}: {started!r} at start, {parameter_value_to_python(loaded[f'value{place}'].value)!r} loaded")
PYTHON

cat >expected <<'TEXT'
ros-rclpy 7.1.6
0.001: 0.001 at start, 0.001 loaded
1e-3: 0.001 at start, '1e-3' loaded
-.5: -0.5 at start, '-.5' loaded
.inf: inf at start, 'inf' loaded
'1': '1' at start, 1 loaded
'true': 'true' at start, True loaded
0123: 83 at start, 83 loaded
08: 8.0 at start, '08' loaded
1_000: '1_000' at start, 1000 loaded
n: False at start, 'n' loaded
no: False at start, False loaded
12:30: '12:30' at start, 750 loaded
2026-11-29: '2026-11-29' at start, datetime.date(2026, 11, 29) loaded
~: '~' at start, 'None' loaded
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
