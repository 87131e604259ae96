"""The velocity in a serialized Twist or TwistStamped: read, compared with limits, and reduced to them."""

from __future__ import annotations

import struct
from math import hypot, isfinite
from typing import TYPE_CHECKING, TypeAlias

from rsb_bridge.cdr.resting import BEGIN, TWIST, TWIST_STAMPED, TooShortError, aligned, end_of_header

if TYPE_CHECKING:
    from rsb_bridge.model.by_hand import VelocityLimits

Velocity: TypeAlias = tuple[float, float]
"""Forward in m/s, and turn in rad/s, counterclockwise."""
_LAYOUTS = struct.Struct(">6d"), struct.Struct("<6d")
_Six: TypeAlias = tuple[float, float, float, float, float, float]


def velocity_of(type_name: str, message: bytes) -> Velocity | None:
    """Return the velocity that a message commands, or None if it has none, or another type than Twist(Stamped)."""
    if (numbers := _numbers(type_name, message)) is None:
        return None
    forward, *_, turn = numbers
    return (forward, turn) if isfinite(forward) and isfinite(turn) else None


def speeds_of(type_name: str, message: bytes) -> tuple[float, float] | None:
    """Return the speeds in m/s and rad/s, in any direction, that a message commands; None as `velocity_of`.

    One is infinite or NaN if a number of the message is.
    """
    if (numbers := _numbers(type_name, message)) is None:
        return None
    return hypot(*numbers[:3]), hypot(*numbers[3:])


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
    if type_name not in (TWIST, TWIST_STAMPED):
        return None
    try:
        layout, at = _place(type_name, message)
        numbers: _Six = layout.unpack_from(message, at)
    except (TooShortError, struct.error, IndexError):
        return None
    return numbers


def _place(type_name: str, message: bytes) -> tuple[struct.Struct, int]:
    """Return how and where a message has its six numbers."""
    return _LAYOUTS[message[1] & 1], BEGIN if type_name == TWIST else aligned(end_of_header(message), 8)
