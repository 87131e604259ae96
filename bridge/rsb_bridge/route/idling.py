"""When a half of a route is ticked: once a second while anything happens, and otherwise when something is due.

What follows from a message, a report, a command or the graph follows within seconds, and the windows over which a half
is judged are as short, but for a few. So a half is ticked for a while after each event, and from then on only at the
time that its rules name: `next_change`. Each event says that it has happened (`Route.wake`), but for messages, which
are counted anyway, and looked at once a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable

SETTLES = 12.0
"""s after an event for which a half is ticked: longer than each window of the rules, but for those that `next_change`
tells of (`watches.LATELY`, `topic_route._LATENCY_TICKS`, `combined_verdict._WAITS`)."""
POLLED_EVERY = 15.0  # s, at most, between two ticks of a half with something that does not tell when it changes

Signs: TypeAlias = tuple[object, ...]
"""What a half's verdict and its figures follow from, messages aside; they are equal while nothing happens."""


class Idling:
    """Whether a half is idle, so that hundreds of quiet ones cost next to nothing: not ticked, reported or shown anew.

    Attributes:
        until: time (s) of the next tick.
        passed: messages at the last tick.
        looked: time (s) of the last look that found no more, or of the last tick.
    """

    __slots__ = ("_settles_until", "_signs", "looked", "passed", "until")

    def __init__(self, now: float) -> None:
        self.until = self.looked = now
        self._settles_until = now + SETTLES
        self._signs: Signs = ()
        self.passed = 0

    def wake(self, now: float) -> None:
        """Have the half ticked each second again, as something has happened to it."""
        self.until, self._settles_until = now, now + SETTLES

    def compare(self, signs: Callable[[], Signs], now: float) -> None:
        """Wake an idle half whose signs have changed."""
        if now < self.until and signs() != self._signs:
            self.wake(now)

    def ticked(self, signs: Signs, passed: int, now: float, next_change: float) -> None:
        """Decide after a tick when the next one is.

        Args:
            passed: messages so far.
            next_change: time (s) of the next change by time alone, `now` if it may come at any moment, or infinite.
        """
        if passed != self.passed or signs != self._signs:
            self._settles_until = now + SETTLES
        self._signs, self.passed, self.looked = signs, passed, now
        self.until = now if now < self._settles_until else next_change
