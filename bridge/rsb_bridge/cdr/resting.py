"""Messages that command no motion, made from the last one that did: its header and lengths stay, its values are 0.

Only of types that drive robots in the field. So a rest needs no installed type, keeps the frame that a controller
expects, and has as many axes as the node that reads it.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

BEGIN = 4
"""Bytes before the first field: the encapsulation header. Fields are aligned from there."""
_STAMP = 8
_STAMPED_AT = slice(BEGIN, BEGIN + _STAMP)


class TooShortError(Exception):
    """A message is too short for its type."""


def _of_numbers(message: bytes) -> bytes:
    return message[:BEGIN] + bytes(len(message) - BEGIN)


def _of_stamped_numbers(message: bytes) -> bytes:
    end = end_of_header(message)
    return message[:end] + bytes(len(message) - end)


def _of_joy(message: bytes) -> bytes:
    """Return a Joy with as many axes and buttons, none of which is moved or pressed."""
    rest = bytearray(message)
    at = end_of_header(message)
    for _ in ("axes", "buttons"):
        at = aligned(at)
        (count,) = _read(_length_of(message), message, at)
        at += 4
        # The peer chooses the count: zeros for 2^32 axes would take 16 GiB.
        if at + 4 * count > len(message):
            raise TooShortError
        rest[at : at + 4 * count] = bytes(4 * count)
        at += 4 * count
    return bytes(rest)


def _length_of(message: bytes) -> struct.Struct:
    return struct.Struct("<I" if message[1] & 1 else ">I")


def end_of_header(message: bytes) -> int:
    """Return where a std_msgs/Header ends that a message begins with."""
    at = BEGIN + _STAMP
    (length,) = _read(_length_of(message), message, at)
    end = at + 4 + int(length)
    if end > len(message):
        raise TooShortError
    return end


def aligned(at: int, to: int = 4) -> int:
    """Return the first place from `at` on where a field of `to` bytes may begin."""
    return at + -(at - BEGIN) % to


def _read(layout: struct.Struct, message: bytes, at: int) -> tuple[int, ...]:
    try:
        return layout.unpack_from(message, at)
    except struct.error:
        raise TooShortError from None


TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
_RESTS: dict[str, tuple[Callable[[bytes], bytes], bool]] = {
    TWIST: (_of_numbers, False),
    TWIST_STAMPED: (_of_stamped_numbers, True),
    "ackermann_msgs/msg/AckermannDrive": (_of_numbers, False),
    "ackermann_msgs/msg/AckermannDriveStamped": (_of_stamped_numbers, True),
    "sensor_msgs/msg/Joy": (_of_joy, True),
}
"""For each type, what makes a rest of a message, and whether it begins with a header."""
DRIVING_TYPES = frozenset(_RESTS)
"""Types with which robots are driven."""


def resting(type_name: str, message: bytes) -> bytes | None:
    """Return a message of a driving type that commands no motion, or None if the message is malformed.

    Args:
        type_name: of `DRIVING_TYPES`.
        message: the last one that passed, with its encapsulation header. It is returned itself if it rests.
    """
    make, _ = _RESTS[type_name]
    if len(message) < BEGIN:
        return None
    try:
        return make(message)
    except TooShortError:
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
