#!/usr/bin/env bash
# Trimming a recording of asciinema 3 moves what happens to before the recording.
#
# ttylog 0.1.0, from PyPI; showreel 0.3.1 to compare with. In version 3 of the format, which asciinema 3 writes, each event has
# the time since the event before it, in version 2 the time since the start. Both are .cast, and ttylog looks at no version:
# its `info` takes the last pause for the length. `trim` writes pauses below zero after each that it has cut, and says how
# much was saved. `showreel convert --to v2` first, or record by ttylog, which writes version 2.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ttylog==0.1.0 showreel==0.3.1

cat >program.py <<'PYTHON'
import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

print(*(f"{name} {version(name)}" for name in ("ttylog", "showreel")))
PAUSES = (0.5, 60, 0.5, 0.5)
TIMES = [round(sum(PAUSES[: count + 1]), 1) for count, _ in enumerate(PAUSES)]
HEADS = {2: {"version": 2, "width": 80, "height": 24}, 3: {"version": 3, "term": {"cols": 80, "rows": 24}}}


def run(tool: str, *arguments: str) -> str:
    command = [str(Path(sys.executable).with_name(tool)), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


for number, stamps in {2: TIMES, 3: PAUSES}.items():
    events = [[stamp, "o", f"line {place}\r\n"] for place, stamp in enumerate(stamps)]
    Path("show.cast").write_text("\n".join(map(json.dumps, [HEADS[number], *events])) + "\n")
    length = re.search(r"Duration.+?([\d.]+) *s", run("ttylog", "info", "show.cast"))[1]
    right = json.loads(run("showreel", "info", "show.cast"))["duration_seconds"]
    run("ttylog", "trim", "show.cast", "short.cast", "--max-gap", "2")
    trimmed = [json.loads(line)[0] for line in Path("short.cast").read_text().splitlines()[1:]]
    print(f"version {number}: ttylog {length} s, showreel {right} s, trimmed to gaps of 2 s:", *trimmed)
PYTHON

cat >expected <<'TEXT'
ttylog 0.1.0 showreel 0.3.1
version 2: ttylog 61.5 s, showreel 61.5 s, trimmed to gaps of 2 s: 0.5 2.5 3.0 3.5
version 3: ttylog 0.5 s, showreel 61.5 s, trimmed to gaps of 2 s: 0.5 2.5 -57.0 -57.0
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
