"""Prints the cost of a map: ``python -m rsb_extras.pictures.tests.map_cost``, 20 s.

A grid of 1000×1000 cells and a costmap of as many, a scan of 720 beams, a path of 200 poses and an odometry, drawn in
this process as in the one that draws. It prints the ms of a picture if all of them are new, and if only scan and
odometry are, and the bytes of the picture, before and after compression.
"""

from __future__ import annotations

import math
import statistics
import time
from typing import Any

import numpy as np
import zstandard
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from sensor_msgs.msg import LaserScan

from rsb_extras.pictures.picture import Picture, Wish, encode_picture
from rsb_extras.pictures.tests.samples import task
from rsb_extras.pictures.worker import Artist, Task

_SIDE, _RESOLUTION = 1000, 0.05
_ROUNDS = 30
_SIZES = ((80, 24), (120, 40), (240, 70))


def main() -> None:
    grid, costs, scan, path, odometry = _messages()
    print(f"{'cells':<10}{'layers':<12}{'all new, ms':>12}{'scan, ms':>10}{'bytes':>8}{'compressed':>12}")
    for width, height in _SIZES:
        for name, layers in (
            ("grid", {}),
            ("all", {"/costmap": costs, "/scan": scan, "/plan": path, "/odom": odometry}),
        ):
            wish = Wish(width=width, height=height)
            everything = _task(wish, {"/map": grid, **layers})
            moving = _task(wish, {topic: layers[topic] for topic in ("/scan", "/odom") if topic in layers})
            artist = Artist()
            whole, picture = _timed(artist, everything)
            again, picture = _timed(artist, moving)
            encoded = encode_picture(picture)
            print(
                f"{f'{width}×{height}':<10}{name:<12}{whole:>12.1f}{again:>10.1f}{len(encoded):>8}"
                f"{len(zstandard.compress(encoded)):>12}"
            )


def _task(wish: Wish, messages: dict[str, Any]) -> Task:
    tasks = [task(wish, message, topic=topic) for topic, message in messages.items()]
    return Task(
        1,
        "nav_msgs/msg/OccupancyGrid",
        wish,
        tuple(sample for each in tasks for sample in each.samples),
        1,
        descriptions=tuple({about[0]: about for each in tasks for about in each.descriptions}.values()),
    )


def _timed(artist: Artist, wanted: Task) -> tuple[float, Picture]:
    """Return the ms of a picture, the median of some, and the last one."""
    times, picture = [], None
    for _ in range(_ROUNDS):
        began = time.perf_counter()
        picture = artist.do(wanted)
        times.append(time.perf_counter() - began)
    assert picture is not None
    assert not picture.problem, picture.problem
    return statistics.median(times) * 1e3, picture


def _messages() -> tuple[Any, ...]:
    """Return a house with rooms: walls, costs around them, and what a robot in it publishes."""
    rows, columns = np.mgrid[0:_SIDE, 0:_SIDE]
    wall = ((rows % 250 < 4) & (columns % 250 > 40)) | ((columns % 250 < 4) & (rows % 250 > 40))
    near = np.minimum(np.minimum(rows % 250, 250 - rows % 250), np.minimum(columns % 250, 250 - columns % 250))
    ground = np.where(wall, 100, 0).astype(np.int8)
    ground[:100] = -1
    costs = np.where(near < 30, 98 - 3 * near, 0).clip(0, 98)
    costs = np.where(wall, 100, np.where(near < 8, 99, costs)).astype(np.int8)
    scan = LaserScan(angle_min=-math.pi, angle_increment=math.tau / 720, range_min=0.1, range_max=30.0)
    scan.ranges = [float(each) for each in 4.0 + np.sin(np.arange(720) / 40)]
    scan.header.frame_id = "base_link"
    path = Path(poses=[PoseStamped() for _ in range(200)])
    path.header.frame_id = "map"
    for at, each in enumerate(path.poses):
        each.pose.position.x, each.pose.position.y = 5.0 + at * 0.1, 8.0 + math.sin(at / 20)
    odometry = Odometry(child_frame_id="base_link")
    odometry.header.frame_id = "map"
    odometry.pose.pose.position.x = odometry.pose.pose.position.y = 20.0
    return _grid(ground), _grid(costs), scan, path, odometry


def _grid(cells: Any) -> OccupancyGrid:
    message = OccupancyGrid(data=cells.ravel())
    message.header.frame_id = "map"
    message.info.width = message.info.height = _SIDE
    message.info.resolution = _RESOLUTION
    return message


if __name__ == "__main__":
    main()
