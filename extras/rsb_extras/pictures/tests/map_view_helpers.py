"""Helpers of `test_map_view` and others."""

from __future__ import annotations

import math
from typing import Any

import msgspec
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path

from rsb_extras.pictures.picture import Picture, Wish
from rsb_extras.pictures.tests.samples import task
from rsb_extras.pictures.worker import Artist

WISH = Wish(width=40, height=20)


def grid(side: int = 100, resolution: float = 0.1) -> OccupancyGrid:
    """Return a free square around the origin with one occupied row at its upper edge."""
    message = OccupancyGrid()
    message.header.frame_id = "map"
    message.info.width = message.info.height = side
    message.info.resolution = resolution
    message.info.origin.position.x = message.info.origin.position.y = -side * resolution / 2
    message.data = [0] * (side * (side - 1)) + [100] * side
    return message


def picture(*messages: Any, wish: Wish = WISH) -> Picture:
    """Return the picture of messages, each on a topic of its own."""
    artist, result = Artist(), None
    first = task(wish, messages[0])
    for at, message in enumerate(messages):
        wanted = task(wish, message, topic=f"/topic{at}")
        result = artist.do(msgspec.structs.replace(wanted, type_name=first.type_name))
    assert result is not None
    return result


def pose(x: float, y: float, yaw: float, kind: type = PoseStamped, frame: str = "map") -> Any:
    message = kind()
    message.header.frame_id = frame
    at = message.pose.pose if kind is Odometry else message.pose
    at.position.x, at.position.y = x, y
    at.orientation.z, at.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return message


def path(points: list[tuple[float, float]]) -> Path:
    message = Path(poses=[pose(x, y, 0.0) for x, y in points])
    message.header.frame_id = "map"
    return message
