#!/usr/bin/env bash
# A drone's empty battery is not seen if it has a second one.
#
# flightdx 0.1.0 with pyulog 1.3.0, from PyPI. A topic of PX4 may have several instances, each with a `multi_id` of its own in
# the log, as of two batteries, two receivers of GPS or two boards of motors. flightdx keeps each topic by its name alone, so
# the last instance that the log names replaces the others. What happened to the first battery is in no report, and
# nothing says that it was left out. pyulog has both: ask it for `get_dataset("battery_status", 0)`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple flightdx==0.1.0 pyulog==1.3.0

cat >program.py <<'PYTHON'
import struct
from importlib.metadata import version
from pathlib import Path

from flightdx.detectors.battery import detect_battery
from flightdx.parsers.ulog import parse_ulog
from pyulog import ULog

print("flightdx", version("flightdx"), "pyulog", version("pyulog"))
FORMAT = b"battery_status:uint64_t timestamp;float voltage_v;float current_a;"
FULL, EMPTY = [16.8, 16.7, 16.6, 16.5, 16.4], [16.8, 15.0, 13.0, 11.0, 9.0]


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<Hc", len(content), kind) + content


def written(*batteries: list[float]) -> str:
    log = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40)) + message(b"F", FORMAT)
    for instance, _ in enumerate(batteries):
        log += message(b"A", struct.pack("<BH", instance, instance) + b"battery_status")
    for second, voltages in enumerate(zip(*batteries, strict=True)):
        for instance, voltage in enumerate(voltages):
            log += message(b"D", struct.pack("<HQff", instance, second * 1_000_000, voltage, 5.0))
    Path("flight.ulg").write_bytes(log)
    return "flight.ulg"


for name, batteries in {"empty": [EMPTY], "empty, full": [EMPTY, FULL], "full, empty": [FULL, EMPTY]}.items():
    path = written(*batteries)
    topics = [(topic.multi_id, round(min(topic.data["voltage_v"].tolist()), 1)) for topic in ULog(path).data_list]
    parsed = parse_ulog(path)
    values = parsed.signals["battery_voltage"].values
    incidents = [f"{each.type} ({each.severity})" for each in detect_battery(parsed)]
    found = incidents or "no incident"
    print(f"{name}: pyulog {topics}, flightdx {len(values)} values from {min(values):.1f} V,", found)
PYTHON

cat >expected <<'TEXT'
flightdx 0.1.0 pyulog 1.3.0
empty: pyulog [(0, 9.0)], flightdx 5 values from 9.0 V, ['battery_voltage_sag (critical)']
empty, full: pyulog [(0, 9.0), (1, 16.4)], flightdx 5 values from 16.4 V, no incident
full, empty: pyulog [(0, 16.4), (1, 9.0)], flightdx 5 values from 9.0 V, ['battery_voltage_sag (critical)']
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
