"""Helpers of `test_map_view` and others."""

from __future__ import annotations

from nav_msgs.msg import OccupancyGrid


def grid(side: int = 100, resolution: float = 0.1) -> OccupancyGrid:
    """Return a free square around the origin with one occupied row at its upper edge."""
    message = OccupancyGrid()
    message.header.frame_id = "map"
    message.info.width = message.info.height = side
    message.info.resolution = resolution
    message.info.origin.position.x = message.info.origin.position.y = -side * resolution / 2
    message.data = [0] * (side * (side - 1)) + [100] * side
    return message
