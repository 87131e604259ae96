"""Locks on resources that only one run of the tests on this machine may use."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from tests.support.waiting import eventually

_DOMAINS = range(2, 80, 2)
"""`tests/network` has 80 and 81, and the demo, which knows nothing of these locks, those above."""
_NONE_FREE = 600.0
"""s that this run waits for others to end."""


def two_domains() -> int:
    """Return the first of two ROS domains that no other run on this machine uses."""
    return locked("domains", _DOMAINS)


@functools.cache
def domains_of(use: str) -> int:
    """Return the first of two domains that this process has for one use: domains of two uses do not meet.

    Args:
        use: ``engines`` (nodes outlive a test), or ``nodes`` or ``programs`` (they end with it). More uses would be
            more domains than there are for 12 workers.
    """
    return two_domains()


def locked(what: str, numbers: Iterable[int]) -> int:
    """Take the first free one of some numbers for as long as this process lives; wait if other runs have them all.

    Raises:
        AssertionError: none became free.
    """
    return eventually(lambda: _locked(what, numbers), _NONE_FREE, f"one of {what} {numbers} free")


def _locked(what: str, numbers: Iterable[int]) -> int | None:
    for number in numbers:
        lock = _opened(f"{what}-{number}")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        return number
    return None


@contextlib.contextmanager
def alone(what: str) -> Iterator[None]:
    """Wait until no other run does the same, and keep others from it meanwhile."""
    lock = _opened(what)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _opened(name: str) -> int:
    return os.open(Path(tempfile.gettempdir()) / f"rsb-console-tests-{name}", os.O_CREAT | os.O_RDWR, 0o666)
