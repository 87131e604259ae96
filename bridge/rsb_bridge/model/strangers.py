"""The memory that strangers may take. A stranger is a peer or an operator that has not proven its key yet."""

from __future__ import annotations

import threading

LIMIT = 16 * 1024 * 1024
"""Bytes of all strangers of an engine together."""
CONNECTION = 16 * 1024
"""Bytes counted for a connection: its 4 KiB, and what keeps track of it."""


class Strangers:
    """The budget of all strangers of an engine, over all transports. Used on any thread.

    Attributes:
        turned_away: connections closed and samples dropped so far: the budget was spent, or they were too long.
    """

    def __init__(self, limit: int = LIMIT) -> None:
        self.turned_away = 0
        self._limit = limit
        self._used = 0
        self._counting = threading.Lock()

    @property
    def used(self) -> int:
        """Bytes counted now."""
        return self._used

    def take(self, size: int) -> bool:
        """Count some bytes, unless the budget is spent. Return whether they are counted."""
        with self._counting:
            if self._used + size > self._limit:
                self.turned_away += 1
                return False
            self._used += size
            return True

    def turn_away(self) -> None:
        """Count something that was dropped unread."""
        with self._counting:
            self.turned_away += 1

    def give(self, size: int) -> None:
        """Give bytes back."""
        with self._counting:
            self._used -= size
