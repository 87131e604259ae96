#!/usr/bin/env bash
# A gripper's second finger stays behind, and a joint without an axis turns about z.
#
# kinpy 0.6.1, ikpy 4.2.1 and pytransform3d 3.17.0, from PyPI; yourdfpy 0.0.60 to compare with. In URDF a
# joint with `mimic` follows another, and the axis of a joint that names none is x. The first three take a joint that
# mimics for one of its own, which stays at 0 until it is set; kinpy turns about z. None says anything. Set such joints
# yourself, to multiplier * position + offset, and write each axis down.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple kinpy==0.6.1 ikpy==4.2.1 pytransform3d==3.17.0 \
    yourdfpy==0.0.60

cat >program.py <<'PYTHON'
import io
from importlib.metadata import version
from pathlib import Path

import ikpy.chain
import kinpy
import numpy as np
import yourdfpy
from pytransform3d.urdf import UrdfTransformManager

LIMIT = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
ROBOT = """<robot name="{name}"><link name="base"/><link name="arm"/><link name="tip"/>
<joint name="first" type="revolute"><parent link="base"/><child link="arm"/>{limit}{first}</joint>
<joint name="second" type="{kind}"><parent link="arm"/><child link="tip"/><origin xyz="0 1 0"/>{limit}{second}</joint>
</robot>"""
AXIS = '<axis xyz="0 0 1"/>'
FOLLOWS = AXIS + '<mimic joint="first" multiplier="-1" offset="0"/>'
ROBOTS = {
    "a follower": ROBOT.format(name="follower", kind="revolute", first=AXIS, second=FOLLOWS, limit=LIMIT),
    "no axis": ROBOT.format(name="plain", kind="fixed", first="", second="", limit=LIMIT),
}
TURN = {"first": np.pi / 2}


def by_ikpy(text: str) -> np.ndarray:
    Path("robot.urdf").write_text(text)
    chain = ikpy.chain.Chain.from_urdf_file("robot.urdf", base_elements=["base"])
    return chain.forward_kinematics([TURN.get(link.name, 0) for link in chain.links])


def by_pytransform3d(text: str) -> np.ndarray:
    manager = UrdfTransformManager()
    manager.load_urdf(text)
    manager.set_joint("first", TURN["first"])
    return manager.get_transform("tip", "base")


def by_yourdfpy(text: str) -> np.ndarray:
    robot = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False)
    robot.update_cfg(TURN)
    return robot.get_transform("tip", "base")


def by_kinpy(text: str) -> np.ndarray:
    return kinpy.build_chain_from_urdf(text).forward_kinematics(TURN)["tip"].matrix()


for case, text in ROBOTS.items():
    for reader in (by_yourdfpy, by_kinpy, by_ikpy, by_pytransform3d):
        name = reader.__name__.removeprefix("by_")
        rows = reader(text)[:3, [3, 0]].round(3) + 0.0
        print(f"{case}, {name} {version(name)}: tip at", *rows[:, 0], "its x towards", *rows[:, 1])
PYTHON

cat >expected <<'TEXT'
a follower, yourdfpy 0.0.60: tip at -1.0 0.0 0.0 its x towards 1.0 0.0 0.0
a follower, kinpy 0.6.1: tip at -1.0 0.0 0.0 its x towards 0.0 1.0 0.0
a follower, ikpy 4.2.1: tip at -1.0 0.0 0.0 its x towards 0.0 1.0 0.0
a follower, pytransform3d 3.17.0: tip at -1.0 0.0 0.0 its x towards 0.0 1.0 0.0
no axis, yourdfpy 0.0.60: tip at 0.0 0.0 1.0 its x towards 1.0 0.0 0.0
no axis, kinpy 0.6.1: tip at -1.0 0.0 0.0 its x towards 0.0 1.0 0.0
no axis, ikpy 4.2.1: tip at 0.0 0.0 1.0 its x towards 1.0 0.0 0.0
no axis, pytransform3d 3.17.0: tip at 0.0 0.0 1.0 its x towards 1.0 0.0 0.0
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
