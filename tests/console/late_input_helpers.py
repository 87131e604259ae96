"""Helpers of `test_late_input` and others."""

from __future__ import annotations


class Time:
    """A clock that tests set."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now
