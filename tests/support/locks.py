"""What one run of these tests has for itself, as long as its process lives, while others run on this machine."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


def locked(what: str, numbers: Iterable[int]) -> int:
    """The first of some numbers that no other run has taken.

    Raises:
        AssertionError: others have them all.
    """
    for number in numbers:
        path = Path(tempfile.gettempdir()) / f"rsb-console-tests-{what}-{number}"
        lock = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)  # it stays open: the lock goes with the process
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        return number
    raise AssertionError(f"{what} {numbers} are all in use by other runs of these tests")
