#!/usr/bin/env bash
# ros2-pyterfaces' backend `cydr` gives empty clouds and empty diagnostics.
#
# ros2-pyterfaces 0.3.0, from PyPI. Its backend `cyclone` writes and reads these messages rightly. In `cydr`, the types of a
# cloud and of diagnostics have no fields. There is no error, and it writes a message that it has read as an empty one. It
# compiles each type when it is used, so the script needs a C compiler.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple "ros2_pyterfaces[cyclone,cydr]==0.3.0"

cat >program.py <<'PYTHON'
from importlib.metadata import version

from ros2_pyterfaces.cyclone import all_msgs as cyclone
from ros2_pyterfaces.cydr import all_msgs as cydr

print("ros2_pyterfaces", version("ros2_pyterfaces"))
field = cyclone.PointField(name="x", datatype=7, count=1)
MESSAGES = (
    cyclone.PointCloud2(height=1, width=1, fields=[field], point_step=4, row_step=4, data=[0, 0, 128, 63]),
    cyclone.DiagnosticArray(status=[cyclone.DiagnosticStatus(name="battery")]),
)
for message in MESSAGES:
    name, data = type(message).__name__, bytes(message.serialize())
    again, other = getattr(cyclone, name).deserialize(data), getattr(cydr, name).deserialize(data)
    sizes = f"{len(other.serialize())} of {len(data)} bytes"
    print(f"{name}: cyclone reads what it wrote: {again == message}; cydr reads {other}, {sizes}")
PYTHON

cat >expected <<'TEXT'
ros2_pyterfaces 0.3.0
PointCloud2: cyclone reads what it wrote: True; cydr reads PointCloud2(), 5 of 73 bytes
DiagnosticArray: cyclone reads what it wrote: True; cydr reads DiagnosticArray(), 5 of 60 bytes
TEXT
CFLAGS=-O0 venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
