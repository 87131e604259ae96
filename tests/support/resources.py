"""Counts the resources of this process."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from tests.support.waiting import eventually


class Resources(NamedTuple):
    """Threads, file descriptors, and resident memory in bytes."""

    threads: int
    descriptors: int
    resident: int


def resources() -> Resources:
    """Return the present counts."""
    threads, descriptors = (len(list(Path(f"/proc/self/{what}").iterdir())) for what in ("task", "fd"))
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return Resources(threads, descriptors, pages * os.sysconf("SC_PAGE_SIZE"))


def returns_to(before: Resources) -> None:
    """Wait until this process has no more threads and descriptors than before.

    Raises:
        AssertionError: it keeps some; it names all threads, which says whose they are.
    """
    try:
        eventually(lambda: all(now <= then for now, then in zip(resources()[:2], before, strict=False)))
    except AssertionError:
        names = sorted((each / "comm").read_text().strip() for each in Path("/proc/self/task").iterdir())
        raise AssertionError(f"{resources()}, and before {before}; threads: {', '.join(names)}") from None
