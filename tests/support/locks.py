"""What one run of these tests has for itself while others run on this machine."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


_DOMAINS = range(22, 60, 2)


def two_domains() -> int:
    """The first of two ROS domains that no other run on this machine uses.

    Raises:
        AssertionError: others have them all.
    """
    return locked("domains", _DOMAINS)


def locked(what: str, numbers: Iterable[int]) -> int:
    """The first of some numbers that no other run has taken; it is this process's as long as that lives.

    Raises:
        AssertionError: others have them all.
    """
    for number in numbers:
        lock = _opened(f"{what}-{number}")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        return number
    raise AssertionError(f"{what} {numbers} are all in use by other runs of these tests")


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
