"""Messages that this program serializes have zeros for padding and nothing behind, and otherwise equal rclpy's."""

from __future__ import annotations

import ctypes
import gc
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest
from rclpy.serialization import serialize_message as by_rclpy
from rosbags.typesys import Stores, get_typestore
from tests.cdr.decoder_helpers import TYPES
from tests.support.captured import captured
from tests.support.filled import filled
from tests.support.resources import resources

from rsb_bridge.ros.native.librcl import serialize_message
from rsb_bridge.ros.native.typesupport import installed_class
from rsb_bridge.ros.written_messages import serialize

ROOT = Path(__file__).parents[2]
PARTS = [
    "std_srvs/srv/SetBool_Response", "nav_msgs/srv/GetPlan_Request", "nav_msgs/srv/LoadMap_Response",
    "rcl_interfaces/srv/SetParameters_Request", "rcl_interfaces/srv/DescribeParameters_Response",
    "lifecycle_msgs/srv/GetAvailableTransitions_Response", "action_msgs/srv/CancelGoal_Request",
]  # fmt: skip
M_PERTURB = -6
"""Of glibc's mallopt: what is allocated is filled with the complement of this byte."""
FILLS = (0xA5, 0x5A)


def serialized(fill: int) -> list[list[str]]:
    """Every installed type, default and filled, by rclpy and by us, in memory that was filled before."""
    ctypes.CDLL(None).mallopt(M_PERTURB, fill)
    found = []
    for name in (*TYPES, *PARTS):
        message_class: Any = installed_class(name)
        messages = message_class(), filled(message_class)
        found += [[by_rclpy(each).hex(), serialize_message(each).hex()] for each in messages]
        assert serialize(name, {}, 0).hex() == found[-2][1]  # by hand
    return found


def test_padding_of_every_installed_type_is_zero() -> None:
    """In a process whose memory shows where nothing was written: without caches, which are not filled."""
    found = captured(
        sys.executable,
        "-m",
        "tests.ros.test_serialization",
        env=os.environ | {"GLIBC_TUNABLES": "glibc.malloc.tcache_count=0"},
        cwd=ROOT,
        timeout=300,
    )
    assert not found.returncode, found.stderr
    one, other = json.loads(found.stdout)
    assert len(one) == 2 * len((*TYPES, *PARTS))
    padded = longer = 0
    for (theirs, ours), (theirs_again, ours_again) in zip(one, other, strict=True):
        assert ours == ours_again
        same = zip(*map(bytes.fromhex, (theirs, theirs_again)), strict=True)
        unwritten = [first != second for first, second in same]
        padded += any(unwritten)
        end = len(unwritten) - [*reversed(unwritten)].index(False)
        longer += end + 3 < len(unwritten)
        expected = (0 if left else byte for byte, left in zip(bytes.fromhex(theirs), unwritten, strict=True))
        assert bytes(expected)[: end + -end % 4].hex() == ours
    assert padded > 100  # or the memory shows nothing
    assert longer  # of rmw_fastrtps_cpp, which counts too much


def test_strict_reader_takes_a_message_with_an_empty_sequence_of_numbers() -> None:
    """rosbags refuses more than three bytes behind a message: findings/serialized-tail.sh."""
    types = get_typestore(Stores.ROS2_JAZZY)
    message = types.deserialize_cdr(
        serialize("sensor_msgs/msg/JointState", {"name": ["wheel"]}, 0), "sensor_msgs/msg/JointState"
    )
    assert message.name == ["wheel"]  # type: ignore[attr-defined]


def test_unfitting_value_is_refused_as_by_rclpy() -> None:
    message_class: Any = installed_class("std_msgs/msg/String")
    message = message_class()
    message.data = "half a surrogate pair: \ud800"
    for way in (by_rclpy, serialize_message):
        with pytest.raises(UnicodeEncodeError):
            way(message)


def test_nothing_is_kept_of_a_message() -> None:
    message_class: Any = installed_class("nav_msgs/msg/OccupancyGrid")
    grid = message_class(data=[1] * 1_000_000)
    size = len(serialize_message(grid))
    gc.collect()
    before = resources().resident
    for _ in range(20):
        serialize_message(grid)
    assert resources().resident - before < 10 * size


if __name__ == "__main__":
    sys.stdout.write(json.dumps([serialized(fill) for fill in FILLS]))
