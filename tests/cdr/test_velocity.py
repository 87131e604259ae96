"""The speeds that a serialized velocity commands, and what limits leave of it."""

from __future__ import annotations

import struct
from math import inf, isnan, nan

import pytest

from rsb_bridge.cdr.known_types import reduced, speeds_of, velocity_of
from rsb_bridge.model.by_hand import VelocityLimits

TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
LITTLE, BIG = b"\0\1\0\0", b"\0\0\0\0"
LIMITS = VelocityLimits(0.5, 1.0)


def twist(*numbers: float, begin: bytes = LITTLE) -> bytes:
    return begin + struct.pack("<6d" if begin == LITTLE else ">6d", *numbers)


def stamped(frame: bytes, *numbers: float) -> bytes:
    header = struct.pack("<iII", 7, 8, len(frame) + 1) + frame + b"\0"
    return LITTLE + header + bytes(-len(header) % 8) + struct.pack("<6d", *numbers)


@pytest.mark.parametrize("begin", [LITTLE, BIG])
def test_a_speed_is_that_of_all_axes_together(begin: bytes) -> None:
    assert speeds_of(TWIST, twist(0.3, -0.4, 0, 0, 0, -2, begin=begin)) == (0.5, 2.0)


@pytest.mark.parametrize("frame", [b"", b"b", b"base", b"base_link"])
def test_a_stamped_velocity_has_speeds_behind_its_header(frame: bytes) -> None:
    message = stamped(frame, 2, 0, 0, 0, 0, 3)
    assert speeds_of(STAMPED, message) == (2.0, 3.0)
    less = reduced(STAMPED, message, LIMITS)
    assert velocity_of(STAMPED, less) == (0.5, 1.0)
    assert (len(less), less[:-48]) == (len(message), message[:-48])


@pytest.mark.parametrize("message", [b"", LITTLE, twist(1, 0, 0, 0, 0, 0)[:-1]])
def test_what_is_malformed_has_no_speeds(message: bytes) -> None:
    assert speeds_of(TWIST, message) is None
    assert speeds_of("sensor_msgs/msg/Joy", twist(1, 0, 0, 0, 0, 0)) is None


def test_not_a_number_is_within_no_limits() -> None:
    for value in (nan, inf):
        speeds = speeds_of(TWIST, twist(value, 0, 0, 0, 0, 0))
        assert speeds is not None
        assert isnan(speeds[0]) or speeds[0] == inf
        assert not VelocityLimits(angular=1.0).allow(*speeds)


@pytest.mark.parametrize(
    ("asked", "left"),
    [
        ((0.5, 0, 0, 0, 0, -1.0), (0.5, 0, 0, 0, 0, -1.0)),
        ((-0.8, 0, 0, 0, 0, 0.3), (-0.5, 0, 0, 0, 0, 0.3)),
        ((0.2, 0, 0, 0, 0, -3.0), (0.2, 0, 0, 0, 0, -1.0)),
        ((3.0, -4.0, 0, 0, 0, 0), (0.3, -0.4, 0, 0, 0, 0)),
        ((0, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, 0)),
    ],
)
def test_what_is_beyond_keeps_its_direction(asked: tuple[float, ...], left: tuple[float, ...]) -> None:
    less = reduced(TWIST, twist(*asked), LIMITS)
    assert struct.unpack_from("<6d", less, 4) == pytest.approx(left)
    assert reduced(TWIST, twist(9, 0, 0, 0, 0, 9), VelocityLimits(linear=0.5)) == twist(0.5, 0, 0, 0, 0, 9)
