"""``sensor_msgs/BatteryState`` as bytes, without rclpy (CDR: OMG DDSI-RTPS 2.3, 10.5)."""

from __future__ import annotations

import math
import struct

BATTERY_STATE = "sensor_msgs/msg/BatteryState"
BATTERY_STATE_HASH = "RIHS01_4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741"
_NOT_MEASURED = (math.nan,) * 6
_LAYOUT = struct.Struct("<4s iII4x 7f 4B II I4x I4x")
"""A header with an empty frame, seven figures, four states, two empty sequences, two empty strings."""


def battery_state(charge: float) -> bytes:
    """The message that says how full a battery is, 0 to 1, and no more."""
    return _LAYOUT.pack(b"\0\1\0\0", 0, 0, 1, *_NOT_MEASURED, charge, 0, 0, 0, True, 0, 0, 1, 1)
