"""How long to wait between attempts that may fail for ever."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from random import Random


class Backoff:
    """Gives the delay before each next attempt: it doubles up to `longest`, and stays there however many follow.

    Args:
        first: the first delay, in seconds.
        longest: the longest, in seconds; jitter comes on top.
        random: varies each delay, so that many who fail together do not try again together; None: no jitter.
        jitter: the largest variation, as a share of the delay.
    """

    def __init__(self, first: float, longest: float, random: Random | None = None, jitter: float = 0.2) -> None:
        self._first = self._next = first
        self._longest = longest
        self._random = random
        self._jitter = jitter

    def next(self, at_most: float = math.inf) -> float:
        """The delay (s) before the next attempt.

        Args:
            at_most: the longest delay this time, where it is to be shorter.
        """
        delay = min(self._next, at_most)
        self._next = min(2 * self._next, self._longest)
        if self._random is None:
            return delay
        return delay * self._random.uniform(1 - self._jitter, 1 + self._jitter)

    def reset(self) -> None:
        """An attempt succeeded: begin with the first delay again."""
        self._next = self._first
