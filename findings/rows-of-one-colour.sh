#!/usr/bin/env bash
# A picture's rows of one colour are not drawn.
#
# sixel 0.2.0 (python-sixel), from PyPI. Its default, the fast converter, writes a run when the colour changes, and the last run
# of a row only after another one. A row of one colour has no change, so the sky, a bar or a plot's frame stays as the
# terminal was. The first run of each other row is a pixel too wide, and a last pixel of its own colour is lost. The
# other converter (`fast=False`, `sixelconv --size`) draws all rows, a pixel too far right, without the last column.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple sixel==0.2.0 pillow==12.0.0

cat >program.py <<'PYTHON'
import io
import re
from importlib.metadata import version

from PIL import Image
from sixel.converter import SixelConverter

print("sixel", version("sixel"))
RED, BLUE = (255, 0, 0), (0, 0, 255)
TOKEN = re.compile(r'"[\d;]*|#(\d+)(?:;2;(\d+);\d+;(\d+))?|(?:!(\d+))?([?-~])|([$-])')


def drawn(sixels: str) -> list[str]:
    """The first six rows, with r for red, b for blue and a dot where nothing is drawn."""
    body = re.search(r"q(.*?)\x1b", sixels, re.DOTALL)[1]
    rows, colours, colour, column = [["."] * 10 for _ in range(6)], {}, ".", 0
    for register, red, blue, count, sixel, end in (match.groups() for match in TOKEN.finditer(body)):
        if red is not None:
            colours[register] = "r" if int(red) > int(blue) else "b"
        if register is not None:
            colour = colours[register]
        if end == "-":
            break
        if end:
            column = 0
        for _ in range(int(count or 1) if sixel else 0):
            for row in range(6):
                if ord(sixel) - 63 >> row & 1:
                    rows[row][column] = colour
            column += 1
    return ["".join(row) for row in rows]


picture = Image.new("RGB", (8, 6), RED)
picture.paste(BLUE, (4, 2, 8, 5))
picture.putpixel((7, 1), BLUE)
file = io.BytesIO()
picture.save(file, "PNG")
for mode in (True, False):
    file.seek(0)
    out = io.StringIO()
    SixelConverter(file, fast=mode, ncolor=2).write(out)
    print("fast:" if mode else "small:", *drawn(out.getvalue()))
PYTHON

cat >expected <<'TEXT'
sixel 0.2.0
fast: .......... rrrrrrrr.. rrrrrbbbb. rrrrrbbbb. rrrrrbbbb. ..........
small: .rrrrrrr.. .rrrrrrr.. .rrrrbbb.. .rrrrbbb.. .rrrrbbb.. .rrrrrrr..
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
