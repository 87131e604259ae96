"""Keeps the snapshot for user interfaces up to date while they look at it, without delaying messages."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import math
import threading
from collections import deque
from typing import TYPE_CHECKING, Protocol, TypeVar

from rsb_bridge.model.snapshot import LinkSnapshot, RouteSnapshot, State
from rsb_bridge.model.verdict import Cause, LinkCause
from rsb_bridge.tasks import in_slices
from rsb_bridge.telemetry.acknowledgements import Acknowledgements

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from rsb_bridge.model.clock import Clock
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.model.snapshot import RefusedClient, Snapshot
    from rsb_bridge.telemetry.event_log import EventLog

# Routes renewed in one refresh, at the least, in some 6 ms by slices of 1 ms (`tasks.SLICE`); the others follow.
# Refreshes until each had its turn, while somebody looks at more than so many: then no route's is older than a second.
_AT_ONCE, _REFRESHES = 128, 4
# s between two looks of somebody who goes on looking: until so long after the second, all is renewed. A log's status
# line each 5 s waits for its own renewal instead.
_LOOKED_AT_FOR = 2.0
_SELDOM = 1.5  # Hz; somebody who looks no more often, as a log does once a second, is content with one renewal a second
_EVERY, _EVERY_LOOKED_AT = 1.0, 0.25  # s from one renewal to the next
_CLOCK_SET = 0.1  # s by which the shown times of routes to which nothing happens may be wrong
_CAUGHT_UP_WITHIN = 0.5  # s that the first look after a while waits; 1,000 routes take 0.05 s. A round figure
# Renewals while nobody looks until each route's figures had their turn. The history adds them up by the minute: what
# falls into the next one is a twelfth at most, or a sixth where the other side's counts are as old (`idling`).
_FIGURES_EVERY = 5
_HANGS_AFTER = 10.0  # s without a renewal. A round figure: on a busy machine, threads were seen to stand still for 3 s
# s that a timer may come early. Without it, such a turn would be counted as the one before, and done twice.
_EARLY = 0.01


class ShownRoute(Protocol):
    """A route, as far as its snapshot goes."""

    def snapshot(self) -> RouteSnapshot:
        """Return the route as it is now."""

    purpose: Purpose

    @property
    def shows_the_same(self) -> bool:
        """Whether its snapshot stays the same until something happens to it."""

    @property
    def only_counts(self) -> bool:
        """Whether nothing but figures may differ from its last snapshot."""


class ShownLink(Protocol):
    """A link, as the publisher sees it."""

    @property
    def routes(self) -> Mapping[str, ShownRoute]:
        """Its routes, by key."""

    @property
    def awake(self) -> Collection[ShownRoute]:
        """The routes that may have changed."""

    @property
    def changes(self) -> int:
        """How many routes have come or gone so far."""

    @property
    def only_counts(self) -> bool:
        """Whether nothing but figures may differ from its last snapshot."""

    def snapshot(self) -> LinkSnapshot:
        """Return the link as it is now."""


_Shown = TypeVar("_Shown", ShownRoute, ShownLink)


class ShownBridge(Protocol):
    """A bridge, as the publisher sees it."""

    def links(self) -> Sequence[ShownLink]:
        """Return all links, up or down."""

    def refused(self) -> tuple[RefusedClient, ...]:
        """Return the refused clients."""

    @property
    def unsaved(self) -> bool:
        """Whether the running session differs from its file."""


class SnapshotPublisher:
    """Renews the snapshot: all of it for somebody who looks, else what has changed, once a second, for the record.

    Attributes:
        latest: the newest snapshot; replaced, never changed, so that any thread may read it. While nobody looks, the
            figures of a route or a link may be `_FIGURES_EVERY` s old, and idle routes are as they were when they
            became so.
    """

    def __init__(self, blank: Snapshot, events: EventLog, clock: Clock) -> None:
        self.latest = blank
        self.acknowledged = Acknowledgements(clock, events)
        self._events = events
        self._clock = clock
        self._routes: dict[ShownRoute, RouteSnapshot] = {}
        self._shown: tuple[RouteSnapshot, ...] = ()  # of these, the same object while nothing is renewed
        self._renewed = False  # since then
        self._changes: list[tuple[ShownLink, int]] = []  # of the links' routes, until then
        self._links: dict[ShownLink, LinkSnapshot] = {}
        self._same: set[ShownRoute] = set()  # those whose snapshot was made when it was to stay the same
        self._offset = 0.0  # s, of the wall clock, which snapshots tell times by, to the steady one
        self._looks = 0
        self._looks_at: deque[tuple[float, int]] = deque()
        self._looked_at = self._looked_again_at = -math.inf  # s, of the last look, and of the last soon after another
        self._turn = 0  # of the next route to renew
        self._refreshes = 0
        self._published_at = clock.steady()
        self._is_watched = False  # by somebody who looks more often than once a second
        self._catch_up: Callable[[threading.Event], object] | None = None
        self._waiting: list[threading.Event] = []  # of threads that have only begun to look

    def newest(self) -> Snapshot:
        """Return the newest snapshot, once it has all of the present; called on any thread.

        If it is old, the I/O thread hangs, in the middleware, say. Nothing else of an engine would show that.
        """
        self._looks += 1
        before, again, now = self._looked_at, self._looked_again_at, self._clock.steady()
        self._looked_at = now
        if now - before <= _LOOKED_AT_FOR:
            self._looked_again_at = now
        if now - again > _LOOKED_AT_FOR and self._catch_up is not None:
            caught_up = threading.Event()
            self._catch_up(caught_up)
            caught_up.wait(_CAUGHT_UP_WITHIN)
        latest = self.latest
        silent = self._clock.steady() - self._published_at
        if not latest.running or silent < _HANGS_AFTER:
            return latest
        reason = f"this bridge hangs: it has done nothing for {silent:.0f} s; restart it"
        hangs = out_of_reach(latest, reason, since=latest.time, now=latest.time + silent)
        return dataclasses.replace(hangs, running=True)

    @property
    def is_looked_at(self) -> bool:
        """Whether somebody goes on looking; may be asked on any thread."""
        return self._clock.steady() - self._looked_again_at <= _LOOKED_AT_FOR

    def looked_at(self, now: float) -> bool:
        """Whether somebody looks more often than once a second, as far as the calls of this show.

        Args:
            now: s; later than in the call before.
        """
        self._looks_at.append((now, self._looks))
        while len(self._looks_at) > 1 and self._looks_at[1][0] <= now - _LOOKED_AT_FOR:
            self._looks_at.popleft()
        since, looks = self._looks_at[0]
        return self._looks - looks > _SELDOM * (now - since)

    async def run(self, bridge: ShownBridge) -> None:
        """Renew the snapshot for ever: four times a second while somebody looks often, else once a second.

        It keeps the time of other regular work that began with it: each wake-up costs more than what is done in it.
        """
        loop, thread, wanted = asyncio.get_running_loop(), threading.get_ident(), asyncio.Event()

        def catch_up(caught_up: threading.Event) -> None:
            if threading.get_ident() == thread:  # it cannot wait for itself
                self.refresh_now(bridge)
                caught_up.set()
                return
            self._waiting.append(caught_up)
            try:
                loop.call_soon_threadsafe(wanted.set)
            except RuntimeError:  # it has ended
                caught_up.set()

        self._catch_up = catch_up
        began = loop.time()
        while True:
            await self.refresh(bridge)
            self._is_watched = self.looked_at(loop.time())
            every = _EVERY_LOOKED_AT if self._is_watched else _EVERY
            turns = math.floor((loop.time() - began + _EARLY) / every) + 1
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(began + turns * every):
                    await wanted.wait()
            wanted.clear()

    async def refresh(self, bridge: ShownBridge) -> None:
        """Renew the links, new routes, and of the others all, or some in turn where they follow soon."""
        # In this order: a look that is not among the waiting ones is seen by the next line.
        waiting, self._waiting = self._waiting, []
        self._refreshes += 1
        looked_at = bool(waiting) or self.is_looked_at
        links = bridge.links()
        self._notice_clock()
        if looked_at:
            turn = [each for each in _routes_of(links) if each not in self._same or not each.shows_the_same]
        else:
            awake = [each for link in links for each in link.awake if each.purpose.is_shown]
            turn = self._for_the_record(awake, self._routes)
        new = [route for route in turn if route not in self._routes]
        if (self._is_watched and not waiting) or not looked_at:
            at_once = min(len(turn), max(_AT_ONCE, -(-len(turn) // _REFRESHES)))
            self._turn, first = self._turn + at_once, self._turn
            turn = [turn[(first + i) % len(turn)] for i in range(at_once)]
        await in_slices(turn, self._renew)
        await in_slices([route for route in new if route not in self._routes], self._renew)
        await in_slices(links if looked_at else self._for_the_record(links, self._links), self._renew_link)
        self._publish(bridge, running=True, unsaved=bridge.unsaved if looked_at else self.latest.unsaved)
        for each in waiting:
            each.set()

    def _for_the_record(self, awake: Sequence[_Shown], known: Collection[_Shown]) -> list[_Shown]:
        """Return the routes or links to renew while nobody looks: what changed, and some of the others in turn."""
        return [
            each
            for number, each in enumerate(awake)
            if (number + self._refreshes) % _FIGURES_EVERY == 0 or each not in known or not each.only_counts
        ]

    async def refresh_all(self, bridge: ShownBridge) -> None:
        """Renew everything: after a command, whose outcome a user waits for."""
        links = bridge.links()
        await in_slices(_routes_of(links), self._renew)
        await in_slices(links, self._renew_link)
        if self.latest.running:  # else the bridge has ended meanwhile
            self.publish(bridge)

    def refresh_now(self, bridge: ShownBridge, *, running: bool = True) -> None:
        """Renew everything in one turn of the loop; `running`: whether any are to follow."""
        links = bridge.links()
        for route in _routes_of(links):
            self._renew(route)
        self._links = {link: link.snapshot() for link in links}
        self._publish(bridge, running=running, unsaved=bridge.unsaved)
        if not running:
            self._catch_up = None
            for each in self._waiting:
                each.set()

    def refresh_route(self, bridge: ShownBridge, link: ShownLink, route: ShownRoute) -> None:
        """Renew one route, after a command about it."""
        self._renew(route)
        if link not in self._links:  # it is shown with its route
            self._renew_link(link)
        self.publish(bridge)

    def publish(self, bridge: ShownBridge) -> None:
        """Publish what was renewed last, after a command that changes neither links nor routes."""
        self._publish(bridge, running=True, unsaved=bridge.unsaved)

    def _notice_clock(self) -> None:
        """Renew all where the wall clock was set; also, after hours, where it drifts."""
        offset = self._clock.time_ns() / 1e9 - self._clock.steady()
        if abs(offset - self._offset) > _CLOCK_SET:
            self._offset = offset
            self._same.clear()

    def _renew(self, route: ShownRoute) -> None:
        self._routes[route], self._renewed = route.snapshot(), True
        if route.shows_the_same:
            self._same.add(route)
        else:
            self._same.discard(route)

    def _renew_link(self, link: ShownLink) -> None:
        self._links[link] = link.snapshot()

    def _publish(self, bridge: ShownBridge, *, running: bool, unsaved: bool) -> None:
        """Publish the renewed links and routes that still exist; new ones follow in the next refresh.

        Args:
            unsaved: whether the session differs from its file; to compare them takes a while.
        """
        # Between the slices of a refresh, links and routes come and go.
        present = bridge.links()
        self._links = {link: self._links[link] for link in present if link in self._links}
        now, self._published_at = self._clock.time_ns() / 1e9, self._clock.steady()
        changes = [(link, link.changes) for link in present]
        if self._renewed or changes != self._changes:
            self._renewed, self._changes = False, changes
            # Nothing else lets go of a removed route.
            self._routes = {route: self._routes[route] for route in _routes_of(present) if route in self._routes}
            self._same.intersection_update(self._routes)
            self._shown = tuple(self._routes.values())
        links, routes = self.acknowledged.mark(self._links.values(), self._shown, now)
        # A client with several ways to its server calls the one that its link has used last.
        called = links[0].peer if links and self.latest.role == "client" else self.latest.address
        self.latest = dataclasses.replace(
            self.latest,
            time=now,
            address=called,
            running=running,
            links=links,
            routes=routes,
            last_event=self._events.last,
            refused=bridge.refused(),
            unsaved=unsaved,
        )


def _routes_of(links: Sequence[ShownLink]) -> list[ShownRoute]:
    return [route for link in links for route in link.routes.values() if route.purpose.is_shown]


def out_of_reach(shown: Snapshot, reason: str, *, since: float, now: float) -> Snapshot:
    """Return the snapshot to show of a bridge that is out of reach: everything is down.

    Args:
        reason: the reason that the bridge is out of reach.
        since: s since the epoch of the last contact.
        now: s since the epoch.
    """
    return dataclasses.replace(
        shown,
        time=now,
        running=False,
        refused=(),
        links=tuple(
            dataclasses.replace(
                link, state=State.DOWN, cause=LinkCause.UNREACHABLE, reason=reason, warning="", since=since,
                retry_in=None, association_ends=None, rtt=None, loss_out=None, loss_in=None, rx_bytes_per_second=0.0,
                tx_bytes_per_second=0.0, clock_offset=None, clock_uncertainty=None, full_out=None, full_in=None,
                via="", ways=(),
            )
            for link in shown.links
        ),
        routes=tuple(
            dataclasses.replace(
                route, state=State.DOWN, cause=Cause.LINK_DOWN, reason=reason, from_peer=False, since=since,
                rate=0.0, bytes_per_second=0.0,
            )
            for route in shown.routes
        ),
    )  # fmt: skip
