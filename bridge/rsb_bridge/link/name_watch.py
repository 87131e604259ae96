"""Finds what programs publish and provide in this side's ROS graph, by patterns, whenever the graph has changed."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Protocol

from rsb_bridge.model.calls import LANES
from rsb_bridge.model.patterns import is_hidden
from rsb_bridge.model.session import Kind
from rsb_bridge.model.sources import OF_EVERY_NODE
from rsb_bridge.ros.ros_graph import agreed_type, called_in
from rsb_bridge.ros.ros_interface import RosError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.patterns import Pattern
    from rsb_bridge.ros.ros_interface import Endpoint

Named = tuple[Kind, str]
"""Of what, and its name."""
Names = dict[Named, str]
"""What a graph has, with the types."""

_LOOK_EVERY = 1.0
"""s between two looks at the least."""
_SHARE = 20
"""Looking takes at most one part in this many of the time, until the longest pause."""
_LONGEST_PAUSE = 10.0
_ALWAYS_AFTER = 60.0
"""s after which it looks even without a change, in case one was missed."""
_REMEMBERED = 10_000
"""Names of which is known whether a pattern matches."""


class Follower(Protocol):
    """Who follows the graph."""

    def patterns_here(self) -> Collection[tuple[Kind, Pattern]]:
        """What it asks for."""
        ...

    def look(self, names: Names) -> None:
        """See what this graph has now, of what anybody asks for."""
        ...


class _Found(NamedTuple):
    """A name that matches, and who publishes or provides it."""

    named: Named
    type_name: str
    ends: Sequence[Endpoint]


class NameWatch:
    """Looks for all followers at once. A name is held against the patterns once, and not again until those change.

    What only bridges publish or provide is left out, whichever they are, so that no pattern takes back what another
    one, or another bridge, has brought. Whoever wants to hand it on lists it by its name.

    Args:
        context: the engine's.
        followers: gives who follows.
    """

    def __init__(self, context: Context, followers: Callable[[], Iterable[Follower]]) -> None:
        self._context = context
        self._followers = followers
        self._due = asyncio.Event()
        self._asked: frozenset[tuple[Kind, str]] = frozenset()
        self._patterns: dict[Kind, list[Pattern]] = {}
        self._known: dict[Named, bool] = {}

    def changed(self) -> None:
        """The graph has changed, or what a follower asks for. On the I/O thread, as often as one likes."""
        self._due.set()

    async def run(self) -> None:
        """Look, for ever."""
        now = self._context.now
        while True:
            try:
                async with asyncio.timeout(_ALWAYS_AFTER if self._asked else None):
                    await self._due.wait()
            except TimeoutError:
                pass
            self._due.clear()
            began = now()
            await self._look()
            await asyncio.sleep(max(_LOOK_EVERY, min(_LONGEST_PAUSE, (now() - began) * (_SHARE - 1))))

    async def _look(self) -> None:
        self._collect()
        found: list[_Found] = []
        if self._asked:
            try:
                found = await asyncio.to_thread(self._search)
            except RosError:
                return  # it is about to stop
        names = {each.named: each.type_name for each in found if self._is_a_programs(each)}
        for follower in tuple(self._followers()):
            follower.look(names)

    def _collect(self) -> None:
        """Ask followers what they ask for."""
        wanted = {(kind, p.text): p for each in self._followers() for kind, p in each.patterns_here()}
        if wanted.keys() != self._asked:
            self._asked = frozenset(wanted)
            self._known = {}
            self._patterns = {}
            for (kind, _), pattern in wanted.items():
                self._patterns.setdefault(kind, []).append(pattern)

    def _search(self) -> list[_Found]:
        """What matches; on another thread."""
        ros, session = self._context.ros, self._context.session
        own = (session.shutdown_topic, session.diagnostics_topic)
        topics = ros.topics() if "topic" in self._patterns else ()
        found = [
            _Found(("topic", name), agreed_type(publishers)[0], publishers)
            for name in topics
            if name not in own and self._matches(("topic", name)) and (publishers := ros.publishers(name))
        ]
        kinds = [kind for kind in self._patterns if kind != "topic"]
        for entry in called_in(ros, kinds) if kinds else ():
            if entry.publishers and self._matches((entry.kind, entry.topic)):
                servers = ros.servers(entry.topic + LANES[entry.kind][0].suffix)
                found.append(_Found((entry.kind, entry.topic), entry.type_name, servers))
        return found

    def _matches(self, named: Named) -> bool:
        if (known := self._known.get(named)) is not None:
            return known
        if len(self._known) >= _REMEMBERED:
            self._known.clear()
        kind, name = named
        never = is_hidden(name) or name in OF_EVERY_NODE
        self._known[named] = not never and any(each.match(name) is not None for each in self._patterns[kind])
        return self._known[named]

    def _is_a_programs(self, found: _Found) -> bool:
        """Whether a node has it that is known, and no bridge's."""
        announcements = self._context.announcements
        kind, name = found.named
        if kind == "topic":
            origin_of = announcements.origin_of
        else:
            origin_of = partial(announcements.origin_of_server, service=name + LANES[kind][0].suffix)
        return any((origin := origin_of(end)) is not None and not origin.via for end in found.ends)
