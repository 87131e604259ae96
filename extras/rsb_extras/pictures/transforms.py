"""Poses in the plane, and the tree of frames that relates them."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
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
_POSES = 100
"""Poses of a frame that are remembered: 1 s at 100 Hz, while a scan takes 0.1 s. A round figure."""
_BEFORE = 1.0
"""s: a message older than the oldest pose by more than this was not meant for where the robot was then."""
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


class _Frame:
    """A frame, and its poses in its parent.

    Attributes:
        came: s since the epoch, when its newest transform came, or infinity if that is static.
    """

    def __init__(self, parent: str) -> None:
        self.parent = parent
        self.came = math.inf
        self._poses: deque[tuple[float, Transform]] = deque(maxlen=_POSES)

    def add(self, stamp: float, pose: Transform, came: float) -> None:
        self.came = came
        if self._poses and stamp < self._poses[-1][0]:  # a simulation began anew
            self._poses.clear()
        self._poses.append((stamp, pose))

    def at(self, stamp: float) -> Transform:
        """Return its pose at a time of messages' stamps; the newest if that is 0, or before what is remembered."""
        (first, oldest), (last, newest) = self._poses[0], self._poses[-1]
        if not 0 < stamp < last or stamp < first - _BEFORE:
            return newest
        if stamp <= first:
            return oldest
        after = bisect_left(self._poses, stamp, key=lambda each: each[0])
        (begin, one), (end, other) = self._poses[after - 1], self._poses[after]
        part = (stamp - begin) / (end - begin)
        turn = math.remainder(other.yaw - one.yaw, math.tau)
        return Transform(one.x + (other.x - one.x) * part, one.y + (other.y - one.y) * part, one.yaw + turn * part)


class FrameTree:
    """The newest transforms of frames."""

    def __init__(self) -> None:
        self._frames: dict[str, _Frame] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._frames)

    def __contains__(self, frame: str) -> bool:
        return frame in self._frames

    def add(self, child: str, parent: str, pose: Transform, stamp: float, came: float) -> None:
        """Take a transform.

        Args:
            stamp: s, its own.
            came: s since the epoch, when it came, or infinity if it is static.
        """
        if not child or (child not in self._frames and len(self._frames) >= FRAMES):
            return
        frame = self._frames.get(child)
        if frame is None or frame.parent != parent:
            frame = self._frames[child] = _Frame(parent)
        frame.add(stamp, pose, came)

    def place(self, frame: str, target: str, stamp: float = 0.0) -> Transform | None:
        """Return the pose of a frame in another, or None if the transforms between them are unknown.

        Args:
            stamp: s, that of the message which is to be placed, or 0 for the newest pose.
        """
        if frame == target:
            return Transform()
        up, up_target = self._to_root(frame, stamp), self._to_root(target, stamp)
        for common, at in up.items():
            if common in up_target:
                return up_target[common].inverse().after(at)
        return None

    def oldest(self, frame: str) -> float:
        """Return when the oldest transform between a frame and its root came, or infinity if all are static."""
        frames = self._to_root(frame, 0.0)
        return min((self._frames[name].came for name in frames if name in self._frames), default=math.inf)

    def _to_root(self, frame: str, stamp: float) -> dict[str, Transform]:
        """Return the poses of a frame in itself, in its parent, in its parent's parent …."""
        poses, at = {frame: Transform()}, Transform()
        for _ in range(_DEPTH):
            found = self._frames.get(frame)
            # A hostile node, or two that disagree, may publish a circle.
            if found is None or found.parent in poses:
                break
            frame, at = found.parent, found.at(stamp).after(at)
            poses[frame] = at
        return poses


def stamp_of(message: Message) -> float:
    """Return a message's own time stamp in s, or 0."""
    stamp = number(message, "header.stamp.sec") + number(message, "header.stamp.nanosec") * 1e-9
    return stamp if math.isfinite(stamp) else 0.0


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
