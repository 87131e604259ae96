#!/usr/bin/env bash
# Without a fix the robot is in the Gulf of Guinea.
#
# pynmea2 1.19.0, from PyPI; pynmeagps 1.1.8 to compare with. A receiver without a fix leaves the fields of the position empty.
# pynmea2 gives None for an empty altitude, speed or course, and 0.0 for an empty latitude and longitude. That is a valid
# place, so a filter, a map and a median take it. In a GNS sentence the altitude is a text, in GGA a number. Look at `lat`
# and `lon`, which are texts, and at `gps_qual` or `status`, before you take `latitude`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple pynmea2==1.19.0 pynmeagps==1.1.8

cat >program.py <<'PYTHON'
from functools import reduce
from importlib.metadata import version
from operator import xor

import pynmea2
from pynmeagps import NMEAReader

print("pynmea2", version("pynmea2"), "pynmeagps", version("pynmeagps"))
SENTENCES = (
    "GPGGA,120000.00,5230.0000,N,01330.0000,E,1,08,0.9,40.0,M,46.0,M,,",
    "GNGNS,120000.00,5230.0000,N,01330.0000,E,AN,08,0.9,40.0,46.0,,,V",
    "GPGGA,120000.00,,,,,0,00,99.9,,M,,M,,",
    "GPRMC,120000.00,V,,,,,,,291126,,,N",
    "GPGLL,,,,,120000.00,V,N",
)
for content in SENTENCES:
    sentence = f"${content}*{reduce(xor, content.encode()):02X}"
    ours, other = pynmea2.parse(sentence, check=True), NMEAReader.parse(sentence)
    rest = [getattr(ours, name) for name in ("altitude", "spd_over_grnd", "true_course") if hasattr(ours, name)]
    print(f"{content[2:5]}: pynmea2 {ours.latitude, ours.longitude}, others {rest}, pynmeagps {other.lat, other.lon}")
PYTHON

cat >expected <<'TEXT'
pynmea2 1.19.0 pynmeagps 1.1.8
GGA: pynmea2 (52.5, 13.5), others [40.0], pynmeagps (52.5, 13.5)
GNS: pynmea2 (52.5, 13.5), others ['40.0'], pynmeagps (52.5, 13.5)
GGA: pynmea2 (0.0, 0.0), others [None], pynmeagps ('', '')
RMC: pynmea2 (0.0, 0.0), others [None, None], pynmeagps ('', '')
GLL: pynmea2 (0.0, 0.0), others [], pynmeagps ('', '')
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
