"""How old a message or a request may be when it is published, by what the two sides' sessions say of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

ARMED = 1.0
"""s: the limit of what has to be armed, unless a session sets one."""


def effective_max_age(demands: Iterable[float | None], *, armed: bool) -> float:
    """Return the limit (s) that holds, or 0 for no limit.

    The smallest limit holds. A side that says 0 asks for no limit and does not lift the other side's.

    Args:
        demands: what each side's session sets: s, 0 for no limit, or None if it sets nothing.
        armed: whether either side demands that it is armed.
    """
    given = [each for each in demands if each is not None]
    if not given:
        return ARMED if armed else 0.0
    return min(filter(None, given), default=0.0)
