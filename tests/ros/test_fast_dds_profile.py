"""The profile for large messages that comes with the program."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tests.support.captured import captured, own_lines

from rsb_bridge.ros import memory

_CONFIGS = Path(__file__).parents[2] / "configs"
_VARIABLE = memory.profile_variable(os.environ)
_PROFILE = _CONFIGS / memory.LARGE_MESSAGES[_VARIABLE]
_HISTORIES = memory.HISTORIES[_VARIABLE]
_SEGMENT = 32 * 1024 * 1024
_NODE = """
import sys, rclpy
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("large")
for line in open("/proc/self/maps"):
    if "/dev/shm/fast" in line and "port" not in line:
        begin, end = (int(each, 16) for each in line.split()[0].split("-"))
        print("segment", end - begin)
node.destroy_node()
rclpy.shutdown()
"""

_READER = """
import sys, time, rclpy
from std_msgs.msg import String
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("reader")
subscription = node.create_subscription(String, "/asked", lambda _: None, 10)
print("ready", flush=True)
sys.stdin.read()
"""
_WRITER = """
import sys, time, rclpy
from rclpy.duration import Duration
from std_msgs.msg import String
rclpy.init(domain_id=int(sys.argv[1]))
node = rclpy.create_node("writer")
publisher = node.create_publisher(String, "/asked", 10)
while not publisher.get_subscription_count():
    time.sleep(0.01)
for number in range(4):
    began = time.monotonic()
    publisher.publish(String(data="message"))
    publisher.wait_for_all_acked(Duration(seconds=10))
    print("took", time.monotonic() - began)
"""


@pytest.mark.parametrize("variable", memory.PROFILE_VARIABLES)
def test_its_histories_are_the_bridges_own(variable: str) -> None:
    """A user's profile for large messages replaces the one that the bridge brings."""

    def histories(path: Path) -> dict[str, str]:
        return {
            each.attrib["profile_name"]: ElementTree.canonicalize(ElementTree.tostring(each), strip_text=True)
            for each in ElementTree.parse(path).getroot()
            if each.tag.endswith(("data_writer", "data_reader"))
        }

    assert len(histories(memory.HISTORIES[variable])) == 2
    assert histories(_CONFIGS / memory.LARGE_MESSAGES[variable]) == histories(memory.HISTORIES[variable])


def test_fast_dds_takes_the_profile(spare_domains: int) -> None:
    environ = os.environ | {_VARIABLE: str(_PROFILE)}
    command = [sys.executable, "-c", _NODE, str(spare_domains)]
    ran = captured(*command, env=environ, check=True)
    assert not [line for line in own_lines(ran.stderr) if "Error" in line]
    segments = [int(line.split()[1]) for line in ran.stdout.splitlines() if line.startswith("segment ")]
    assert 0.9 * _SEGMENT < max(segments) < 1.1 * _SEGMENT


def test_subscriptions_are_asked_soon(spare_domains: int) -> None:
    """By Fast DDS's default, each 3 s what they lack."""
    environ = os.environ | {_VARIABLE: str(_HISTORIES), "RMW_FASTRTPS_USE_QOS_FROM_XML": "1"}
    command = [sys.executable, "-c", _READER, str(spare_domains)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as reader:
        assert reader.stdin is not None
        assert reader.stdout is not None
        assert reader.stdout.readline() == b"ready\n"
        ran = captured(sys.executable, "-c", _WRITER, str(spare_domains), env=environ, check=True)
        reader.stdin.close()
    # The first one may wait for discovery.
    took = [float(line.split()[1]) for line in ran.stdout.splitlines() if line.startswith("took ")]
    assert min(took[1:]) < 1.5
