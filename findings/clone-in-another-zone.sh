#!/usr/bin/env bash
# A copy of a GPX track from America is hours away from the original.
#
# gpxpy 1.6.2, from PyPI. A time in GPX may have an offset (xsd:dateTime). The reader keeps it. `clone()`, and all that deep-copies,
# makes the zone anew from its name, which is "-5:00" for -05:00, and of that only the minutes are read. The copy says
# 12:00 UTC where the original says 12:00 in New York. Offsets to the east, and of ten hours and more, are copied well.
# Convert times by `astimezone(timezone.utc)` as soon as they are read.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple gpxpy==1.6.2

cat >program.py <<'PYTHON'
from importlib.metadata import version

import gpxpy

print("gpxpy", version("gpxpy"))
HEAD = '<gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1" creator="us"><trk><trkseg>'
TAIL = "</trkseg></trk></gpx>"
for offset in ("Z", "+02:00", "-05:00", "-03:30", "-10:00"):
    point = f'<trkpt lat="1" lon="2"><time>2026-11-29T12:00:00{offset}</time></trkpt>'
    track = gpxpy.parse(HEAD + point + TAIL)
    times = [each.tracks[0].segments[0].points[0].time for each in (track, track.clone())]
    print(*(time.isoformat() for time in times), "equal" if times[0] == times[1] else "not equal")
PYTHON

cat >expected <<'TEXT'
gpxpy 1.6.2
2026-11-29T12:00:00+00:00 2026-11-29T12:00:00+00:00 equal
2026-11-29T12:00:00+02:00 2026-11-29T12:00:00+02:00 equal
2026-11-29T12:00:00-05:00 2026-11-29T12:00:00+00:00 not equal
2026-11-29T12:00:00-03:30 2026-11-29T12:00:00-00:30 not equal
2026-11-29T12:00:00-10:00 2026-11-29T12:00:00-10:00 equal
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
