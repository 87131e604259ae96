"""The routes that the patterns of a link have made."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

import msgspec

from rsb_bridge.link.extension import LinkError
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import acting
from rsb_bridge.model.patterns import GONE_AFTER, ROUTES_BY_PATTERNS, ROUTES_PER_PATTERN
from rsb_bridge.model.snapshot import Level
from rsb_bridge.tasks import MOST_AT_ONCE, in_slices

if TYPE_CHECKING:
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.pattern_matches import PatternEntry, PatternMatches
    from rsb_bridge.link.proposed_routes import ProposedTopics
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.session import Identity, Topic
    from rsb_bridge.route.route import Route

_GONE: Final = f"gone for {GONE_AFTER / 60:g} min"


class PatternRoutes:
    """The routes of one link's patterns, which come and go with the names.

    Attributes:
        gone: routes whose topic or service is gone, each with the time since when.
    """

    def __init__(self, link: BaseLink, table: RouteTable, proposed: ProposedTopics, matches: PatternMatches) -> None:
        self._context = link.context
        self._link = link
        self._table = table
        self._proposed = proposed
        self._matches = matches
        self.gone: dict[Route, float] = {}
        self._to_add: dict[Identity, tuple[PatternEntry, Topic]] = {}  # what has no route yet, in order
        self._logged_full: set[Identity] = set()

    def use(self, entries: list[PatternEntry]) -> None:
        """Follow these patterns from now on; `reconcile` comes next."""
        before = {entry.topic.identity for entry in self._matches.entries if entry.beyond}
        self._matches.use(entries)
        self._to_add = {}  # of the earlier ones
        self._logged_full &= before & {entry.topic.identity for entry in entries}

    def routes_of(self, pattern: Topic) -> tuple[Route, ...]:
        """Return the routes that a pattern has made by now."""
        routes = self._link.routes.values()
        return tuple(route for route in routes if route.pattern and _identity_of(route) == pattern.identity)

    def reconcile(self) -> None:
        """Remove and change routes so that each is of a matching name, and begin to add the others."""
        self._to_add = {}  # which ends the slices of an earlier change of names or patterns
        if not self._matches.entries and not any(route.pattern for route in self._link.routes.values()):
            return
        with acting(""):  # a change of the graph is not an operator's action
            wanted = self._matches.wanted()
            for each in self._matches.entries:
                each.beyond, each.left_out = 0, {}
            self._keep_made(wanted)
            self._add(wanted)

    def _keep_made(self, wanted: dict[Identity, tuple[PatternEntry, Topic]]) -> None:
        """Change the routes that patterns have made to what these say now, and drop routes that no pattern matches."""
        routes = self._link.routes
        # Others are removed by now, or an operator has made entries of their own of them.
        self.gone = {each: at for each, at in self.gone.items() if each.pattern and routes.get(each.key) is each}
        for route in tuple(routes.values()):
            if not route.pattern:
                continue
            if (match := wanted.get(route.spec.identity)) is not None:
                self.gone.pop(route, None)
                self._keep(route, *match)
            elif (entry := self._matches.entry_of(route)) is None:
                self._drop(route, "no pattern matches it any more")
            elif self._matches.names_for(entry) is None:  # unknown, as while the link is down
                self.gone.pop(route, None)
            else:
                self.gone.setdefault(route, self._context.now())

    def _keep(self, route: Route, entry: PatternEntry, topic: Topic) -> None:
        """Change a route to the present values of its pattern."""
        if msgspec.structs.replace(topic, paused=route.spec.paused) != route.spec:  # a pause is the operators'
            try:
                route = self._proposed.replace(route, self._proposed.entry(topic))
            except LinkError as error:
                entry.left_out[topic.topic] = str(error)
        route.pattern = entry.topic.topic  # `replace` takes it for an operator's edit

    def _add(self, wanted: dict[Identity, tuple[PatternEntry, Topic]]) -> None:
        """Add routes for topics without one, within the limits, in slices."""
        counts = Counter(_identity_of(route) for route in self._link.routes.values() if route.pattern)
        taken = {route.spec.identity for route in self._link.routes.values()}
        to_add = self._to_add = {identity: each for identity, each in wanted.items() if identity not in taken}

        def add(each: tuple[PatternEntry, Topic]) -> None:
            if self._to_add is to_add:
                self._add_one(*each, counts)

        async def add_all() -> None:
            await in_slices(to_add.values(), add)
            if self._to_add is to_add:
                self._log_full()

        if len(to_add) > MOST_AT_ONCE:
            self._link.spawn(add_all())
            return
        for each in to_add.values():
            add(each)
        self._log_full()

    def _add_one(self, entry: PatternEntry, topic: Topic, counts: Counter[Identity]) -> None:
        """Add a route of a pattern; if there is no room, in place of the one whose topic has been gone for longest.

        Args:
            counts: the present routes by their patterns.
        """
        of_entry = entry.topic.identity
        is_full = counts[of_entry] >= ROUTES_PER_PATTERN
        if is_full or counts.total() >= ROUTES_BY_PATTERNS:
            fitting = (each for each in self.gone if not is_full or _identity_of(each) == of_entry)
            if (gone := min(fitting, key=self.gone.__getitem__, default=None)) is None:
                entry.beyond += 1
                return
            counts[_identity_of(gone)] -= 1
            self._drop(gone, "gone; its place is needed for others that match")
        try:
            self._proposed.add(topic, by_pattern=True).pattern = entry.topic.topic
        except LinkError as error:
            if not self._proposed.is_bridged(topic):  # under another name on the client
                entry.left_out[topic.topic] = str(error)
        else:
            counts[of_entry] += 1

    def _drop(self, route: Route, reason: str) -> None:
        self.gone.pop(route, None)
        self._table.remove(route, reason, anonymous=True)

    def drop_overdue(self) -> None:
        """Remove routes whose topic has long been gone."""
        if not self.gone:  # as nearly always
            return
        now = self._context.now()
        made = [route for route in self._link.routes.values() if route.pattern]
        over = [route for route in made if now - self.gone.get(route, now) >= GONE_AFTER]
        for route in over:
            self._drop(route, f"{_GONE}; {route.pattern} matches it again once it is back")
        if over:
            self.reconcile()

    def _log_full(self) -> None:
        for entry in self._matches.entries:
            identity, name = entry.topic.identity, entry.topic.topic
            if entry.beyond and identity not in self._logged_full:
                self._logged_full.add(identity)
                text = f"pattern {name}: {limit_reached(entry, len(self.routes_of(entry.topic)))}"
                self._link.log(Level.WARNING, EventCode.LINK_PATTERN_FULL, text, topic=name)
            elif not entry.beyond and identity in self._logged_full:
                self._logged_full.discard(identity)
                text = f"pattern {name}: all that match are bridged"
                self._link.log(Level.INFO, EventCode.LINK_PATTERN_ROOM, text, topic=name)


def _identity_of(route: Route) -> Identity:
    """Return the identity of the pattern that has made a route."""
    return route.spec.kind, route.pattern, route.spec.direction


def limit_reached(entry: PatternEntry, routes: int) -> str:
    """Return how many names exceed which limit, with the remedy."""
    limit = f"{ROUTES_BY_PATTERNS} for all patterns of a link"
    if routes >= ROUTES_PER_PATTERN:
        limit = f"{ROUTES_PER_PATTERN} for a pattern"
    remedy = "make it narrower, leave some out (except), or list them by name"
    return f"{entry.beyond} more match, and are not bridged: the limit is {limit}; {remedy}"
