"""The robot of `look_cost`: publishes in one domain, listens in the other, and obeys lines on its standard input.

``publish steady camera`` publishes these topics, and no others. ``photograph FILE`` is the camera's image from now on.
``figures`` prints the figures of the steady topic since the last time. With an argument it is another node on the
robot's computer: ``subscribe`` takes the camera's images and drops them, ``listen`` takes the steady topic and prints
its figures.
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
from nav_msgs.msg import OccupancyGrid
from PIL import Image as Pillow
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import String

from rsb_extras.pictures.tests.look_cost import RATE, SIZE

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
        self._chosen = ["steady"]
        self.listener = Listener(far)
        near.create_timer(1 / RATE, self._tick)
        near.create_timer(1 / _PICTURE_RATE, self._picture)

    def _tick(self) -> None:
        if "steady" not in self._chosen:
            return
        self._steady.publish(String(data=f"{time.time():.6f} ".ljust(SIZE, "x")))
        self._sent += 1

    def _picture(self) -> None:
        for name in self._chosen:
            if name in self._publishers:
                self._publishers[name].publish(self._messages[name])

    def obey(self, line: str) -> None:
        """Publish something else, or print the figures of the steady topic."""
        if line.startswith("publish"):
            self._chosen = line.split()[1:]
            return
        if line.startswith("photograph"):
            self._messages["camera"] = _photograph(line.partition(" ")[2])
            return
        self.listener.report(self._sent)
        self._sent = 0


class Listener:
    """Hears the steady topic."""

    def __init__(self, node: Any) -> None:
        self._latencies: list[float] = []
        node.create_subscription(String, "/steady", self._heard, 10)

    def _heard(self, message: String) -> None:
        self._latencies.append(time.time() - float(message.data.partition(" ")[0]))

    def report(self, sent: int = 0) -> None:
        """Print the figures since the last time."""
        ordered = sorted(self._latencies) or [0.0]
        answer = {
            "received": len(self._latencies) / max(1, sent),
            "p50": ordered[len(ordered) // 2] * 1e3,
            "p99": ordered[min(len(ordered) - 1, len(ordered) * 99 // 100)] * 1e3,
        }
        self._latencies.clear()
        print(json.dumps(answer), flush=True)


def _photograph(file: str) -> Image:
    image = Pillow.open(file).convert("RGB")
    data = array.array("B", image.tobytes())
    return Image(width=image.width, height=image.height, encoding="rgb8", step=3 * image.width, data=data)


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
    """Publish and listen until the standard input ends."""
    match sys.argv[1:]:
        case ["subscribe"]:
            near = _node("subscriber", NEAR)
            near.create_subscription(Image, "/camera", lambda _: None, qos_profile_sensor_data, raw=True)
            print("there", flush=True)
            sys.stdin.read()
        case ["listen"]:
            listener = Listener(_node("listener", NEAR))
            for _ in sys.stdin:
                listener.report()
        case _:
            robot = Robot(_node("robot", NEAR), _node("far", FAR))
            for line in sys.stdin:
                robot.obey(line.strip())


def _node(name: str, domain: int) -> Any:
    """Return a node in a domain, whose callbacks run on a thread of its own."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node(f"look_{name}", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    return node


if __name__ == "__main__":
    main()
