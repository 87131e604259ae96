"""The moment between a disarm and its effect on the other side.

A sending half stops at once, but the other side may still publish earlier messages. That ends when the other side
answers that it has disarmed, too, and at the latest when the lease of the last message has run out.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Settling:
    """One route's. It outlives the opening that was disarmed.

    Args:
        loop: the I/O loop.
        changed: called when it begins and ends.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, changed: Callable[[], None]) -> None:
        self._loop = loop
        self._changed = changed
        self._route_id = 0
        self._timer: asyncio.TimerHandle | None = None
        self._then: list[Callable[[], None]] = []

    @property
    def under_way(self) -> bool:
        """Whether something that was sent may still be published."""
        return self._timer is not None

    def begin(self, route_id: int, seconds: float) -> None:
        """Begin for an opening, for so many seconds at most."""
        if seconds <= 0:
            return
        if self._timer is not None:
            self._timer.cancel()
        self._route_id = route_id
        self._timer = self._loop.call_later(seconds, self._end)
        self._changed()

    def answered(self, route_id: int) -> None:
        """Note that the other side publishes nothing more of an opening."""
        if self._timer is not None and route_id == self._route_id:
            self._timer.cancel()
            self._end()

    def then(self, work: Callable[[], None]) -> None:
        """Do something once nothing can be published any more, which may be now."""
        if self._timer is None:
            work()
        else:
            self._then.append(work)

    async def wait(self) -> None:
        """Return once nothing can be published any more."""
        over = asyncio.Event()
        self.then(over.set)
        await over.wait()

    def _end(self) -> None:
        self._timer = None
        then, self._then = self._then, []
        self._changed()
        for work in then:
            work()
