"""The profile for large messages that comes with the program."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from xml.etree import ElementTree

from tests.support.captured import captured, own_lines

from rsb_bridge.ros import memory

_PROFILE = Path(__file__).parents[2] / "configs" / "fastdds-large-messages.xml"
_HISTORIES = Path(memory.__file__).with_name("fast_dds_histories.xml")
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


def test_its_histories_are_the_bridges_own() -> None:
    """A user's profile for large messages replaces the one that the bridge brings."""

    def histories(path: Path) -> dict[str, str]:
        return {
            each.attrib["profile_name"]: ElementTree.canonicalize(ElementTree.tostring(each), strip_text=True)
            for each in ElementTree.parse(path).getroot()
            if each.tag.endswith(("data_writer", "data_reader"))
        }

    assert len(histories(_HISTORIES)) == 2
    assert histories(_PROFILE) == histories(_HISTORIES)


def test_fast_dds_takes_the_profile(spare_domains: int) -> None:
    environ = os.environ | {memory.profile_variable(os.environ): str(_PROFILE)}
    command = [sys.executable, "-c", _NODE, str(spare_domains)]
    ran = captured(*command, env=environ, check=True)
    assert not [line for line in own_lines(ran.stderr) if "Error" in line]
    segments = [int(line.split()[1]) for line in ran.stdout.splitlines() if line.startswith("segment ")]
    assert 0.9 * _SEGMENT < max(segments) < 1.1 * _SEGMENT
