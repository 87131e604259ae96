#!/usr/bin/env bash
# pymcap-cli keeps the latched messages of a recording that it cuts, but not of one that Humble made.
#
# pymcap-cli 0.34.0, from PyPI. `filter --latch-from-metadata` looks for topics whose publishers are transient local,
# whose last message before the cut belongs to what is kept. rosbag2 writes policies by their names since its version 9
# (Jazzy), and wrote their numbers before; the names alone are found. Maps and static transforms of older
# recordings are gone, and nothing is said. `--latch '/tf_static' --latch '/map.*'` names them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple pymcap-cli==0.34.0 rosbags==0.11.9 mcap==1.6.0

cat >program.py <<'PYTHON'
import subprocess
from importlib.metadata import version
from pathlib import Path

from mcap.reader import make_reader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

KIND, SECOND = "std_msgs/msg/String", 10**9
print("pymcap-cli", version("pymcap-cli"))
types = get_typestore(Stores.ROS2_HUMBLE)


def qos(durability: QosDurability) -> Qos:
    none = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, durability, none, none, QosLiveliness.AUTOMATIC, none,
        avoid_ros_namespace_conventions=False,
    )


for rosbag2 in (9, 8):
    name = f"bag{rosbag2}"
    with Writer(Path(name), version=rosbag2, storage_plugin=StoragePlugin.MCAP) as bag:
        floor, steps = (
            bag.add_connection(topic, KIND, typestore=types, offered_qos_profiles=[qos(durability)])
            for topic, durability in (("/floor", QosDurability.TRANSIENT_LOCAL), ("/steps", QosDurability.VOLATILE))
        )
        content = types.serialize_cdr(types.types[KIND](data="two"), KIND)
        bag.write(floor, SECOND, content)
        for second in range(1, 6):
            bag.write(steps, second * SECOND, content)
    cut = ["venv/bin/pymcap-cli", "filter", f"{name}/{name}.mcap", "-o", "cut.mcap", "-S", "+2s"]
    for options in (["--latch-from-metadata"], ["--latch", "/floor"]):
        subprocess.run([*cut, "-f", *options], capture_output=True, check=True)
        with open("cut.mcap", "rb") as file:
            found = [(channel, message) for _, channel, message in make_reader(file).iter_messages()]
        print(f"version {rosbag2}, {options[0]}:", [channel.topic for channel, _ in found])
    with open(f"{name}/{name}.mcap", "rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    profile = next(each.metadata["offered_qos_profiles"] for each in channels if each.topic == "/floor")
    print([line.strip() for line in profile.splitlines() if "durability" in line])
PYTHON

cat >expected <<'TEXT'
pymcap-cli 0.34.0
version 9, --latch-from-metadata: ['/floor', '/steps', '/steps', '/steps']
version 9, --latch: ['/floor', '/steps', '/steps', '/steps']
['durability: transient_local']
version 8, --latch-from-metadata: ['/steps', '/steps', '/steps']
version 8, --latch: ['/floor', '/steps', '/steps', '/steps']
['durability: 1']
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
