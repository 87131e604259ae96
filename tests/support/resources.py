"""Counts the resources of this process."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple


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
