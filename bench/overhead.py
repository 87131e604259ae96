"""Prints the bytes that the radio carries for a message, next to the thesis's Fernet and pickle.

``python -m bench.overhead`` computes the sizes in docs/bluetooth.md, without a radio.
"""

from __future__ import annotations

import pickle
import random
import sys
from array import array
from typing import Any

import zstandard
from cryptography.fernet import Fernet
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import LaserScan
from tests.support.frames import write_chunks

from rsb_bridge.wire.framing import ZSTD, DataWriter
from rsb_bridge.wire.sealing import CipherSuite, Sealer

_SEPARATOR = b"_split_"
_CHUNK = 1400
"""Bytes of a message in one turn on a slow link."""
_MAP_SIDE = 384


def _scan(noise: random.Random) -> LaserScan:
    scan = LaserScan(angle_min=-3.14, angle_max=3.14, angle_increment=0.0175, range_max=12.0)
    scan.ranges = [3 + noise.gauss(0, 0.01) for _ in range(360)]
    scan.intensities = [float(noise.randrange(200, 256)) for _ in range(360)]
    return scan


def _odometry(noise: random.Random) -> Odometry:
    odometry = Odometry(child_frame_id="base_link")
    odometry.pose.pose.position.x, odometry.pose.pose.position.y = noise.random(), noise.random()
    odometry.pose.pose.orientation.z, odometry.pose.pose.orientation.w = noise.random(), noise.random()
    odometry.twist.twist.linear.x = noise.random()
    return odometry


def _map(noise: random.Random) -> OccupancyGrid:
    grid = OccupancyGrid()
    grid.info.width = grid.info.height = _MAP_SIDE
    grid.data = array("b", (noise.choices((0, 100, -1), (90, 3, 7))[0] for _ in range(_MAP_SIDE**2)))
    return grid


def _goal(noise: random.Random) -> PoseStamped:
    goal = PoseStamped()
    goal.header.frame_id = "map"
    goal.pose.position.x, goal.pose.orientation.w = noise.random(), noise.random()
    return goal


def main() -> None:
    """Print a line for each message."""
    for make in (_scan, _odometry, _map, _goal):
        message: Any = make(random.Random(1))
        payload = serialize_message(message)
        thesis = len(Fernet(Fernet.generate_key()).encrypt(pickle.dumps(message))) + len(_SEPARATOR)
        smaller = zstandard.ZstdCompressor(3).compress(payload)
        plain, packed = _on_the_wire(payload, 0), _on_the_wire(smaller, ZSTD)
        ours, size = min(plain, packed), len(payload)
        sys.stdout.write(
            f"{type(message).__name__}, {size:,} B: on the wire {ours / size:.2f} of it"
            f" (uncompressed {plain / size:.2f}), the thesis's {thesis / size:.2f}: {thesis / ours:.1f} times as much\n"
        )


def _on_the_wire(content: bytes, flags: int) -> int:
    return sum(map(len, write_chunks(DataWriter(Sealer(CipherSuite.AESGCM, bytes(32)), 1), content, 0, flags, _CHUNK)))


if __name__ == "__main__":
    main()
