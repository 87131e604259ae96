"""Bounds on the velocity that a hand may ask of a robot (`limits`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import msgspec

from rsb_bridge.model.limits import SPEED, TURN_RATE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.model.limits import Range

TWISTS: Final = frozenset({"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"})
"""The types that have limits."""
_UNITS: Final = {"linear": "m/s", "angular": "rad/s"}
_RANGES: Final = {"linear": SPEED, "angular": TURN_RATE}


class VelocityLimits(msgspec.Struct, frozen=True, omit_defaults=True):
    """The highest speeds, in any direction.

    Attributes:
        linear: m/s, or None for any.
        angular: rad/s, or None for any.
    """

    linear: float | None = None
    angular: float | None = None

    def __str__(self) -> str:
        given = ((getattr(self, name), unit) for name, unit in _UNITS.items())
        return ", ".join(f"{value:g} {unit}" for value, unit in given if value is not None)

    @property
    def out_of_range(self) -> Iterator[tuple[str, float, Range, str]]:
        """The numbers that are no limits: name, value, the range where it should be, and its unit."""
        for name, allowed in _RANGES.items():
            value = getattr(self, name)
            if value is not None and value not in allowed:
                yield name, value, allowed, _UNITS[name]

    def allow(self, linear: float, angular: float) -> bool:
        """Whether they allow two speeds (m/s, rad/s). They never allow NaN."""
        within = linear < float("inf") if self.linear is None else linear <= self.linear
        return within and (angular < float("inf") if self.angular is None else angular <= self.angular)

    def reduced(self, forward: float, turn: float) -> tuple[float, float]:
        """Return what they leave of a velocity in m/s and rad/s, each of which may be negative."""
        return _reduced(forward, self.linear), _reduced(turn, self.angular)

    def are_in(self, whole: VelocityLimits) -> bool:
        """Whether one of these numbers is a number of `whole`, the smallest of several limits."""
        return any(getattr(self, name) is not None and getattr(self, name) == getattr(whole, name) for name in _UNITS)


def smallest(limits: Iterable[VelocityLimits | None]) -> VelocityLimits | None:
    """Return the smallest number of each kind, or None without any limits."""
    given = [each for each in limits if each is not None]
    if not given:
        return None
    return VelocityLimits(
        min((each.linear for each in given if each.linear is not None), default=None),
        min((each.angular for each in given if each.angular is not None), default=None),
    )


def _reduced(speed: float, limit: float | None) -> float:
    return speed if limit is None else max(-limit, min(limit, speed))
