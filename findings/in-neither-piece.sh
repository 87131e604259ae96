#!/usr/bin/env bash
# kappe cuts a recording in two, and a message is in neither piece.
#
# kappe 0.25.0, from PyPI; mcap 1.6.0 writes the file. It reads the span of all pieces by the time of recording, and gives
# each message to the piece that has its time of publication. A latched message was published before the recording began,
# so a map or a description of the robot is lost, and nothing is said. `--keep_tf_tree true` saves /tf_static alone. Cut
# by a first piece that begins before everything was published, or keep the original.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple kappe==0.25.0 mcap==1.6.0

cat >program.py <<'PYTHON'
import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer

print("kappe", version("kappe"), "mcap", version("mcap"))
S = 10**9
TEXT = b"\0\1\0\0\2\0\0\0a\0"
MESSAGES = (("/map_name", 100, 40), ("/chatter", 100, 100), ("/chatter", 105, 105), ("/chatter", 109, 109))
"""Of each its topic, its time of recording and its time of publication, in seconds."""
with open("bag.mcap", "wb") as file:
    writer = Writer(file)
    writer.start(profile="ros2")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    channels = {topic: writer.register_channel(topic, "cdr", schema) for topic, *_ in MESSAGES}
    for topic, recorded, published in MESSAGES:
        writer.add_message(channels[topic], recorded * S, TEXT, published * S)
    writer.finish()
pieces = [{"start": 100, "end": 105, "name": "one"}, {"start": 105.5, "end": 110, "name": "two"}]
Path("cut.yaml").write_text(json.dumps({"splits": pieces}))
command = (Path(sys.executable).with_name("kappe"), *"cut --config cut.yaml --output pieces bag.mcap".split())
subprocess.run(command, check=True, stderr=subprocess.DEVNULL)  # where its progress goes
for path in sorted(Path("pieces").iterdir()):
    with path.open("rb") as file:
        rows = [(channel.topic, message.log_time // S) for _, channel, message in make_reader(file).iter_messages()]
    print(path.name, rows)
PYTHON

cat >expected <<'TEXT'
kappe 0.25.0 mcap 1.6.0
one.mcap [('/chatter', 100), ('/chatter', 105)]
two.mcap [('/chatter', 109)]
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
