"""The patterns that this side of a link proposes: each name that matches gets a route, for as long as it is there."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, Final

import msgspec

from rsb_bridge.config.rights import Use, as_if_listed, uses
from rsb_bridge.link.errors import LinkError
from rsb_bridge.link.following import FollowedByPeer
from rsb_bridge.link.pattern_entry import PatternEntry
from rsb_bridge.link.pattern_snapshots import exceptions_reached, limit_reached
from rsb_bridge.model.calls import LANES
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.operators import acting
from rsb_bridge.model.patterns import (
    FEATURE,
    GONE_AFTER,
    NAMES_FOLLOWED,
    PATTERNS_PER_LINK,
    ROUTES_BY_PATTERNS,
    ROUTES_PER_PATTERN,
)
from rsb_bridge.model.snapshot import Level
from rsb_bridge.wire.messages import Follow, NamePattern, Welcome

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from rsb_bridge.config.rights import Rights
    from rsb_bridge.link.link import Link
    from rsb_bridge.link.name_watch import Names
    from rsb_bridge.model.patterns import Pattern
    from rsb_bridge.model.session import Identity, Kind, Topic
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.messages import Followed

_REMEMBERED: Final = 10_000
_GONE: Final = f"gone for {GONE_AFTER / 60:g} min"
_KINDS: dict[str, Kind] = {kind: kind for kind in LANES}


class LinkPatterns:
    """One link's.

    Entries that are no patterns win over these, and the first pattern that a name matches wins over the others. What
    operators remove is an exception from then on, and what they edit an entry of its own.

    Args:
        link: whose routes these are.

    Attributes:
        link: likewise.
        followed: what the peer follows of this side's graph.
        entries: the patterns, in order.
        there: what the peer's graph has of what is followed; None: that is not known now.
        unseen: how many names it has beyond those that it tells.
        gone: the identities of what has a route and nobody publishes or provides, each with the time since when.
    """

    def __init__(self, link: Link) -> None:
        self.link = link
        self.followed = FollowedByPeer(link.context, link.shows, link.send)
        self.entries: list[PatternEntry] = []
        self._here: Names | None = None  # this side's graph; None: not known yet
        self.there: Names | None = None
        self._request = 0
        self._due = False  # the peer has told something new
        self.unseen = 0
        self.gone: dict[Identity, float] = {}
        self._known: dict[tuple[bool, Kind, str, str], tuple[int, Topic] | None] = {}  # which pattern matches
        self._told_full: set[Identity] = set()
        link.table.on_removed = self.leave_out

    # --- what operators want

    def all(self) -> tuple[Topic, ...]:
        """The patterns, in order. May be called from any thread."""
        return tuple(entry.topic for entry in tuple(self.entries))

    def add(self, topic: Topic) -> str:
        """Follow one more pattern; its key.

        Raises:
            LinkError: it has a mistake, there is such a pattern, or there are too many.
        """
        self.link.proposed.check(topic)
        if any(entry.topic.identity == topic.identity for entry in self.entries):
            raise LinkError(f"{topic.topic} is followed in that direction already: edit or remove that pattern")
        if len(self.entries) >= PATTERNS_PER_LINK:
            raise LinkError(f"this link has {PATTERNS_PER_LINK} patterns already, which is the limit")
        self._set([*self.all(), topic])
        return self.key_of(topic)

    def replace(self, identity: Identity, topic: Topic) -> str:
        """Put another pattern in a pattern's place; its key.

        Raises:
            LinkError: it has a mistake, or there is such a pattern at another place.
        """
        self.check_replace(identity, topic)
        self._set(topic if each.identity == identity else each for each in self.all())
        return self.key_of(topic)

    def check_replace(self, identity: Identity, topic: Topic) -> None:
        """Raise `LinkError` where `replace` would."""
        self.link.proposed.check(topic)
        if topic.identity != identity and any(each.identity == topic.identity for each in self.all()):
            raise LinkError(f"{topic.topic} is followed in that direction already: edit or remove that pattern")

    def remove(self, identity: Identity) -> None:
        """Follow a pattern no more: all routes that it has made are removed, unless another one matches."""
        self._set(each for each in self.all() if each.identity != identity)

    def arrange(self, identities: Iterable[Identity]) -> None:
        """Put the patterns in another order."""
        known = {each.identity: each for each in self.all()}
        self._set(known[identity] for identity in identities if identity in known)

    def leave_out(self, route: Route) -> None:
        """An operator removes a route: no pattern brings it back."""
        name = route.spec.topic
        if not any(self._claims(entry, route) for entry in self.entries):
            return
        if problem := self.brings_back(route):
            self.link.log(Level.WARNING, EventCode.LINK_PATTERN_FULL, problem, topic=name)
            return
        self._set(
            msgspec.structs.replace(each.topic, excepts=(*each.topic.excepts, name))
            if self._claims(each, route)
            else each.topic
            for each in self.entries
        )

    def brings_back(self, route: Route) -> str:
        """Why a pattern cannot leave out a route's topic; empty: all can."""
        reached = (exceptions_reached(entry) for entry in self.entries if self._claims(entry, route))
        return next(filter(None, reached), "")

    def _claims(self, entry: PatternEntry, route: Route) -> bool:
        same = entry.topic.kind == route.spec.kind and entry.topic.direction == route.spec.direction
        return same and route.proposed_here and entry.matches_client(route.spec.topic)

    def has_made(self, route: Route, topic: Topic) -> bool:
        """Whether a route is one of a pattern's."""
        return bool(route.pattern) and identity_of(route) == topic.identity

    def key_of(self, topic: Topic) -> str:
        """What identifies a pattern in commands and snapshots of this side; no route has such a key."""
        return f"{self.link.name} {'→' if topic.direction == 'transmit' else '←'} pattern {topic.kind} {topic.topic}"

    def find(self, key: str) -> Topic | None:
        """The pattern of that key."""
        return next((topic for topic in self.all() if self.key_of(topic) == key), None)

    def _set(self, topics: Iterable[Topic]) -> None:
        before = {entry.topic.identity for entry in self.entries if entry.beyond}
        self.entries = [self._entry(topic) for topic in topics]
        self.link.context.demands.changed()
        self._known.clear()
        self._told_full &= before & {entry.topic.identity for entry in self.entries}
        self._ask()
        self.link.context.names_changed()
        self.reconcile()

    def _entry(self, topic: Topic) -> PatternEntry:
        link = self.link
        own = link.context.session.use_name if link.is_client else link.use_name
        theirs = isinstance(link.peer, Welcome) and link.peer.use_name
        return PatternEntry(topic, client=link.name, prefixed=own, always_prefixed=theirs)

    # --- the two graphs

    def connected(self) -> None:
        """The peer is connected, and is asked for what its graph has. Who is on the server is known from now on."""
        self._request = 0
        self.renew()

    def renew(self) -> None:
        """The server may have other names for the client's topics, or the peer other rights."""
        self._set(self.all())

    def disconnected(self) -> None:
        """The connection is over: nothing is known of the peer's graph, and nothing of it is taken for gone."""
        self.followed.disconnected()
        self.there, self.unseen = None, 0
        self.reconcile()

    def _ask(self) -> None:
        theirs = tuple(
            NamePattern(entry.source.text, entry.topic.kind) for entry in self.entries if not self.is_local(entry)
        )
        if self.link.linked and FEATURE in self.link.features and (theirs or self._request):
            self._request += 1
            self.there, self.unseen = None, 0
            self.link.send(Follow(self._request, theirs))

    def handle(self, message: Follow | Followed) -> None:
        """The peer follows this side's graph, or says what has changed in its own."""
        if isinstance(message, Follow):
            self.followed.asked(message)
        elif message.request == self._request:
            self._take(message)

    def _take(self, message: Followed) -> None:
        names = {} if self.there is None else self.there
        for each in message.gone:
            if (kind := _KINDS.get(each.kind)) is not None:
                names.pop((kind, each.name), None)
        for each in message.present:
            kind = _KINDS.get(each.kind)
            if kind is not None and ((kind, each.name) in names or len(names) < NAMES_FOLLOWED):
                names[kind, each.name] = each.type
        self.there, self.unseen, self._due = names, message.more, True

    def patterns_here(self) -> Collection[tuple[Kind, Pattern]]:
        """What it asks of this side's graph."""
        return [(entry.topic.kind, entry.source) for entry in self.entries if self.is_local(entry)]

    def look(self, names: Names) -> None:
        """See what this side's graph has now."""
        if self.entries and names != self._here:
            self._here = names
            self.reconcile()

    def is_local(self, entry: PatternEntry) -> bool:
        """Whether an entry follows this side's graph."""
        return entry.from_client == self.link.is_client

    # --- routes

    def routes_of(self, entry: PatternEntry) -> list[Route]:
        """The routes that a pattern has made."""
        return [route for route in self.link.routes.values() if self.has_made(route, entry.topic)]

    def reconcile(self) -> None:
        """Have routes for what matches, and for nothing else."""
        if not self.entries and not any(route.pattern for route in self.link.routes.values()):
            return
        with acting(""):  # whoever has made the graph change is no operator
            self._reconcile(self._wanted())

    def _reconcile(self, wanted: dict[Identity, tuple[PatternEntry, Topic]]) -> None:
        for each in self.entries:
            each.beyond, each.left_out = 0, {}
        routes = {route.spec.identity: route for route in self.link.routes.values()}
        self.gone = {identity: at for identity, at in self.gone.items() if identity in routes}
        for identity, route in routes.items():
            if not route.pattern:
                continue
            if identity in wanted:
                self.gone.pop(identity, None)
                self._keep(route, *wanted[identity])
            elif (entry := self._entry_of(route)) is None:
                self._drop(route, "no pattern matches it any more")
            elif (self._here if self.is_local(entry) else self.there) is None:
                self.gone.pop(identity, None)
            else:
                self.gone.setdefault(identity, self.link.context.now())
        self._add(wanted)

    def _wanted(self) -> dict[Identity, tuple[PatternEntry, Topic]]:
        """What matches now, each with the pattern that wins, in the order of patterns and names."""
        session, rights = self.link.context.session, as_if_listed(self.link.rights)
        own = {session.shutdown_topic, session.diagnostics_topic}
        found: list[tuple[int, str, Topic]] = []
        for local, names in ((True, self._here), (False, self.there)):
            for (kind, name), type_name in (names or {}).items():
                key = local, kind, name, type_name
                if key not in self._known:
                    self._known[key] = self._first_match(*key, rights)
                match = self._known[key]
                if match is not None and own.isdisjoint((name, match[1].topic, match[1].remote_topic)):
                    found.append((match[0], name, match[1]))
        found.sort(key=itemgetter(0, 1))
        wanted: dict[Identity, tuple[PatternEntry, Topic]] = {}
        for at, _, topic in found:
            wanted.setdefault(topic.identity, (self.entries[at], topic))
        return wanted

    def _first_match(
        self, local: bool, kind: Kind, name: str, type_name: str, rights: Rights
    ) -> tuple[int, Topic] | None:
        """The place of the first pattern that matches a name, and what that makes of it."""
        if len(self._known) >= _REMEMBERED:
            self._known.clear()
        for at, entry in enumerate(self.entries):
            if entry.topic.kind == kind and self.is_local(entry) == local:
                topic = entry.match(name, type_name)
                if topic is not None and self._may_have(entry, name, topic, rights):
                    return at, topic
        return None

    def _entry_of(self, route: Route) -> PatternEntry | None:
        """The pattern that would match a route's topic if that was there; None: none does any more."""
        rights = as_if_listed(self.link.rights)
        for entry in self.entries:
            if self._claims(entry, route):
                name = route.spec.topic
                if not entry.from_client:
                    name = entry.server_name(route.spec.remote_topic or name)
                topic = entry.match(name, None)
                if topic is not None and self._may_have(entry, name, topic, rights):
                    return entry
        return None

    def _may_have(self, entry: PatternEntry, name: str, topic: Topic, rights: Rights) -> bool:
        """Whether a pattern may bridge a name, as this side's own rights say."""
        link = self.link
        if self.is_local(entry):
            local = name
        else:
            local = topic.topic if link.is_client else entry.server_name(topic.remote_topic or topic.topic)
        sends, takes = uses(topic.kind)
        may = sends if (topic.direction == "transmit") != link.is_client else takes
        return rights.refusal(Use(local, may, topic.protocol or link.transport.name, topic.kind)) is None

    def _keep(self, route: Route, entry: PatternEntry, topic: Topic) -> None:
        """Have a route be as its pattern says now."""
        if msgspec.structs.replace(topic, paused=route.spec.paused) != route.spec:
            try:
                route = self.link.proposed.replace(route, topic)
            except LinkError as error:
                entry.left_out[topic.topic] = str(error)
        route.pattern = entry.topic.topic

    def _add(self, wanted: dict[Identity, tuple[PatternEntry, Topic]]) -> None:
        """Make routes for what has none, as far as there is room."""
        matched = [route for route in self.link.routes.values() if route.pattern]
        total = len(matched)
        counts = dict.fromkeys((entry.topic.identity for entry in self.entries), 0)
        for route in matched:
            counts[identity_of(route)] = counts.get(identity_of(route), 0) + 1
        taken = {route.spec.identity for route in self.link.routes.values()}
        taken |= {topic.identity for topic in self.link.table.yielded.values()}
        for identity, (entry, topic) in wanted.items():
            if identity in taken:
                continue
            of_entry = entry.topic.identity
            if counts[of_entry] >= ROUTES_PER_PATTERN or total >= ROUTES_BY_PATTERNS:
                gone = self._longest_gone(of_entry if counts[of_entry] >= ROUTES_PER_PATTERN else None)
                if gone is None:
                    entry.beyond += 1
                    continue
                counts[identity_of(gone)] -= 1
                total -= 1
                self._drop(gone, "gone, and others that match need its room")
            try:
                self.link.proposed.add(topic, by_pattern=True).pattern = entry.topic.topic
            except LinkError as error:
                if not self.link.proposed.is_bridged(topic):  # under another name on the client
                    entry.left_out[topic.topic] = str(error)
            else:
                counts[of_entry] += 1
                total += 1
        self._tell_full()

    def _longest_gone(self, pattern: Identity | None) -> Route | None:
        """The route whose topic has been gone for longest, of one pattern or of any."""
        routes = {route.spec.identity: route for route in self.link.routes.values() if route.pattern}
        for identity in sorted(self.gone, key=lambda each: self.gone[each]):
            if identity in routes and pattern in (None, identity_of(routes[identity])):
                return routes[identity]
        return None

    def _drop(self, route: Route, reason: str) -> None:
        self.gone.pop(route.spec.identity, None)
        self.link.table.remove(route, reason, told=False)

    def tick(self) -> None:
        """Once a second: see what the peer has told, however often it has; remove what has been gone for long."""
        if self._due:
            self._due = False
            self.reconcile()
        if not self.gone:
            return
        now = self.link.context.now()
        over = {identity for identity, at in self.gone.items() if now - at >= GONE_AFTER}
        for route in [route for route in self.link.routes.values() if route.pattern and route.spec.identity in over]:
            self._drop(route, f"{_GONE}; {route.pattern} matches it again once it is back")
        if over:
            self.gone = {identity: at for identity, at in self.gone.items() if identity not in over}
            self.reconcile()

    # --- what operators see

    def _tell_full(self) -> None:
        for entry in self.entries:
            identity, name = entry.topic.identity, entry.topic.topic
            if entry.beyond and identity not in self._told_full:
                self._told_full.add(identity)
                text = f"pattern {name}: {limit_reached(entry, len(self.routes_of(entry)))}"
                self.link.log(Level.WARNING, EventCode.LINK_PATTERN_FULL, text, topic=name)
            elif not entry.beyond and identity in self._told_full:
                self._told_full.discard(identity)
                text = f"pattern {name}: all that match are bridged"
                self.link.log(Level.INFO, EventCode.LINK_PATTERN_ROOM, text, topic=name)


def identity_of(route: Route) -> Identity:
    """Of the pattern that has made a route."""
    return route.spec.kind, route.pattern, route.spec.direction
