"""The largest age of messages and requests when they are published, from the sessions of both sides."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

ARMED = 1.0
"""The limit (s) of topics that have to be armed, unless a session sets another one."""


def default_max_age(seconds: float | None, *, armed: bool) -> float | None:
    """Return what a line of a session demands: s, 0 for no limit, or None if it says nothing.

    Args:
        seconds: what it sets, or None if it sets nothing.
        armed: whether it demands arming.
    """
    return ARMED if seconds is None and armed else seconds


def smallest_max_age(demands: Iterable[float | None]) -> float | None:
    """Return the smallest limit (s) of several demands, 0 for no limit, or None if no demand sets one.

    A demand of 0 asks for no limit, and does not lift the limits of others.
    """
    given = [each for each in demands if each is not None]
    return min(filter(None, given), default=0.0) if given else None


def effective_max_age(demands: Iterable[float | None], *, armed: bool) -> float:
    """Return the limit (s) that holds, or 0 for no limit.

    Args:
        demands: of both sides, as in `smallest_max_age`.
        armed: whether either side demands that it is armed.
    """
    return default_max_age(smallest_max_age(demands), armed=armed) or 0.0
