#!/usr/bin/env bash
# Points of an opaque colour are black, or left out as broken.
#
# pointcloudkit 0.1.0 and pointcloud2 0.6.0, from PyPI; pypcd4 1.5.1 to compare with. PCL packs a colour into the four bytes
# of a float. Its alpha is 255 there, so the float is NaN from red 128 on (infinite, if green and blue are 0). pointcloudkit makes 0 of NaN before
# it takes the float apart. `read_points(cloud, skip_nans=True)` leaves out points with NaN in any field, not in x, y and
# z alone. Ask it for `field_names=["x", "y", "z"]`, or keep the colour as an integer (type U).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple pointcloudkit==0.1.0 pointcloud2==0.6.0 pypcd4==1.5.1

cat >program.py <<'PYTHON'
import struct
from importlib.metadata import version
from pathlib import Path

import pointcloudkit
import pypcd4
from pointcloud2 import PointCloud2, PointField, read_points

print(*(f"{name} {version(name)}" for name in ("pointcloudkit", "pointcloud2", "pypcd4")))
HEADER = """VERSION 0.7
FIELDS x y z rgb
SIZE 4 4 4 4
TYPE F F F {kind}
COUNT 1 1 1 1
WIDTH 1
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 1
DATA binary
"""
KINDS = {"F": PointField.FLOAT32, "U": PointField.UINT32}
NAMES = ("x", "y", "z", "rgb")


def points_of(kind: str, data: bytes) -> int:
    fields = [PointField(name, 4 * place, KINDS["F"]) for place, name in enumerate(NAMES)]
    fields[3].datatype = KINDS[kind]
    cloud = PointCloud2(None, 1, 1, fields, False, 16, 16, data, False)
    return len(read_points(cloud, skip_nans=True))


for colour in (0x00FF8040, 0xFFFF8040, 0xFF408040):
    for kind in KINDS:
        data = struct.pack("<fffI", 1, 2, 3, colour)
        Path("point.pcd").write_bytes(HEADER.format(kind=kind).encode() + data)
        cloud = pypcd4.PointCloud.from_path("point.pcd")
        right = cloud.decode_rgb(cloud.pc_data["rgb"])[0].tolist()
        kit = pointcloudkit.PointCloud.read("point.pcd").rgb[0].tolist()
        kept = points_of(kind, data)
        print(f"0x{colour:08x} as {kind}: pypcd4 {right}, pointcloudkit {kit}, pointcloud2 {kept} of 1")
PYTHON

cat >expected <<'TEXT'
pointcloudkit 0.1.0 pointcloud2 0.6.0 pypcd4 1.5.1
0x00ff8040 as F: pypcd4 [255, 128, 64], pointcloudkit [255, 128, 64], pointcloud2 1 of 1
0x00ff8040 as U: pypcd4 [255, 128, 64], pointcloudkit [255, 128, 64], pointcloud2 1 of 1
0xffff8040 as F: pypcd4 [255, 128, 64], pointcloudkit [0, 0, 0], pointcloud2 0 of 1
0xffff8040 as U: pypcd4 [255, 128, 64], pointcloudkit [255, 128, 64], pointcloud2 1 of 1
0xff408040 as F: pypcd4 [64, 128, 64], pointcloudkit [64, 128, 64], pointcloud2 1 of 1
0xff408040 as U: pypcd4 [64, 128, 64], pointcloudkit [64, 128, 64], pointcloud2 1 of 1
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
