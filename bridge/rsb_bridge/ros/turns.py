"""The turns of the ROS thread, and the time of the last one.

A process that was stopped goes on as if nothing had happened, and its thread then takes messages that have waited in
DDS meanwhile. So the thread notes the time at each turn while anybody has to know how old messages can be.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rsb_bridge.model.clock import Clock

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

LONGEST_WAIT = 0.25
"""Seconds that the thread waits at most while it is watched."""
_LATE = 0.5
"""Seconds between two turns from which on the thread, or the whole process, stood still."""
_CATCHES_UP = 0.25
"""Seconds after a standstill in which DDS may still bring what it should have brought before."""


class RosTurns:
    """When the ROS thread turned. The thread writes, any thread reads.

    Args:
        wake: has the thread turn at once, or None if messages come without a thread, and so without a wait.
        steady: the clock, in s, or None for the machine's.

    Attributes:
        watched: whether anybody wants to know; else nothing is noted.
        at: s, the last turn.
        since: s; what is taken in this turn came after that.
        count: turns that were noted.
    """

    def __init__(self, wake: Callable[[], None] | None = None, steady: Callable[[], float] | None = None) -> None:
        self._wake = wake
        self._steady = steady or Clock().steady
        self._watchers: set[Hashable] = set()
        self._caught_up_at = 0.0
        self.watched = False
        self.count = 0
        self.at = self.since = float("inf")

    def watch(self, watcher: Hashable) -> None:
        """Have the thread note its turns. May be called again."""
        if self._wake is None or watcher in self._watchers:
            return
        self._watchers.add(watcher)
        if not self.watched:
            self.at = self.since = self._steady()
            self.watched = True
            self._wake()

    def leave(self, watcher: Hashable) -> None:
        """End `watch`."""
        self._watchers.discard(watcher)
        if not self._watchers:
            self.watched = False
            self.at = self.since = float("inf")

    def turned(self) -> None:
        """On the ROS thread, while it is watched: its wait is over, and it takes what has come."""
        now = self._steady()
        if now - self.at > _LATE:
            self._caught_up_at = now + _CATCHES_UP
        if now >= self._caught_up_at:
            self.since = self.at
        self.at = now
        self.count += 1
