"""Motion by hand: how late it may come, the velocity that it may have, and what the robot gets at the end."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

import msgspec

from rsb_bridge.model.limits import SPEED, TURN_RATE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from rsb_bridge.model.limits import Range

TICKET_LIFE = 1.0
"""s for which a ticket is valid: a command for a topic that has to be armed is not older than this, and neither are its
messages (`demands.ARMED`)."""
OLD_AFTER = 5.0
"""s after which a command that moves a robot is given up: what stood still for so long is no longer wanted."""
ASKED_FOR = 10.0
"""s in which the holder of an arming answers whether another operator may hold it instead; then it goes over.

Not measured: a holder has to read a line and press a key, and the other operator has to wait for so long.
"""


class Held(msgspec.Struct, frozen=True, omit_defaults=True):
    """The topics and services that a console holds."""

    keys: tuple[str, ...] = ()  # of the routes that it has armed


TWISTS: Final = frozenset({"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"})
"""The types that have limits."""
_UNITS: Final = {"linear": "m/s", "angular": "rad/s"}
_RANGES: Final = {"linear": SPEED, "angular": TURN_RATE}


class VelocityLimits(msgspec.Struct, frozen=True, omit_defaults=True):
    """The highest speeds, in any direction, that a hand may ask of a robot (`limits`)."""

    linear: float | None = None  # m/s, or None for any
    angular: float | None = None  # rad/s, or None for any

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


def smallest_limits(limits: Iterable[VelocityLimits | None]) -> VelocityLimits | None:
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


END_ZERO: Final = "zero"
"""The end of an arming (`on_end`) is a message of zeros for the robot."""
END_NONE: Final = "none"
"""Nothing is published; the robot goes on with its last command."""
END_CANCEL: Final = "cancel"
"""The goals of the link's callers are cancelled."""
LONGEST_END: Final = 200
"""Characters of a message, written as JSON."""


def end_text(on_end: str | dict[str, Any] | None) -> str:
    """Return the `on_end` of a line of a session as one text, empty if it says nothing; a message as JSON."""
    return json.dumps(on_end) if isinstance(on_end, dict) else on_end or ""


def is_end_message(text: str) -> bool:
    """Whether it is a message, and not a word."""
    return text.startswith("{")


def can_end(kind: str, text: str) -> bool:
    """Whether something of a kind can end so. The fields of a message are not looked at."""
    if kind == "action":
        return text in (END_CANCEL, END_NONE)
    return kind == "topic" and (text in (END_ZERO, END_NONE) or is_end_message(text))


def agreed_end(receiving: str, sending: str, *, drives: bool) -> str:
    """Return what the robot gets when the arming of a topic ends. The sending side can only have it stop.

    Args:
        receiving: the end that the session on the robot's side wants, or empty if it says nothing.
        sending: the same of the other side.
        drives: whether the topic's type drives robots. Zeros of another type may be a command.
    """
    if not drives or is_end_message(receiving):
        return receiving or END_NONE
    return END_NONE if receiving == END_NONE and sending in ("", END_NONE) else END_ZERO


def more_careful_end(texts: Iterable[str]) -> str:
    """Return which of several lines holds, the first one's of equals: ``none`` loses against any message."""
    given = [each for each in texts if each]
    return next((each for each in given if each != END_NONE), END_NONE if given else "")
