"""No turn of an engine's loop has the work of hundreds of routes. It is counted in calls: in here no time passes."""

from __future__ import annotations

import asyncio
import sys
from collections import Counter
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from tests.simulation.beds import Yard, until
from tests.support import replaced

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

    from tests.simulation.loop import SimulatedLoop

NAMES = tuple(f"/topic{number}" for number in range(200))
MOST_CALLS = 6000
"""Of one callback. A slice of 20 routes that open has 4,900, and work on all 200 of them 30 a route."""
KNOWN = {
    "SnapshotPublisher.refresh_now",  # after a start and each command
    "RouteTable.disconnected",  # nothing of a lost link may be left when it comes back
    "Invariants.check",  # the world's own work
}
"""Functions in whose callbacks so many calls are known of."""
_COMPREHENSIONS = {"<listcomp>", "<dictcomp>", "<setcomp>"}
"""Of Python 3.11 alone; later ones make no call of them."""
_WITHIN = 60.0


class Turns:
    """Counts the calls of Python functions in each callback of a loop.

    Attributes:
        longest: the calls of the callback with the most of them, by function.
    """

    def __init__(self, loop: SimulatedLoop) -> None:
        self.longest: Counter[str] = Counter()
        self._loop = loop
        self._callback = loop.callbacks
        self._calls: Counter[str] = Counter()

    def called(self, frame: FrameType, event: str, _: Any) -> None:
        """Count a call; a profiler of `sys.setprofile`."""
        if event != "call":
            return
        if self._loop.callbacks != self._callback:
            if self._calls.total() > self.longest.total() and KNOWN.isdisjoint(self._calls):
                self.longest = self._calls
            self._calls, self._callback = Counter(), self._loop.callbacks
        if frame.f_code.co_name not in _COMPREHENSIONS:
            self._calls[frame.f_code.co_qualname] += 1


@contextmanager
def counted(yard: Yard) -> Iterator[Turns]:
    turns = Turns(yard.world.loop)
    before = sys.getprofile()
    sys.setprofile(turns.called)
    try:
        yield turns
    finally:
        sys.setprofile(before)


async def _all_connected(yard: Yard, count: int) -> None:
    def connected() -> bool:
        return sum(route.connected for route in yard.routes().values()) == count

    await until(connected, _WITHIN)


async def _live(yard: Yard, count: int) -> None:
    """Let routes open, tick and be reported; let the graph change, and the link be lost and come back."""
    await _all_connected(yard, count)
    await asyncio.sleep(1.5)
    yard.publish("/one_more")
    await asyncio.sleep(1.5)
    yard.link().fail()
    await asyncio.sleep(0.1)
    await _all_connected(yard, count)
    await asyncio.sleep(1.5)


@pytest.fixture(autouse=True, scope="module")
def _imported() -> None:
    """Import and cache before anything is counted what the first route of a process does."""
    yard = Yard(Topic(NAMES[0], "transmit"))
    yard.publish(NAMES[0])
    yard.world.play(life=_live(yard, 1))


def played(yard: Yard, count: int) -> Turns:
    yard.publish(*NAMES)
    with counted(yard) as turns:
        yard.world.play(life=_live(yard, count))
    return turns


def test_hundreds_of_topics_make_no_long_turn() -> None:
    turns = played(Yard(*(Topic(name, "transmit") for name in NAMES)), len(NAMES))
    assert turns.longest.total() <= MOST_CALLS, turns.longest.most_common(10)


def test_patterns_of_hundreds_of_names_make_no_long_turn() -> None:
    turns = played(Yard(Topic("/topic*", "transmit"), Topic("/topic1*", "transmit", excepts=("/topic12",))), 100)
    assert turns.longest.total() <= MOST_CALLS, turns.longest.most_common(10)


def test_long_turn_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    async def at_once(items: Any, work: Any) -> None:
        for item in items:
            work(item)

    replaced.IN_SLICES_OF_OPENINGS.set(monkeypatch, at_once)
    turns = played(Yard(*(Topic(name, "transmit") for name in NAMES)), len(NAMES))
    assert turns.longest.total() > MOST_CALLS
