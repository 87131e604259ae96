"""Poses in the plane, and the tree of frames that relates them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from rsb_extras.pictures.drawing import number

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

    from rsb_bridge.cdr.decoder import Message

    Floats = NDArray[np.float64]

FRAMES = 500
"""Frames that are remembered: a round figure."""
FAR = 1e7
"""m, a quarter of the way around the Earth: coordinates beyond are wrong."""
_DEPTH = 64
"""Transforms from a frame to another at most: a round figure."""


class Transform(NamedTuple):
    """The pose of a frame in another, in the plane."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def apply(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return coordinates of the frame as coordinates of the other."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + cos * x - sin * y, self.y + sin * x + cos * y

    def after(self, inner: Transform) -> Transform:
        """Return the pose, in the other frame, of a pose in this one."""
        x, y = self.apply(inner.x, inner.y)
        return Transform(x, y, self.yaw + inner.yaw)

    def inverse(self) -> Transform:
        """Return the pose of the other frame in this one."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Transform(-cos * self.x - sin * self.y, sin * self.x - cos * self.y, -self.yaw)


class _Frame(NamedTuple):
    """A frame.

    Attributes:
        at: pose in the parent.
        time: s since the epoch, when its newest transform came, or infinity if that is static.
    """

    parent: str
    at: Transform
    time: float


class FrameTree:
    """The newest transforms of frames."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._frames)

    def __contains__(self, frame: str) -> bool:
        return frame in self._frames

    def add(self, child: str, parent: str, at: Transform, time: float) -> None:
        if child and (child in self._frames or len(self._frames) < FRAMES):
            self._frames[child] = _Frame(parent, at, time)

    def place(self, frame: str, target: str) -> Transform | None:
        """Return the pose of a frame in another, or None if the transforms between them are unknown."""
        if frame == target:
            return Transform()
        up, up_target = self._to_root(frame), self._to_root(target)
        for common, at in up.items():
            if common in up_target:
                return up_target[common].inverse().after(at)
        return None

    def oldest(self, frame: str) -> float:
        """Return the time of the oldest transform between a frame and its root, or infinity if all are static."""
        return min((self._frames[name].time for name in self._to_root(frame) if name in self._frames), default=math.inf)

    def _to_root(self, frame: str) -> dict[str, Transform]:
        """Return the poses of a frame in itself, in its parent, in its parent's parent …."""
        poses, at = {frame: Transform()}, Transform()
        for _ in range(_DEPTH):
            found = self._frames.get(frame)
            # A hostile node, or two that disagree, may publish a circle.
            if found is None or found.parent in poses:
                break
            frame, at = found.parent, found.at.after(at)
            poses[frame] = at
        return poses


def yaw(message: Message, path: str) -> float:
    """Return the rotation about z of a geometry_msgs/msg/Quaternion."""
    x, y, z, w = (number(message, f"{path}.{each}") for each in "xyzw")
    angle = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return angle if math.isfinite(angle) else 0.0


def transform(message: Message, path: str) -> Transform:
    """Return a geometry_msgs/msg/Transform."""
    x, y = (coordinate(number(message, f"{path}.translation.{axis}")) for axis in "xy")
    return Transform(x, y, yaw(message, f"{path}.rotation"))


def pose(message: Message, path: str) -> Transform:
    """Return a geometry_msgs/msg/Pose."""
    x, y = (coordinate(number(message, f"{path}.position.{axis}")) for axis in "xy")
    return Transform(x, y, yaw(message, f"{path}.orientation"))


def coordinate(value: float) -> float:
    """Return a coordinate within the bounds of the Earth, or 0 instead of none."""
    return max(-FAR, min(FAR, value)) if math.isfinite(value) else 0.0
