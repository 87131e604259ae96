"""Lanes: tests that pytest-xdist runs in one worker, one after the other (``-n N --dist loadscope``).

What only computes has few lanes and a lower priority, and fills the cores while the others wait. Where tests that
talk by DDS starve, one participant of a process may discover another without being discovered by it, for good (seen
once in 700 starts on a core shared by eight). Every other file is a lane of its own.
"""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    import pytest

COMPUTING = {
    "simulation": "simulation",
    **dict.fromkeys(("checks", "cdr", "fuzz"), "checks"),
    **dict.fromkeys(("channel", "config", "model", "route", "wire"), "pure"),
}
ALONE = {"bluetooth", "network", "release"}
"""Folders whose tests share machines, hosts or builds."""
SHARED = {"calls": 3, "simulation": 3}
"""Folders of which all tests need the same processes, or that only compute for long, and so run in a few lanes."""
FIRST = ("simulation", "checks", "pure", *ALONE, "soak", "calls", "tests/system/test_torture.py")
"""What takes the longest: begun late, it has one worker wait at the end while the others have nothing to do."""
_USUAL = os.getpriority(os.PRIO_PROCESS, 0)


def folder_of(nodeid: str) -> str:
    return nodeid.split("/", 2)[1]


def lane_of(nodeid: str) -> str:
    folder, file = folder_of(nodeid), nodeid.split("::", 1)[0]
    if folder in SHARED:
        return f"{folder}/{sum(file.encode()) % SHARED[folder]}"
    if folder in COMPUTING:
        return COMPUTING[folder]
    if folder in ALONE:
        return folder
    return file


def sort_by_lane(items: list[pytest.Item]) -> None:
    """Bring the longest lanes to the front, and spread each other folder's lanes evenly over the rest.

    Tests of the engine wait for DDS, and tests of the console compute. One folder after the other, the cores were idle
    for four fifths of the first one's time, and too few for the second.
    """
    folders: dict[str, dict[str, None]] = {}
    for item in items:
        folders.setdefault(folder_of(item.nodeid), {})[lane_of(item.nodeid)] = None
    places: dict[str, float] = {}
    for folder, lanes in folders.items():
        for number, lane in enumerate(lanes):
            first = next((name for name in (lane, folder) if name in FIRST), None)
            places[lane] = FIRST.index(first) - len(FIRST) if first else (number + 0.5) / len(lanes)
    items.sort(key=lambda item: places[lane_of(item.nodeid)])


def give_way(item: pytest.Item) -> None:
    """Lower this worker's priority for tests that only compute; who is not root cannot raise it again."""
    wanted = max(5, _USUAL) if folder_of(item.nodeid) in COMPUTING else _USUAL
    if os.getpriority(os.PRIO_PROCESS, 0) != wanted:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, wanted)


class Lanes(LoadScopeScheduling):  # type: ignore[misc]
    """Gives the next lane to the first worker that is free."""

    def _split_scope(self, nodeid: str) -> str:
        return lane_of(nodeid)
