#!/usr/bin/env bash
# A node that comes later hears only the last of roswell's static transforms.
#
# roswell 0.1.0, from PyPI. Its `broadcast(static=True)` publishes each frame as a message of its own, and keeps the last one
# for nodes that come later (all, if they were published at once). The robot itself knows its three static frames, a node
# that is started afterwards knows one, and has no path to the others. tf2 publishes all of its static frames in each
# message: do so by a publisher of your own on /tf_static. roswell multicasts on all networks, so this runs in a network of
# its own, which takes Linux with iproute2, and root or user namespaces.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple roswell==0.1.0

cat >program.py <<'PYTHON'
import time
from importlib.metadata import version

import roswell

print("roswell", version("roswell"))
FRAMES = ("laser", "camera", "imu")
HERE = roswell.Transform((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def known(buffer: roswell.TfBuffer) -> list[str]:
    return [frame for frame in FRAMES if buffer.can_transform("base", frame)]


def wait(condition) -> None:
    deadline = time.monotonic() + 60
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.05)


with roswell.Node("robot", domain=84) as robot:
    own = robot.tf_buffer()
    for count, frame in enumerate(FRAMES, 1):
        own.broadcast("base", frame, HERE, static=True)
        wait(lambda: len(known(own)) >= count)
        time.sleep(2)
    print("known to the one that publishes:", *known(own))
    with roswell.Node("late", domain=84) as late:
        later = late.tf_buffer()
        wait(lambda: known(later))
        time.sleep(5)
        print("known to one that comes later:", *known(later))
PYTHON

cat >expected <<'TEXT'
roswell 0.1.0
known to the one that publishes: laser camera imu
known to one that comes later: imu
TEXT
cat >network.sh <<'SHELL'
ip link add inside type veth peer name outside
ip address add 10.0.0.1/24 dev inside
for each in lo inside outside; do ip link set "$each" up; done
ip route add 224.0.0.0/4 dev inside
exec "$@"
SHELL
unshare --map-root-user --net bash -e network.sh venv/bin/python program.py | diff expected - &&
    echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
