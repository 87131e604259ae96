"""What latched topics' publishers keep for late joiners, counted: what is small on the wire may be large here."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rsb_bridge.wire.budget import Budget

LATCHED_LIMIT = 1 << 30
"""Bytes that all latched topics of a link keep together: one of the longest messages at the usual depth is 640 MiB."""


class Latched:
    """The sizes of the messages in one publisher's history."""

    def __init__(self, budget: Budget, depth: int) -> None:
        """Begin with none.

        Args:
            budget: of the publisher's link.
            depth: messages that the publisher keeps; the oldest give way.
        """
        self._budget = budget
        self._depth = depth
        self._sizes: deque[int] = deque()

    def keep(self, size: int) -> bool:
        """Have a message of `size` bytes kept; False: the link's latched topics keep too much, so do not publish it."""
        full = len(self._sizes) == self._depth
        if not self._budget.take(size - self._sizes[0] if full else size):
            return False
        if full:
            self._sizes.popleft()
        self._sizes.append(size)
        return True

    def clear(self) -> None:
        """The publisher is gone, and its history with it."""
        self._budget.give(sum(self._sizes))
        self._sizes.clear()
