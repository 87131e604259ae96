"""``std_msgs/String`` messages that say when they were made, for measuring; without rclpy."""

from __future__ import annotations

import time
from functools import lru_cache

from rsb_bridge.ros.std_string import serialize_string

_STAMP = 20  # digits
_BEFORE = 8  # bytes: the encapsulation header and the string's length


def message(size: int) -> bytes:
    """A String of `size` bytes, at least 20, serialized, with the time now (monotonic ns) as its first digits."""
    header, rest = _frame(size)
    return b"%b%020d%b" % (header, time.monotonic_ns(), rest)


def made_at(payload: bytes) -> int:
    """When a message was made (monotonic ns); the clock is the same for all processes of a machine."""
    return int(payload[_BEFORE : _BEFORE + _STAMP])


@lru_cache(maxsize=16)
def _frame(size: int) -> tuple[bytes, bytes]:
    whole = serialize_string(b"x" * max(size, _STAMP))
    return whole[:_BEFORE], whole[_BEFORE + _STAMP :]
