"""Messages of ``std_msgs/String`` and ``sensor_msgs/BatteryState`` as bytes, without rclpy (CDR: RTPS 2.3, 10.5)."""

from __future__ import annotations

import math
import struct
import time
from functools import lru_cache

STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


BATTERY_STATE = "sensor_msgs/msg/BatteryState"
BATTERY_STATE_HASH = "RIHS01_4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741"
_NOT_MEASURED = (math.nan,) * 6
_LAYOUT = struct.Struct("<4s iII4x 7f 4B II I4x I4x")
"""A header with an empty frame, seven figures, four states, two empty sequences, two empty strings."""
_STAMP = 20  # digits
_BEFORE = 8  # bytes: the encapsulation header and the string's length


def serialize_string(data: bytes) -> bytes:
    """Serialize a String whose ``data`` is this UTF-8."""
    return b"\0\1\0\0" + struct.pack("<I", len(data) + 1) + data + b"\0"


def string_bytes(payload: bytes) -> bytes:
    """Return a message's ``data``, UTF-8 in a valid message, or empty bytes for another payload."""
    try:
        (length,) = struct.unpack_from("<I" if payload[1] & 1 else ">I", payload, 4)
    except (struct.error, IndexError):
        return b""
    return payload[8 : 8 + max(0, length - 1)]


def battery_state(charge: float) -> bytes:
    """Serialize a BatteryState that has only the charge, 0 to 1."""
    return _LAYOUT.pack(b"\0\1\0\0", 0, 0, 1, *_NOT_MEASURED, charge, 0, 0, 0, True, 0, 0, 1, 1)


def stamped_string(size: int) -> bytes:
    """Serialize a String of `size` bytes, at least 20, whose first digits are the time now (monotonic ns)."""
    header, rest = _frame(size)
    return b"%b%020d%b" % (header, time.monotonic_ns(), rest)


def made_at(payload: bytes) -> int:
    """Return the time (monotonic ns) in a `stamped_string`; all processes of a machine share that clock."""
    return int(payload[_BEFORE : _BEFORE + _STAMP])


@lru_cache(maxsize=16)
def _frame(size: int) -> tuple[bytes, bytes]:
    whole = serialize_string(b"x" * max(size, _STAMP))
    return whole[:_BEFORE], whole[_BEFORE + _STAMP :]
