"""Looks at this side's ROS graph when it has changed: for its routes, and for names that match patterns."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Protocol

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.names import OF_EVERY_NODE
from rsb_bridge.model.patterns import is_hidden
from rsb_bridge.model.session import Kind
from rsb_bridge.ros.ros_graph import agreed_type, called_in
from rsb_bridge.ros.ros_interface import RosError
from rsb_bridge.route.lazy import AwaitedListeners
from rsb_bridge.route.topic_subscription import KeyedRoutes
from rsb_bridge.tasks import in_slices

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.model.patterns import Pattern
    from rsb_bridge.ros.ros_interface import Endpoint
    from rsb_bridge.route.route import Route


class Looks(NamedTuple):
    """The times (s) of regular looks at the graph."""

    every: float  # between two at the least
    share: int  # looking takes at most one part in this many of the time, until the longest pause
    longest_pause: float  # on a slow machine with many names, a new node is bridged so much later at worst
    always_after: float  # without a change, in case one was missed

    def pause(self, cost: float) -> float:
        """Return the time until the next look, after one that took so long."""
        return max(self.every, min(self.longest_pause, cost * (self.share - 1)))


# Round figures, except the first: a robot that starts changes its graph a hundred times a second, and a Followed comes
# once a second at most (PROTOCOL.md, 11).
FOR_ROUTES = Looks(every=0.25, share=10, longest_pause=2.0, always_after=10.0)
FOR_NAMES = Looks(every=1.0, share=20, longest_pause=10.0, always_after=60.0)
_IDLE_EVERY = 6  # looks without a change, after which idle routes look, too
_MATCHED_AFTER = 1.0  # s after the last change: by then DDS has matched the endpoints that discovered each other

Named = tuple[Kind, str]
"""The kind of a name, and the name."""
Names = dict[Named, str]
"""The names of a graph, with their types."""


async def _is_set_within(event: asyncio.Event, seconds: float | None) -> bool:
    """Wait until an event is set, for a time or, with None, for ever."""
    try:
        async with asyncio.timeout(seconds):
            await event.wait()
    except TimeoutError:
        return False
    return True


class GraphWatch:
    """Advances all open routes: soon after a change of the graph, again when it has settled, and now and then.

    It advances few at a time, so that no message waits.

    Args:
        look_for_names: starts the search for names after a change.

    Attributes:
        changes: number of looks after changes so far. A look at the graph after this has grown sees what had changed.
    """

    def __init__(
        self, context: Context, links: Callable[[], Iterable[BaseLink]], look_for_names: Callable[[], None]
    ) -> None:
        self._context = context
        self._links = links
        self._look_for_names = look_for_names
        self.changes = 0
        self._due = asyncio.Event()
        self._noted = False
        self._looks = 0
        self._settled: asyncio.TimerHandle | None = None
        self._awaited = context.shared(AwaitedListeners)
        self._keyed = context.shared(KeyedRoutes)
        self._keyed_noted = False

    def changed(self) -> None:
        """Look soon: the graph has changed. May be called from any thread."""
        if self._keyed and not self._keyed_noted:
            self._keyed_noted = True
            self._context.call(self._advance_keyed)
        if not self._noted:  # a robot that starts reports a hundred changes a second, each of which would wake the loop
            self._noted = True
            self._context.call(self._advance_soon)

    async def run(self) -> None:
        """Look again and again, for ever."""
        try:
            while True:
                if changed := await _is_set_within(self._due, FOR_ROUTES.always_after):
                    self._look_for_names()  # not after a timeout: `NameWatch` has one of its own
                # Before the look: routes that have been asked already have to look again after a further change.
                self._due.clear()
                self._noted = False
                self.changes += changed
                self._looks += 1
                cost = await self._advance_routes(idle=changed or not self._looks % _IDLE_EVERY)
                await asyncio.sleep(FOR_ROUTES.pause(cost))
        finally:
            if self._settled is not None:
                self._settled.cancel()

    def _advance_soon(self) -> None:
        self._due.set()
        self._awaited.graph_changed()
        if self._settled is not None:
            self._settled.cancel()
        self._settled = self._context.loop.call_later(_MATCHED_AFTER, self._due.set)

    def _advance_keyed(self) -> None:
        """Advance the routes that a new publisher endangers at once."""
        self._keyed_noted = False
        self._context.announcements.update()
        for link in self._links():
            for route in self._keyed & {*link.routes.values()}:
                link.guarded(route.advance)

    async def _advance_routes(self, *, idle: bool) -> float:
        """Advance routes in slices; return the seconds that this took of the loop.

        Args:
            idle: whether idle ones look, too.
        """
        now, cost = self._context.now, 0.0
        self._context.announcements.update()  # first: routes ask it which publishers are bridges

        def advance(of: tuple[BaseLink, Route]) -> None:
            nonlocal cost
            link, route = of
            if route.id:  # one of the slices before may have closed it
                began = now()
                link.guarded(route.advance)
                cost += now() - began

        routes = [(link, each) for link in self._links() for each in link.routes.values() if idle or not each.idle]
        await in_slices(routes, advance)
        return cost


class Follower(Protocol):
    """A user of the graph's names."""

    def patterns_here(self) -> Collection[tuple[Kind, Pattern]]:
        """Return the patterns of the names that it wants."""

    def update_names(self, names: Names) -> None:
        """Take the present names of the graph that match any follower's patterns."""


class _Found(NamedTuple):
    """A name that matches."""

    named: Named
    type_name: str
    ends: Sequence[Endpoint]  # its publishers or providers


class NameWatch:
    """Searches the graph for all followers at once. A name is matched once, and again only if the patterns change.

    Names that only bridges publish or provide are left out, so that no pattern returns what another pattern or another
    bridge has brought. To pass such a topic on, list it by its name.
    """

    def __init__(self, context: Context, followers: Callable[[], Iterable[Follower]]) -> None:
        self._context = context
        self._followers = followers
        self._due = asyncio.Event()
        self._asked: frozenset[tuple[Kind, str]] = frozenset()
        self._patterns: dict[Kind, list[Pattern]] = {}
        self._known: dict[Named, bool] = {}

    def changed(self) -> None:
        """Search soon: the graph or a follower's patterns have changed. Call it on the I/O thread."""
        self._due.set()

    async def run(self) -> None:
        """Search again and again, for ever."""
        now = self._context.now
        while True:
            await _is_set_within(self._due, FOR_NAMES.always_after if self._asked else None)
            self._due.clear()  # before the look: a change meanwhile calls for another one
            began = now()
            await self._search_graph()
            await asyncio.sleep(FOR_NAMES.pause(now() - began))

    async def _search_graph(self) -> None:
        wanted = {(kind, p.text): p for each in self._followers() for kind, p in each.patterns_here()}
        if wanted.keys() != self._asked:
            self._asked = frozenset(wanted)
            self._known = {}
            self._patterns = {}
            for (kind, _), pattern in wanted.items():
                self._patterns.setdefault(kind, []).append(pattern)
        found: list[_Found] = []
        if self._asked:
            try:
                found = await asyncio.to_thread(self._search)
            except RosError:
                return  # it is about to stop
        names = {each.named: each.type_name for each in found if self._is_a_programs(each)}
        for follower in tuple(self._followers()):
            follower.update_names(names)

    def _search(self) -> list[_Found]:
        """Return what matches. Runs on another thread."""
        ros, session = self._context.ros, self._context.session
        before, self._known = self._known, {}  # which names match; names that are gone are forgotten
        own = session.own_topics
        topics = ros.topics() if "topic" in self._patterns else ()
        found = [
            _Found(("topic", name), agreed_type(publishers)[0], publishers)
            for name in topics
            if name not in own and self._matches(("topic", name), before) and (publishers := ros.publishers(name))
        ]
        kinds = [kind for kind in self._patterns if kind != "topic"]
        for entry in called_in(ros, kinds) if kinds else ():
            if entry.publishers and self._matches((entry.kind, entry.topic), before):
                servers = ros.servers(entry.topic + LANES[entry.kind][0].suffix)
                found.append(_Found((entry.kind, entry.topic), entry.type_name, servers))
        return found

    def _matches(self, named: Named, before: dict[Named, bool]) -> bool:
        matches = before.get(named)
        if matches is None:
            kind, name = named
            never = is_hidden(name) or name in OF_EVERY_NODE
            matches = not never and any(each.match(name) is not None for each in self._patterns[kind])
        self._known[named] = matches
        return matches

    def _is_a_programs(self, found: _Found) -> bool:
        """Whether a known node that is no bridge has the name."""
        announcements = self._context.announcements
        kind, name = found.named
        if kind == "topic":
            origin_of = announcements.origin_of
        else:
            origin_of = partial(announcements.origin_of_server, service=name + LANES[kind][0].suffix)
        # A bridge's own topic, such as its diagnostics, crosses as a node's does, but not for its own sake.
        ends = (end for end in found.ends if end.node.lstrip("/") not in announcements.bridges)
        return any((origin := origin_of(end)) is not None and not origin.via for end in ends)
