"""`rsb-console doctor` on a host with a neighbour: nothing of it reaches the cable."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from rsb_bridge.installed_features import feature_names

if TYPE_CHECKING:
    from tests.network.hosts import Host

_LISTEN = """
import socket
wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x0800))
wire.bind(("eth0", 0))
print("listens", flush=True)
while True:
    print(wire.recv(2000).hex(), flush=True)
"""
_JOIN = """
import socket, sys
member = socket.socket(type=socket.SOCK_DGRAM)
group = socket.inet_aton(sys.argv[1]) + socket.inet_aton("10.99.1.2")
member.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
sys.stdin.read()
"""
_MARK = "239.77.77.77"
"""A group that only this test joins. Its report takes all reports with it that wait on the device."""
_ONE_GROUP = 54
"""Bytes of a frame that reports one group."""


@pytest.mark.skipif("doctor" not in feature_names(), reason="the core alone")
@pytest.mark.usefixtures("cable")
def test_nothing_leaves_the_machine(robot: Host, pc: Host) -> None:
    listening = pc.start(sys.executable, "-c", _LISTEN, stdout=subprocess.PIPE)
    assert listening.stdout is not None
    assert listening.stdout.readline() == "listens\n"
    ran = robot.start(sys.executable, "-m", "rsb_console", "doctor", "--json", stdout=subprocess.PIPE)
    findings = json.loads(ran.communicate(timeout=60)[0])["findings"]
    (multicast,) = (each for each in findings if each["code"] == "multicast")
    assert multicast["facts"] == {"eth0": True}, "it was tried on the cable"
    joined = robot.start(sys.executable, "-c", _JOIN, _MARK, stdin=subprocess.PIPE)
    frames = [bytes.fromhex(listening.stdout.readline())]
    while socket.inet_aton(_MARK) not in frames[-1]:
        frames.append(bytes.fromhex(listening.stdout.readline()))
    joined.communicate()
    listening.kill()
    listening.communicate()
    assert [frame.hex() for frame in frames[:-1]] == []
    assert len(frames[-1]) == _ONE_GROUP
