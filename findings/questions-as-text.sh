#!/usr/bin/env bash
# pyte shows what programs ask a terminal as text, or as bold and underlined.
#
# pyte 0.8.2, from PyPI. Console programs ask at their start who the terminal is and what it can do. Terminals answer, and
# show nothing. pyte knows no strings but OSC, so DCS (XTGETTCAP, DECRQSS, sixel) and APC (kitty's graphics) stand on the screen. It
# takes the private XTMODKEYS for SGR, an underline's colour for attributes, and kitty's pop of key modes for a letter. A
# test that looks at a screen by pyte sees faults that are not the program's.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple pyte==0.8.2

cat >program.py <<'PYTHON'
from importlib.metadata import version

import pyte

print("pyte", version("pyte"))
SEQUENCES = {
    "OSC 11, the background": "\x1b]11;?\x1b\\",
    "XTVERSION, the name": "\x1b[>0q",
    "XTGETTCAP, a capability": "\x1bP+q544e\x1b\\",
    "DECRQSS, the attributes": "\x1bP$qm\x1b\\",
    "kitty's graphics": "\x1b_Gi=1,a=q;AAAA\x1b\\",
    "sixel": "\x1bPq#0~\x1b\\",
    "XTMODKEYS, keys as before": "\x1b[>4;1m",
    "red underline": "\x1b[58;2;1;2;3m",
    "kitty's keys as before": "\x1b[<u",
    "colour with colons": "\x1b[38:2::1:2:3m",
}
for name, sequence in SEQUENCES.items():
    screen = pyte.Screen(30, 1)
    pyte.Stream(screen).feed(f"text{sequence}.")
    cell = screen.buffer[0][screen.cursor.x - 1]
    looks = [look for look in ("bold", "italics", "underscore") if getattr(cell, look)]
    print(f"{name}: {screen.display[0].rstrip()}", *looks)
PYTHON

cat >expected <<'TEXT'
pyte 0.8.2
OSC 11, the background: text.
XTVERSION, the name: text.
XTGETTCAP, a capability: text+q544e.
DECRQSS, the attributes: text$qm.
kitty's graphics: textGi=1,a=q;AAAA.
sixel: textq#0~.
XTMODKEYS, keys as before: text. bold underscore
red underline: text. bold italics
kitty's keys as before: textu.
colour with colons: text2::1:2:3m.
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
