"""``std_msgs/String`` as bytes, without rclpy (CDR: OMG DDSI-RTPS 2.3, 10.5)."""

from __future__ import annotations

import struct

STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def serialize_string(data: bytes) -> bytes:
    """The message whose ``data`` is that UTF-8."""
    return b"\0\1\0\0" + struct.pack("<I", len(data) + 1) + data + b"\0"


def string_bytes(payload: bytes) -> bytes:
    """The ``data`` of a message, UTF-8 if its sender keeps to the format; empty: the payload is no such message."""
    try:
        (length,) = struct.unpack_from("<I" if payload[1] & 1 else ">I", payload, 4)
    except (struct.error, IndexError):
        return b""
    return payload[8 : 8 + max(0, length - 1)]
