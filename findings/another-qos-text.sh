#!/usr/bin/env bash
# rosbags counts the messages of a bag, and yields none of them.
#
# rosbags 0.11.9, from PyPI. Of a folder, a topic in metadata.yaml and a channel in the MCAP file belong together if their
# QoS is the same, too. They differ if one of the two has none, as when another program has rewritten the MCAP file, or
# metadata.yaml was made by hand. Nothing is said. `AnyReader([Path("bag/bag.mcap")])`, the file instead of the folder, reads all.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple rosbags==0.11.9 mcap==1.6.0

cat >program.py <<'PYTHON'
from importlib.metadata import version
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer as FileWriter
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

BAG, KIND = Path("bag"), "std_msgs/msg/String"
print("rosbags", version("rosbags"), "mcap", version("mcap"))
types = get_typestore(Stores.ROS2_JAZZY)
latched = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
    QosTime(0, 0), QosTime(0, 0), QosLiveliness.AUTOMATIC, QosTime(0, 0), avoid_ros_namespace_conventions=False,
)
with Writer(BAG, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    topic = bag.add_connection("/map_name", KIND, typestore=types, offered_qos_profiles=[latched])
    for stamp in range(3):
        bag.write(topic, stamp, types.serialize_cdr(types.types[KIND](data="hall"), KIND))


def show(what: str, path: Path) -> None:
    with AnyReader([path]) as reader:
        print(f"{what}: counts {reader.message_count}, yields {len([*reader.messages()])}")


show("as written by rosbags", BAG)
with (BAG / "bag.mcap").open("rb") as file:
    messages = [*make_reader(file).iter_messages()]
with (BAG / "bag.mcap").open("wb") as file:
    writer = FileWriter(file)
    writer.start(profile="ros2")
    schema = messages[0][0]
    number = writer.register_schema(schema.name, schema.encoding, schema.data)
    channel = writer.register_channel("/map_name", "cdr", number)  # without metadata, which MCAP does not ask for
    for *_, message in messages:
        writer.add_message(channel, message.log_time, message.data, message.publish_time)
    writer.finish()
show("the same messages, rewritten by mcap, the folder", BAG)
show("the same messages, rewritten by mcap, the file", BAG / "bag.mcap")
PYTHON

cat >expected <<'TEXT'
rosbags 0.11.9 mcap 1.6.0
as written by rosbags: counts 3, yields 3
the same messages, rewritten by mcap, the folder: counts 3, yields 0
the same messages, rewritten by mcap, the file: counts 3, yields 3
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
