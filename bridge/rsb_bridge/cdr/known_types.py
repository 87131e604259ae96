"""Serialized messages of the few types that this program knows without ROS: types that drive robots, and two more.

A message of a driving type has a velocity, which limits may reduce, and a rest, which commands no motion. A rest is
made from the last message that did: its header and lengths stay, its values are 0. So it needs no installed type, keeps
the frame that a controller expects, and has as many axes as the node that reads it. String and BatteryState are written
here, too (CDR: RTPS 2.3, 10.5).
"""

from __future__ import annotations

import math
import struct
import time
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.model.by_hand import VelocityLimits

_BEGIN = 4
"""Bytes before the first field: the encapsulation header. Fields are aligned from there."""
_STAMP = 8
_STAMPED_AT = slice(_BEGIN, _BEGIN + _STAMP)


class _TooShortError(Exception):
    """A message is too short for its type."""


def _of_numbers(message: bytes) -> bytes:
    return message[:_BEGIN] + bytes(len(message) - _BEGIN)


def _of_stamped_numbers(message: bytes) -> bytes:
    end = _end_of_header(message)
    return message[:end] + bytes(len(message) - end)


def _of_joy(message: bytes) -> bytes:
    """Return a Joy with as many axes and buttons, none of which is moved or pressed."""
    rest = bytearray(message)
    at = _end_of_header(message)
    for _ in ("axes", "buttons"):
        at = _aligned(at)
        (count,) = _read(_length_of(message), message, at)
        at += 4
        # The peer chooses the count: zeros for 2^32 axes would take 16 GiB.
        if at + 4 * count > len(message):
            raise _TooShortError
        rest[at : at + 4 * count] = bytes(4 * count)
        at += 4 * count
    return bytes(rest)


def _length_of(message: bytes) -> struct.Struct:
    return struct.Struct("<I" if message[1] & 1 else ">I")


def _end_of_header(message: bytes) -> int:
    """Return where a std_msgs/Header ends that a message begins with."""
    at = _BEGIN + _STAMP
    (length,) = _read(_length_of(message), message, at)
    end = at + 4 + int(length)
    if end > len(message):
        raise _TooShortError
    return end


def _aligned(at: int, to: int = 4) -> int:
    """Return the first place from `at` on where a field of `to` bytes may begin."""
    return at + -(at - _BEGIN) % to


def _read(layout: struct.Struct, message: bytes, at: int) -> tuple[int, ...]:
    try:
        return layout.unpack_from(message, at)
    except struct.error:
        raise _TooShortError from None


_TWIST, _TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
_RESTS: dict[str, tuple[Callable[[bytes], bytes], bool]] = {
    _TWIST: (_of_numbers, False),
    _TWIST_STAMPED: (_of_stamped_numbers, True),
    "ackermann_msgs/msg/AckermannDrive": (_of_numbers, False),
    "ackermann_msgs/msg/AckermannDriveStamped": (_of_stamped_numbers, True),
    "sensor_msgs/msg/Joy": (_of_joy, True),
}
"""For each type, what makes a rest of a message, and whether it begins with a header."""
DRIVING_TYPES = frozenset(_RESTS)
"""Types that drive robots: of those that may move one (`rsb_bridge.model.motion`), the ones whose rest is known."""


def resting(type_name: str, message: bytes) -> bytes | None:
    """Return a message of a driving type that commands no motion, or None if the message is malformed.

    Args:
        type_name: of `DRIVING_TYPES`.
        message: the last one that passed, with its encapsulation header. It is returned itself if it rests.
    """
    make, _ = _RESTS[type_name]
    if len(message) < _BEGIN:
        return None
    try:
        return make(message)
    except _TooShortError:
        return None


def stamped(type_name: str, message: bytes, now: int) -> bytes:
    """Return a message with another time in its header, if it is of a driving type that has one.

    Args:
        message: with its encapsulation header.
        now: ns since the epoch.
    """
    if type_name not in _RESTS or not _RESTS[type_name][1]:
        return message
    stamp = struct.pack("<iI" if message[1] & 1 else ">iI", *divmod(now, 10**9))
    return message[: _STAMPED_AT.start] + stamp + message[_STAMPED_AT.stop :]


Velocity: TypeAlias = tuple[float, float]
"""Forward in m/s, and turn in rad/s, counterclockwise."""
_TWIST_LAYOUTS = struct.Struct(">6d"), struct.Struct("<6d")
_Six: TypeAlias = tuple[float, float, float, float, float, float]


def velocity_of(type_name: str, message: bytes) -> Velocity | None:
    """Return the velocity that a message commands, or None if it has none, or another type than Twist(Stamped)."""
    if (numbers := _numbers(type_name, message)) is None:
        return None
    forward, *_, turn = numbers
    return (forward, turn) if math.isfinite(forward) and math.isfinite(turn) else None


def speeds_of(type_name: str, message: bytes) -> tuple[float, float] | None:
    """Return the speeds in m/s and rad/s, in any direction, that a message commands; None as `velocity_of`.

    One is infinite or NaN if a number of the message is.
    """
    if (numbers := _numbers(type_name, message)) is None:
        return None
    return math.hypot(*numbers[:3]), math.hypot(*numbers[3:])


def reduced(type_name: str, message: bytes, limits: VelocityLimits) -> bytes:
    """Return a message of finite speeds with no more of them than the limits allow, in the same directions."""
    numbers, speeds = _numbers(type_name, message), speeds_of(type_name, message)
    if numbers is None or speeds is None or limits.allow(*speeds):
        return message
    new = bytearray(message)
    layout, at = _place(type_name, message)
    linear, angular = (
        # A vector of zeros has no direction, and stays.
        tuple(each / (speed or 1.0) * allowed for each in vector)  # of one axis, exactly what is allowed
        for vector, speed, allowed in zip((numbers[:3], numbers[3:]), speeds, limits.reduced(*speeds), strict=True)
    )
    layout.pack_into(new, at, *linear, *angular)
    return bytes(new)


def _numbers(type_name: str, message: bytes) -> _Six | None:
    if type_name not in (_TWIST, _TWIST_STAMPED):
        return None
    try:
        layout, at = _place(type_name, message)
        numbers: _Six = layout.unpack_from(message, at)
    except (_TooShortError, struct.error, IndexError):
        return None
    return numbers


def _place(type_name: str, message: bytes) -> tuple[struct.Struct, int]:
    """Return how and where a message has its six numbers."""
    return _TWIST_LAYOUTS[message[1] & 1], _BEGIN if type_name == _TWIST else _aligned(_end_of_header(message), 8)


CLOCK = "rosgraph_msgs/msg/Clock"
STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
BATTERY_STATE = "sensor_msgs/msg/BatteryState"
BATTERY_STATE_HASH = "RIHS01_4bee5dfce981c98faa6828b868307a0a73f992ed0789f374ee96c8f840e69741"
_NOT_MEASURED = (math.nan,) * 6
_BATTERY_LAYOUT = struct.Struct("<4s iII4x 7f 4B II I4x I4x")
"""A header with an empty frame, seven figures, four states, two empty sequences, two empty strings."""
_DIGITS = 20  # of a time
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
    return _BATTERY_LAYOUT.pack(b"\0\1\0\0", 0, 0, 1, *_NOT_MEASURED, charge, 0, 0, 0, True, 0, 0, 1, 1)


def stamped_string(size: int, made: int | None = None) -> bytes:
    """Serialize a String whose first digits are the time when it was made.

    Args:
        size: of the String with its final zero byte; it is rounded up to a multiple of 4, at least 24. DDS pads other
            messages between processes, so that one would arrive with other bytes than were sent.
        made: monotonic ns, or None for now.
    """
    header, rest = _string_frame(size)
    return b"%b%020d%b" % (header, time.monotonic_ns() if made is None else made, rest)


def made_at(payload: bytes) -> int:
    """Return the time (monotonic ns) in a `stamped_string`; all processes of a machine share that clock."""
    return int(payload[_BEFORE : _BEFORE + _DIGITS])


@lru_cache(maxsize=16)
def _string_frame(size: int) -> tuple[bytes, bytes]:
    whole = serialize_string(b"x" * ((max(size, _DIGITS + 1) + 3) // 4 * 4 - 1))
    return whole[:_BEFORE], whole[_BEFORE + _DIGITS :]
