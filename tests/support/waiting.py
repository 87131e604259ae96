"""Waiting for what threads and other processes do: a condition with a deadline, never a sleep for a guess."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TypeAlias, TypeVar

T = TypeVar("T")
Condition: TypeAlias = "Callable[..., T | None]"
"""Called without arguments; in a loop it binds the loop's variables by defaults, which `Callable[[], T]` forbids."""


def pauses() -> Iterator[float]:
    """Yield the pauses between looks, in s: short ones at first, as each look may take a snapshot or draw a screen."""
    pause = 0.005
    while True:
        yield pause
        pause = min(1.5 * pause, 0.05)


def eventually(condition: Condition[T], within: float = 180.0, what: str = "") -> T:
    """Wait until a condition gives something true, and return that.

    The deadline is for what never comes; how fast it comes is the machine's affair.

    Raises:
        AssertionError: it did not within `within` s.
    """
    deadline, pause = time.monotonic() + within, pauses()
    while not (found := condition()):
        assert time.monotonic() < deadline, f"not within {within:g} s: {what or 'the condition'}"
        time.sleep(next(pause))
    return found


def holds(condition: Callable[[], object], seconds: float) -> None:
    """Watch that a condition stays true for so long.

    Raises:
        AssertionError: it did not.
    """
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        assert condition(), "it no longer holds"
        time.sleep(0.01)
