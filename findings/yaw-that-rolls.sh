#!/usr/bin/env bash
# In one library the same roll, pitch and yaw are two rotations, and the way back gives a third.
#
# ahrs 0.4.0, from PyPI. Its `Quaternion` and `QuaternionArray` take `rpy` as roll, pitch, yaw. Its `DCM` says the same of its
# parameter, and takes yaw, pitch, roll: the note below its example says that the angles are reversed. `DCM.to_rpy()` gives
# roll, pitch, yaw of the inverse, so neither a DCM made of angles nor one made of a quaternion gives them back. A level
# robot that turns about z rolls. Make each DCM by `Quaternion(rpy=...).to_DCM()`, and ask a quaternion for the angles.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ahrs==0.4.0 numpy==2.4.6

cat >program.py <<'PYTHON'
from importlib.metadata import version

import numpy as np
from ahrs import DCM, Quaternion

print("ahrs", version("ahrs"))


def plain(values) -> list[float]:
    return (np.asarray(values, float).round(3) + 0.0).tolist()


AHEAD = np.array([1.0, 0.0, 0.0])
yaw = np.array([0.0, 0.0, np.pi / 2])
print("ahead, turned left, by Quaternion:", plain(Quaternion(rpy=yaw).rotate(AHEAD)))
print("ahead, turned left, by DCM:", plain(DCM(rpy=yaw) @ AHEAD))
angles = np.array([0.1, 0.2, 0.3])
quaternion = Quaternion(rpy=angles)
print("roll, pitch, yaw:", plain(angles))
print("of a Quaternion:", plain(quaternion.to_angles()))
print("of a DCM of them:", plain(DCM(rpy=angles).to_rpy()))
print("of a DCM of the Quaternion:", plain(DCM(q=np.asarray(quaternion)).to_rpy()))
print("the two as matrices are equal:", np.allclose(quaternion.to_DCM(), DCM(q=np.asarray(quaternion))))
PYTHON

cat >expected <<'TEXT'
ahrs 0.4.0
ahead, turned left, by Quaternion: [0.0, 1.0, 0.0]
ahead, turned left, by DCM: [1.0, 0.0, 0.0]
roll, pitch, yaw: [0.1, 0.2, 0.3]
of a Quaternion: [0.1, 0.2, 0.3]
of a DCM of them: [-0.286, -0.22, -0.038]
of a DCM of the Quaternion: [-0.038, -0.22, -0.286]
the two as matrices are equal: True
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
