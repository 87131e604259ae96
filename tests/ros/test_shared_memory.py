"""Ports of Fast DDS in shared memory, in whose place senders put another file."""

from __future__ import annotations

import subprocess
import sys

from tests.ros.domains import DOMAIN

_LOSES_A_PORT = """
import mmap, os, sys
from pathlib import Path
from rsb_bridge.ros.node import RosNode

node = RosNode(int(sys.argv[1]), "robot1")
node.start()
opened = [os.readlink(each) for each in Path("/proc/self/fd").iterdir() if each.is_symlink()]
port = Path(min(each for each in opened if each.endswith("_el") and "_port" in each).removesuffix("_el"))

looks = 0

def hear(event, arguments):
    global looks
    looks += event == "open" and arguments[0] == "/proc/self/maps"

sys.addaudithook(hear)

def tell():
    before, lost = looks, node.lost_ports()
    print(looks - before, *(each.path for each in lost), sep=",")

print(port)
tell()
tell()
content = port.read_bytes()
port.unlink()  # as a sender does that does not see its reader alive
tell()
port.write_bytes(content)
tell()
with port.open("r+b") as file, mmap.mmap(file.fileno(), 0):
    tell()
node.stop()
tell()
"""


def test_node_is_deaf_until_it_opens_port() -> None:
    command = (sys.executable, "-c", _LOSES_A_PORT, str(DOMAIN))
    said = subprocess.run(command, capture_output=True, text=True, timeout=150, check=True)
    port, *answers = said.stdout.splitlines()
    # A port that is at its place is not searched for again in all that is mapped.
    assert answers == ["1", "0", f"1,{port}", f"1,{port}", "1", "0"]
