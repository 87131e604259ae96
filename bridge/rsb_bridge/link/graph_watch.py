"""Has routes look at the ROS graph when it has changed, few enough at a time that no message waits."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rsb_bridge.tasks import SLICE

if TYPE_CHECKING:
    from collections.abc import Callable

    from rsb_bridge.context import Context
    from rsb_bridge.link.link import Link

_LOOK_EVERY = 0.25
"""s between two looks at the least; a robot that starts changes its graph a hundred times a second."""
_SHARE = 10
"""Looking takes at most one part in this many of the time, however many routes there are, until the longest pause."""
_LONGEST_PAUSE = 2.0
"""s. A round figure: on a slow machine with many routes, a new node is bridged so much later at worst."""
_MATCHED_AFTER = 1.0
"""s after the last change: by then DDS has matched the endpoints that discovered each other."""
_ALWAYS_AFTER = 10.0
"""s after which routes look even without a change, in case one was missed. A round figure."""


class GraphWatch:
    """Advances all open routes: soon after a change of the graph, again when it has settled, and now and then.

    Args:
        look_for_names: starts the search for names after a change.
    """

    def __init__(self, context: Context, links: Callable[[], list[Link]], look_for_names: Callable[[], None]) -> None:
        self._context = context
        self._links = links
        self._look_for_names = look_for_names
        self._due = asyncio.Event()
        self._noted = False
        self._settled: asyncio.TimerHandle | None = None

    def changed(self) -> None:
        """Look soon: the graph has changed. May be called from any thread."""
        if not self._noted:  # a robot that starts reports a hundred changes a second, each of which would wake the loop
            self._noted = True
            self._context.call(self._advance_soon)

    async def run(self) -> None:
        """Look again and again, for ever."""
        try:
            while True:
                try:
                    async with asyncio.timeout(_ALWAYS_AFTER):
                        await self._due.wait()
                except TimeoutError:
                    pass
                else:
                    self._look_for_names()  # not after a timeout: `name_watch` has one of its own
                # Before the look: routes that have been asked already have to look again after a further change.
                self._due.clear()
                self._noted = False
                cost = await self._advance_routes()
                await asyncio.sleep(max(_LOOK_EVERY, min(_LONGEST_PAUSE, cost * (_SHARE - 1))))
        finally:
            if self._settled is not None:
                self._settled.cancel()

    def _advance_soon(self) -> None:
        self._due.set()
        if self._settled is not None:
            self._settled.cancel()
        self._settled = self._context.loop.call_later(_MATCHED_AFTER, self._due.set)

    async def _advance_routes(self) -> float:
        """Advance all routes in slices; return the seconds that this took of the loop."""
        now, cost = self._context.now, 0.0
        self._context.announcements.update()  # first: routes ask it which publishers are bridges
        for link in self._links():
            routes = tuple(link.routes.values())
            for first in range(0, len(routes), SLICE):
                began = now()
                for route in routes[first : first + SLICE]:
                    if route.id:  # one of the slices before may have closed it
                        link.guarded(route.advance)
                cost += now() - began
                await asyncio.sleep(0)
        return cost
