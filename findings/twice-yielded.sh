#!/usr/bin/env bash
# bagx gives messages twice if one of the file cannot be decoded.
#
# bagx 0.6.0 with mcap-ros2-support 0.6.0, from PyPI; mcap 1.6.0 writes the file. It decodes a file until something fails,
# and then begins again at the first message without the decoder: earlier messages are yielded a second time, and have no
# fields. A topic with a `wstring`, which the decoder does not know, is enough. Rates that are computed from it double.
# `read_messages(topics=[...])` without that topic gives each once.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple bagx==0.6.0 mcap==1.6.0 mcap-ros2-support==0.6.0

cat >program.py <<'PYTHON'
from collections import Counter
from importlib.metadata import version

from bagx.reader import BagReader
from mcap.writer import Writer

print("bagx", version("bagx"), "mcap-ros2-support", version("mcap-ros2-support"))


def text(content: bytes, unit: int) -> bytes:
    return b"\0\1\0\0" + (len(content) // unit).to_bytes(4, "little") + content


WIDE = (b"wstring data\n", text("Küche".encode("utf-16-le"), 2))
NARROW = (b"string data\n", text(b"kitchen\0", 1))
with open("bag.mcap", "wb") as file:
    writer = Writer(file)
    writer.start(profile="ros2")
    channels = {}
    for name, (definition, _) in (("narrow", NARROW), ("wide", WIDE)):
        schema = writer.register_schema(f"our_msgs/msg/{name.title()}", "ros2msg", definition)
        channels[name] = writer.register_channel(f"/{name}", "cdr", schema)
    for stamp in range(20):
        writer.add_message(channels["narrow"], stamp, NARROW[1], stamp)
    writer.add_message(channels["wide"], 15, WIDE[1], 15)
    writer.finish()

reader = BagReader("bag.mcap")
print("counted:", {name: topic.count for name, topic in reader.summary().topics.items()})
messages = [*reader.read_messages()]
print("yielded:", dict(Counter(each.topic for each in messages)))
print("with their text:", sum("data" in each.data for each in messages))
print("of the time 3:", [sorted(each.data) for each in messages if each.timestamp_ns == 3])
PYTHON

cat >expected <<'TEXT'
bagx 0.6.0 mcap-ros2-support 0.6.0
counted: {'/narrow': 20, '/wide': 1}
yielded: {'/narrow': 36, '/wide': 1}
with their text: 16
of the time 3: [['data'], ['_msg_type', '_raw_size']]
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
