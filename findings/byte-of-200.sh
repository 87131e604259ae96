#!/usr/bin/env bash
# A byte of 200 is -56 to some readers, a char of 200 to others.
#
# rosbags 0.11.9, mcap-ros2-support 0.6.0, mcap-ros2-support-fast 0.8.0 and mcap-ros2idl-support 0.2.0, from PyPI. In ROS 2
# `byte` is an octet and `char` a uint8, so both are 0 to 255 (rclpy has b"\xc8" and 200). In ROS 1, `byte` was an int8.
# rosbags also refuses to write a byte of 200. One reader has no `byte` in a sequence, although it reads a single one.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple rosbags==0.11.9 mcap==1.6.0 \
    mcap-ros2-support==0.6.0 mcap-ros2-support-fast==0.8.0 small-mcap==0.16.0 mcap-ros2idl-support==0.2.0

cat >program.py <<'PYTHON'
import struct
from importlib.metadata import version

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2_support_fast.decoder import DecoderFactory as FastFactory
from mcap_ros2idl_support import Ros2DecodeFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FACTORIES = {
    "mcap-ros2-support": DecoderFactory,
    "mcap-ros2-support-fast": FastFactory,
    "mcap-ros2idl-support": Ros2DecodeFactory,
}
CDR = b"\0\1\0\0"
MESSAGES = {
    "byte": CDR + b"\xc8",
    "char": CDR + b"\xc8",
    "byte[]": CDR + b"\1\0\0\0\xc8",
}


def plain(message) -> object:
    value = message["data"] if isinstance(message, dict) else message.data
    return [*value] if hasattr(value, "__len__") else int(value)


def by_factory(kind: str, definition: bytes, data: bytes) -> object:
    schema = Schema(id=1, name="our_msgs/msg/Flags", encoding="ros2msg", data=definition)
    try:
        return plain(FACTORIES[kind]().decoder_for("cdr", schema)(data))
    except ValueError as error:
        return error


for field, data in MESSAGES.items():
    definition = f"{field} data\n"
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, "our_msgs/msg/Flags"))
    value = plain(types.deserialize_cdr(data, "our_msgs/msg/Flags"))
    print(f"{field:6} rosbags {version('rosbags')}: {[int(each) for each in value] if field == 'byte[]' else value}")
    for kind in FACTORIES:
        print(f"{field:6} {kind} {version(kind)}: {by_factory(kind, definition.encode(), data)}")
    if field == "byte":
        try:
            types.serialize_cdr(types.types["our_msgs/msg/Flags"](data=200), "our_msgs/msg/Flags")
        except struct.error as error:
            print("byte   rosbags, to write it:", error)
PYTHON

cat >expected <<'TEXT'
byte   rosbags 0.11.9: -56
byte   mcap-ros2-support 0.6.0: 200
byte   mcap-ros2-support-fast 0.8.0: 200
byte   mcap-ros2idl-support 0.2.0: -56
byte   rosbags, to write it: byte format requires -128 <= number <= 127
char   rosbags 0.11.9: 200
char   mcap-ros2-support 0.6.0: -56
char   mcap-ros2-support-fast 0.8.0: 200
char   mcap-ros2idl-support 0.2.0: 200
byte[] rosbags 0.11.9: [-56]
byte[] mcap-ros2-support 0.6.0: [200]
byte[] mcap-ros2-support-fast 0.8.0: [200]
byte[] mcap-ros2idl-support 0.2.0: Unrecognized primitive type byte
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
