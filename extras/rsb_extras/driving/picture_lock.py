"""Locks driving while the camera's picture in sight is old, or stands still although the robot moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.feature_api import Wording
from rsb_console.feature_console import ConsoleSetting

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_console.feature_console import CameraSight

_SHOWN_FOR = 1.0
"""s for which an age stays on the screen: on a thin line, ten a second would hold up what matters."""


class LockText(Wording):
    """Texts about the picture."""

    AGE = "picture {age:.1f} s old"
    OLD = "locked: the picture is more than {most:g} s old"
    UNKNOWN = "locked: no picture yet, or its age is unknown"
    FROZEN = "locked: the picture stands still though the robot moves; D drives without"
    NUMBER = "picture_age: give seconds from 0.1 to 60, or 0 to drive by a picture of any age"


def read_picture_age(given: object) -> float:
    """Return the setting; raise ValueError if it is none."""
    if isinstance(given, bool) or not isinstance(given, int | float) or not (given == 0 or 0.1 <= given <= 60):
        raise ValueError(LockText.NUMBER())
    return float(given)


PICTURE_AGE = ConsoleSetting("picture_age", 1.0, read_picture_age)


class PictureLock:
    """Judges whether the operator sees what the robot does.

    A simulated camera sends equal pictures while its robot stands. So a picture that stands still locks only if it was
    taken after the robot was to move for as long as it may be old.

    Args:
        sight: returns how old the picture in sight is, or None if none is.
        most: s that it may be old, or 0 for any age.
    """

    def __init__(self, sight: Callable[[], CameraSight | None], most: float) -> None:
        self._sight = sight
        self._most = most
        self._moves_since: float | None = None
        self._is_frozen = False
        self._shown, self._shown_until = "", float("-inf")

    def problem(self, now: float) -> str:
        """Return why keys do nothing at `now` (s), or an empty string."""
        seen = self._sight() if self._most else None
        if seen is None:
            return ""
        if seen.age is None:
            return LockText.UNKNOWN()
        if seen.age > self._most:
            return LockText.OLD(most=self._most)
        moved_for = 0.0 if self._moves_since is None else now - seen.age - self._moves_since
        self._is_frozen = seen.still > self._most and (self._is_frozen or moved_for > self._most)
        return LockText.FROZEN() if self._is_frozen else ""

    def note_motion(self, now: float, *, moves: bool) -> None:
        """Take whether the robot is told to move at `now` (s)."""
        if not moves:
            self._moves_since = None
        elif self._moves_since is None:
            self._moves_since = now

    def age(self, now: float) -> str:
        """Return the picture's age for the screen, or an empty string if none is in sight."""
        if now >= self._shown_until:
            seen = self._sight()
            self._shown = "" if seen is None or seen.age is None else LockText.AGE(age=seen.age)
            self._shown_until = now + _SHOWN_FOR
        return self._shown
