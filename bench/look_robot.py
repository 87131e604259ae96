"""The robot of `bench.look`: publishes in one domain, listens in the other, and obeys lines on its standard input.

A line names what to publish, or ``none``. ``steady`` prints the figures of the steady topic since the last time.
"""

from __future__ import annotations

import array
import io
import json
import sys
import threading
import time
from typing import Any

import numpy as np
import rclpy
from bench.bed import FAR, NEAR
from bench.look import RATE, SIZE
from nav_msgs.msg import OccupancyGrid
from PIL import Image as Pillow
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import String

_PICTURE_RATE = 15.0
_POINTS = 100_000
_SIDE = 1000  # cells


class Robot:
    """Publishes and listens."""

    def __init__(self, near: Any, far: Any) -> None:
        self._messages = _messages()
        qos = qos_profile_sensor_data
        self._publishers = {
            name: near.create_publisher(type(each), f"/{name}", qos) for name, each in self._messages.items()
        }
        self._steady = near.create_publisher(String, "/steady", 10)
        self._sent = 0
        self._latencies: list[float] = []
        self._chosen = "none"
        near.create_timer(1 / RATE, self._tick)
        near.create_timer(1 / _PICTURE_RATE, self._picture)
        far.create_subscription(String, "/steady", self._heard, 10)

    def _tick(self) -> None:
        self._steady.publish(String(data=f"{time.time():.6f} ".ljust(SIZE, "x")))
        self._sent += 1

    def _picture(self) -> None:
        if self._chosen in self._publishers:
            self._publishers[self._chosen].publish(self._messages[self._chosen])

    def _heard(self, message: String) -> None:
        self._latencies.append(time.time() - float(message.data.partition(" ")[0]))

    def obey(self, line: str) -> None:
        """Publish something else, or print the figures of the steady topic."""
        if line != "steady":
            self._chosen = line
            return
        ordered = sorted(self._latencies) or [0.0]
        answer = {
            "received": len(self._latencies) / max(1, self._sent),
            "p50": ordered[len(ordered) // 2] * 1e3,
            "p99": ordered[min(len(ordered) - 1, len(ordered) * 99 // 100)] * 1e3,
        }
        self._sent = 0
        self._latencies.clear()
        print(json.dumps(answer), flush=True)


def _messages() -> dict[str, Any]:
    rng = np.random.default_rng(1)

    def photo(width: int, height: int) -> Any:
        base = np.fromfunction(lambda y, x: (np.sin(x / 50) + np.cos(y / 70)) * 60 + 120, (height, width))
        pixels = np.stack([base, base * 0.8, 255 - base], 2) + rng.integers(0, 8, (height, width, 3))
        return pixels.clip(0, 255).astype(np.uint8)

    def raw(width: int, height: int) -> Image:
        data = array.array("B", photo(width, height).tobytes())
        return Image(width=width, height=height, encoding="rgb8", step=3 * width, data=data)

    file = io.BytesIO()
    Pillow.fromarray(photo(1920, 1080)).save(file, "jpeg")
    points = rng.normal(0, 5, (_POINTS, 4)).astype("<f4")
    names = ("x", "y", "z", "intensity")
    cloud = PointCloud2(width=_POINTS, height=1, point_step=16, row_step=16 * _POINTS)
    cloud.fields = [PointField(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate(names)]
    cloud.data = array.array("B", points.tobytes())
    grid = OccupancyGrid(data=rng.integers(0, 101, _SIDE * _SIDE).astype(np.int8))
    grid.info.width = grid.info.height = _SIDE
    grid.info.resolution = 0.05
    return {
        "camera": raw(640, 480),
        "large": raw(1920, 1080),
        "jpeg": CompressedImage(format="jpeg", data=array.array("B", file.getvalue())),
        "cloud": cloud,
        "map": grid,
    }


def main() -> None:
    """Publish until the standard input ends."""
    contexts = [rclpy.Context(), rclpy.Context()]
    for context, domain in zip(contexts, (NEAR, FAR), strict=True):
        rclpy.init(context=context, domain_id=domain)
    near, far = (rclpy.create_node(f"look{at}", context=each) for at, each in enumerate(contexts))
    robot = Robot(near, far)

    def spin(node: Any, context: Any) -> None:
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        executor.spin()

    for node, context in zip((near, far), contexts, strict=True):
        threading.Thread(target=spin, args=(node, context), daemon=True).start()
    for line in sys.stdin:
        robot.obey(line.strip())


if __name__ == "__main__":
    main()
