"""Patterns that this side of a link proposes: each matching name has a route for as long as the name exists."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from operator import itemgetter
from typing import TYPE_CHECKING, Final, TypeAlias

import msgspec

from rsb_bridge.config.grants import uses
from rsb_bridge.config.rights import Use, as_if_listed
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.extension import Denied, Extension, LinkError
from rsb_bridge.link.proposals import KINDS
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.commands import acting
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.names import client_topic, expand_type_name, is_topic_name, server_topic
from rsb_bridge.model.patterns import (
    EXCEPTIONS_PER_PATTERN,
    GONE_AFTER,
    NAMES_FOLLOWED,
    PATTERNS_PER_LINK,
    ROUTES_BY_PATTERNS,
    ROUTES_PER_PATTERN,
    Pattern,
    is_hidden,
    is_valid,
)
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.snapshot import Level, PatternSnapshot, State
from rsb_bridge.tasks import MOST_AT_ONCE, in_slices
from rsb_bridge.wire.messages import Follow, Followed, FoundName, NamePattern, Welcome

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from rsb_bridge.config.rights import Rights
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.graph_watch import Named, Names
    from rsb_bridge.link.proposed_routes import ProposedTopics
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.session import Identity, Kind, Topic
    from rsb_bridge.route.route import Route

_GONE: Final = f"gone for {GONE_AFTER / 60:g} min"
_IN_ONE_MESSAGE = 200
"""Names of either list: even the longest ones, with four bytes a character, take less than the 1 MiB of a frame."""

_Match: TypeAlias = "tuple[bool, Kind, str, str]"
"""A name to match: whether it is in this side's graph, its kind, the name, and its type."""


class PatternEntry:
    """An entry of a session whose name is a pattern, ready for matching.

    Args:
        prefixed: whether the server's names have the prefix if the entry has no `Topic.remote_topic`.
        always_prefixed: whether other names get the prefix, too, unless they begin with it.
    """

    def __init__(self, topic: Topic, *, client: str, prefixed: bool, always_prefixed: bool = False) -> None:
        self.topic = topic
        # It follows the client's graph: a topic is followed where it is published, a service where its provider is.
        self.from_client = (topic.direction == "transmit") == (topic.kind == "topic")
        self.left_out: dict[str, str] = {}  # reasons why matching names could not be bridged, by name
        self.beyond = 0  # matching names for which there is no room
        self._here = Pattern(topic.topic)
        self._remote = None if topic.remote_topic is None else Pattern(topic.remote_topic)
        self._excepts = [Pattern(each) for each in topic.excepts]
        self._type = "" if topic.type == AUTO else expand_type_name(topic.type)
        self._client = client
        self._prefixed = prefixed and self._remote is None
        self._always = always_prefixed
        self.source = Pattern(self.name_of(topic, on_client=self.from_client))  # of names in the followed graph

    def name_of(self, topic: Topic, *, on_client: bool) -> str:
        """Return the client's or the server's name of this pattern's topic, or of one that it matches."""
        if on_client:
            return topic.topic
        name = topic.remote_topic or topic.topic
        if self._prefixed or (self._always and client_topic(name, self._client) is None):
            return server_topic(name, self._client)
        return name

    def match(self, name: str, type_name: str | None) -> Topic | None:
        """Return the topic to bridge for a name of the followed graph, or None if it does not match.

        Args:
            name: the name in that graph.
            type_name: its type there, an empty string if its endpoints disagree, or None for any type.
        """
        parts = self.source.match(name)
        if parts is None or (self._type and type_name is not None and type_name != self._type):
            return None
        on_client = self._here.fill(parts)
        remote = None if self._remote is None else self._remote.fill(parts)
        if is_hidden(on_client) or not is_topic_name(on_client) or self._leaves_out(on_client):
            return None
        beat = self.topic.beat or (self.topic.topic if self.topic.kind == "topic" else None)
        return msgspec.structs.replace(self.topic, topic=on_client, remote_topic=remote, excepts=(), beat=beat)

    def claims(self, topic: Topic) -> bool:
        """Whether it would bring back a topic, if that were removed."""
        same = (self.topic.kind, self.topic.direction) == (topic.kind, topic.direction)
        return same and self._here.match(topic.topic) is not None and not self._leaves_out(topic.topic)

    def _leaves_out(self, name: str) -> bool:
        return any(each.match(name) is not None for each in self._excepts)


class PeerSubscription:
    """The names of this side's graph that match the patterns of the peer's newest `Follow`; the peer gets changes."""

    def __init__(self, link: BaseLink, asked: Follow) -> None:
        self._link = link
        self._asked = asked
        self._patterns: list[tuple[Kind, Pattern]] | None = None  # not compiled yet
        self._told: Names = {}
        self._more = 0
        self._answered = False

    def patterns_here(self) -> Collection[tuple[Kind, Pattern]]:
        """Return the peer's patterns. They are compiled when the graph is searched, not each time the peer asks."""
        if self._patterns is None:
            self._patterns = [
                (kind, Pattern(each.pattern))
                for each in self._asked.patterns
                if (kind := KINDS.get(each.kind)) is not None and is_valid(each.pattern)
            ]
        return self._patterns

    def update_names(self, names: Names) -> None:
        """Send the peer the changes of the matching names."""
        # A search that had begun before the patterns were compiled looked for earlier ones.
        if self._patterns is None or (self._answered and not self._patterns):
            return
        matching = [(named, type_name) for named, type_name in sorted(names.items()) if self._tells(named, type_name)]
        known = [each for each in matching if each[0] in self._told]  # first: a full list stays the same
        new = [each for each in matching if each[0] not in self._told]
        told = dict(islice((*known, *new), NAMES_FOLLOWED))
        present = [_found(named, kind) for named, kind in told.items() if self._told.get(named) != kind]
        gone = [_found(named, "") for named in self._told if named not in told]
        more = len(matching) - len(told)
        if not (present or gone or more != self._more or not self._answered):
            return
        self._told, self._more, self._answered = told, more, True
        # At least one message: that nothing matches is an answer, too.
        for at in range(0, max(len(present), len(gone), 1), _IN_ONE_MESSAGE):
            part = slice(at, at + _IN_ONE_MESSAGE)
            self._link.send(Followed(self._asked.request, tuple(present[part]), tuple(gone[part]), more))

    def _tells(self, named: Named, type_name: str) -> bool:
        kind, name = named
        matches = any(kind == each and pattern.match(name) is not None for each, pattern in self.patterns_here())
        # The other side would end the connection for a longer text (PROTOCOL.md, 3).
        return matches and max(len(name), len(type_name)) <= TEXT_LENGTH and self._link.end.shows(name, kind)


def _found(named: Named, type_name: str) -> FoundName:
    kind, name = named
    return FoundName(name, type_name, kind)


class LinkPatterns(Extension):
    """The patterns of one link.

    Entries with a plain name win over patterns, and the first pattern that a name matches wins over later ones. A topic
    that an operator removes becomes an exception of its patterns, and one that an operator edits an entry of its own.
    """

    def __init__(self, link: BaseLink, table: RouteTable, proposed: ProposedTopics) -> None:
        self._context = link.context
        self._link = link
        self._table = table
        self._proposed = proposed
        self.followed: PeerSubscription | None = None  # the peer's, or None if it follows no names
        self.messages = {Follow: self._asked, Followed: self._receive}
        self._entries: list[PatternEntry] = []
        self._here: Names | None = None  # matching names of this side's graph, or None as long as they are unknown
        self.there: Names | None = None  # the same of the peer's graph
        self._unseen = 0  # further matching names that the peer does not tell
        self._request = 0
        self._due = False  # the peer has sent other names, or given up a route
        self._gone: dict[Route, float] = {}  # whose topic or service is gone, each with the time since when
        self._known: dict[_Match, tuple[int, Topic] | None] = {}  # which pattern matches
        self._to_add: dict[Identity, tuple[PatternEntry, Topic]] = {}  # what has no route yet, in order
        self._logged_full: set[Identity] = set()
        table.on_removed = self.leave_out
        table.on_given_up = self._given_up

    # --- what operators want

    def all(self) -> tuple[Topic, ...]:
        """Return the patterns, in order. May be called from any thread."""
        return tuple(entry.topic for entry in tuple(self._entries))

    def add(self, topic: Topic) -> str:
        """Follow one more pattern, and return its key.

        Raises:
            LinkError: it has a mistake or exists already, or there are too many patterns.
        """
        self.check_replace(None, topic)
        if len(self._entries) >= PATTERNS_PER_LINK:
            raise LinkError(Denied.TOO_MANY_PATTERNS(limit=PATTERNS_PER_LINK))
        self._set([*self.all(), topic])
        return self.key_of(topic)

    def replace(self, identity: Identity, topic: Topic) -> str:
        """Replace a pattern, and return the new one's key.

        Raises:
            LinkError: the new one has a mistake, or equals another pattern.
        """
        self.check_replace(identity, topic)
        self._set(topic if each.identity == identity else each for each in self.all())
        return self.key_of(topic)

    def check_replace(self, identity: Identity | None, topic: Topic) -> None:
        """Raise `LinkError` where `replace` or, without an identity, `add` would."""
        for problem in validate_topic(topic, self._context.session):
            raise LinkError(str(problem))
        if topic.identity != identity and any(each.identity == topic.identity for each in self.all()):
            raise LinkError(Denied.FOLLOWED_ALREADY(topic=topic.topic))

    def remove(self, identity: Identity) -> None:
        """Stop following a pattern, and remove its routes unless another pattern matches."""
        self._set(each for each in self.all() if each.identity != identity)

    def arrange(self, identities: Iterable[Identity]) -> None:
        """Put the patterns in another order."""
        known = {each.identity: each for each in self.all()}
        self._set(known[identity] for identity in identities if identity in known)

    def leave_out(self, route: Route) -> None:
        """Keep patterns from restoring a route that an operator removes."""
        name, claiming = route.spec.topic, self._claiming(route)
        if not claiming:
            return
        if problem := self.brings_back(route):  # a session with more exceptions is invalid: the route comes back
            self._link.log(Level.WARNING, EventCode.LINK_PATTERN_FULL, problem, topic=name)
            return
        self._set(
            msgspec.structs.replace(each.topic, excepts=(*each.topic.excepts, name)) if each in claiming else each.topic
            for each in self._entries
        )

    def brings_back(self, route: Route) -> str:
        """Return why a pattern cannot leave out a route's topic, or an empty string if all can."""
        for entry in self._claiming(route):
            if len(entry.topic.excepts) >= EXCEPTIONS_PER_PATTERN:
                limit = f"{EXCEPTIONS_PER_PATTERN} exceptions already, which is the limit"
                return f"pattern {entry.topic.topic} has {limit}: edit it, and use patterns in except"
        return ""

    def _claiming(self, route: Route) -> list[PatternEntry]:
        """Return the patterns that would bring back a route of this side, in order."""
        return [each for each in self._entries if each.claims(route.spec)] if route.proposed_here else []

    def key_of(self, topic: Topic) -> str:
        """Return the key of a pattern in commands and snapshots of this side. No route has such a key."""
        return f"{self._link.name} {'→' if topic.direction == 'transmit' else '←'} pattern {topic.kind} {topic.topic}"

    def find(self, key: str) -> Topic | None:
        """Return the pattern with a key, or None."""
        return next((topic for topic in self.all() if self.key_of(topic) == key), None)

    def _set(self, topics: Iterable[Topic], *, by_operator: bool = True) -> None:
        """Follow other patterns. An operator waits until the routes are removed that none matches any more."""
        before = {entry.topic.identity for entry in self._entries if entry.beyond}
        link = self._link
        always = isinstance(link.peer, Welcome) and link.peer.use_name
        self._entries = [
            PatternEntry(topic, client=link.name, prefixed=link.end.prefixed, always_prefixed=always)
            for topic in topics
        ]
        self._context.demands.changed()
        self._known.clear()
        self._to_add = {}  # of the earlier ones
        self._logged_full &= before & {entry.topic.identity for entry in self._entries}
        self._ask()
        self._context.names_changed()
        if not by_operator:
            self._match_names()
        else:
            self._reconcile()

    # --- the two graphs

    def connected(self) -> None:
        """Follow the peer's graph; the names on the server are known from now on."""
        self._request = 0  # the end of the last connection has ended its Follow
        self._set(self.all(), by_operator=False)

    def renew(self) -> None:
        """Match all names again: the server's names, or the peer's rights, may have changed."""
        self._set(self.all())

    def disconnected(self) -> None:
        """Forget the peer's names, without counting them as gone."""
        self.followed = None
        self.there, self._unseen = None, 0
        self._reconcile()

    def _ask(self) -> None:
        theirs = tuple(
            NamePattern(entry.source.text, entry.topic.kind) for entry in self._entries if not self._is_local(entry)
        )
        if self._link.linked and (theirs or self._request):  # without patterns, it only ends an earlier Follow
            self._request += 1
            self.there, self._unseen = None, 0
            self._link.send(Follow(self._request, theirs))

    def _asked(self, message: Follow) -> None:
        """Take the peer's patterns, which replace its earlier ones."""
        self.followed = PeerSubscription(self._link, message)
        self._context.names_changed()

    def _receive(self, message: Followed) -> None:
        if message.request != self._request:
            return
        names = {} if self.there is None else self.there
        for each in message.gone:
            if (kind := KINDS.get(each.kind)) is not None:
                names.pop((kind, each.name), None)
        for each in message.present:  # the new type of a known name counts even if the table is full
            kind = KINDS.get(each.kind)
            if kind is not None and ((kind, each.name) in names or len(names) < NAMES_FOLLOWED):
                names[kind, each.name] = each.type
        # `tick` acts on it: names are matched once a second, however often the peer sends some.
        self.there, self._unseen, self._due = names, message.more, True

    def patterns_here(self) -> Collection[tuple[Kind, Pattern]]:
        return [(entry.topic.kind, entry.source) for entry in self._entries if self._is_local(entry)]

    def update_names(self, names: Names) -> None:
        if self._entries and names != self._here:
            self._here = names
            self._match_names()

    def _is_local(self, entry: PatternEntry) -> bool:
        """Whether an entry follows this side's graph."""
        return entry.from_client == self._link.is_client

    # --- routes

    def routes_of(self, pattern: Topic) -> tuple[Route, ...]:
        """Return the routes that a pattern has made by now."""
        routes = self._link.routes.values()
        return tuple(route for route in routes if route.pattern and _identity_of(route) == pattern.identity)

    def _match_names(self) -> None:
        """Match the names of the two graphs, many new ones in slices, and reconcile the routes with them."""
        entries, rights = self._entries, as_if_listed(self._link.end.rights)
        new = [key for key in self._names() if key not in self._known]

        def match(key: _Match) -> None:
            if self._entries is entries:  # else other patterns or rights have replaced these between two slices
                self._known[key] = self._first_match(*key, rights)

        async def match_all() -> None:
            await in_slices(new, match)
            self._reconcile()

        if len(new) > MOST_AT_ONCE:
            self._link.spawn(match_all())
        else:
            self._reconcile()

    def _names(self) -> Iterator[_Match]:
        """Yield the names of both graphs, with their types."""
        for local, names in ((True, self._here), (False, self.there)):
            for (kind, name), type_name in (names or {}).items():
                yield local, kind, name, type_name

    def _reconcile(self) -> None:
        """Remove and change routes so that each is of a matching name, and begin to add the others."""
        self._to_add = {}  # which ends the slices of an earlier change of names or patterns
        if not self._entries and not any(route.pattern for route in self._link.routes.values()):
            return
        with acting(""):  # a change of the graph is not an operator's action
            wanted = self._wanted()
            for each in self._entries:
                each.beyond, each.left_out = 0, {}
            self._keep_made(wanted)
            self._add(wanted)

    def _keep_made(self, wanted: dict[Identity, tuple[PatternEntry, Topic]]) -> None:
        """Change the routes that patterns have made to what these say now, and drop routes that no pattern matches."""
        routes = self._link.routes
        # Others are removed by now, or an operator has made entries of their own of them.
        self._gone = {each: at for each, at in self._gone.items() if each.pattern and routes.get(each.key) is each}
        for route in tuple(routes.values()):
            if not route.pattern:
                continue
            if (match := wanted.get(route.spec.identity)) is not None:
                self._gone.pop(route, None)
                self._keep(route, *match)
            elif (entry := self._entry_of(route)) is None:
                self._drop(route, "no pattern matches it any more")
            elif (self._here if self._is_local(entry) else self.there) is None:  # unknown, as while the link is down
                self._gone.pop(route, None)
            else:
                self._gone.setdefault(route, self._context.now())

    def _wanted(self) -> dict[Identity, tuple[PatternEntry, Topic]]:
        """Return the matching topics, each with its winning pattern, in the order of patterns and names."""
        session, rights = self._context.session, as_if_listed(self._link.end.rights)
        own = set(session.own_topics) - {None}  # as most topics have no remote_topic
        found: list[tuple[int, str, Topic]] = []
        before, self._known = self._known, {}  # names that are gone are forgotten
        for key in self._names():
            match = self._known[key] = before[key] if key in before else self._first_match(*key, rights)
            if match is not None and own.isdisjoint((key[2], match[1].topic, match[1].remote_topic)):
                found.append((match[0], key[2], match[1]))
        found.sort(key=itemgetter(0, 1))
        wanted: dict[Identity, tuple[PatternEntry, Topic]] = {}
        for at, _, topic in found:
            wanted.setdefault(topic.identity, (self._entries[at], topic))
        return wanted

    def _first_match(
        self, local: bool, kind: Kind, name: str, type_name: str, rights: Rights
    ) -> tuple[int, Topic] | None:
        """Return the index of the first pattern that matches a name, and the topic to bridge."""
        for at, entry in enumerate(self._entries):
            if entry.topic.kind == kind and self._is_local(entry) == local:
                topic = entry.match(name, type_name)
                if topic is not None and self._may_have(entry, topic, rights):
                    return at, topic
        return None

    def _entry_of(self, route: Route) -> PatternEntry | None:
        """Return the pattern that matches a route's topic, which may be gone, or None."""
        rights = as_if_listed(self._link.end.rights)
        for entry in self._claiming(route):
            topic = entry.match(entry.name_of(route.spec, on_client=entry.from_client), None)
            if topic is not None and self._may_have(entry, topic, rights):
                return entry
        return None

    def _may_have(self, entry: PatternEntry, topic: Topic, rights: Rights) -> bool:
        """Whether a pattern may bridge a topic, as this side's own rights say."""
        link = self._link
        sends, takes = uses(topic.kind)
        may = sends if (topic.direction == "transmit") != link.is_client else takes
        name, transport = entry.name_of(topic, on_client=link.is_client), topic.protocol or link.transport.name
        return rights.refusal(Use(name, may, transport, topic.kind)) is None

    def _keep(self, route: Route, entry: PatternEntry, topic: Topic) -> None:
        """Change a route to the present values of its pattern."""
        if msgspec.structs.replace(topic, paused=route.spec.paused) != route.spec:  # a pause is the operators'
            try:
                route = self._proposed.replace(route, topic)
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
            fitting = (each for each in self._gone if not is_full or _identity_of(each) == of_entry)
            if (gone := min(fitting, key=self._gone.__getitem__, default=None)) is None:
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
        self._gone.pop(route, None)
        self._table.remove(route, reason, anonymous=True)

    def tick(self) -> None:
        """Take the peer's latest names, and remove routes whose topic has long been gone."""
        if self._due:
            self._due = False
            self._match_names()
        if not self._gone:  # as nearly always
            return
        now = self._context.now()
        made = [route for route in self._link.routes.values() if route.pattern]
        over = [route for route in made if now - self._gone.get(route, now) >= GONE_AFTER]
        for route in over:
            self._drop(route, f"{_GONE}; {route.pattern} matches it again once it is back")
        if over:
            self._reconcile()

    def _given_up(self) -> None:
        """Look soon whether a pattern matches what the other side has given up."""
        self._due = True

    # --- what operators see

    def _log_full(self) -> None:
        for entry in self._entries:
            identity, name = entry.topic.identity, entry.topic.topic
            if entry.beyond and identity not in self._logged_full:
                self._logged_full.add(identity)
                text = f"pattern {name}: {_limit_reached(entry, len(self.routes_of(entry.topic)))}"
                self._link.log(Level.WARNING, EventCode.LINK_PATTERN_FULL, text, topic=name)
            elif not entry.beyond and identity in self._logged_full:
                self._logged_full.discard(identity)
                text = f"pattern {name}: all that match are bridged"
                self._link.log(Level.INFO, EventCode.LINK_PATTERN_ROOM, text, topic=name)

    def snapshots(self) -> Iterator[PatternSnapshot]:
        """Yield a snapshot of each pattern."""
        for entry in self._entries:
            routes = self.routes_of(entry.topic)
            gone = sum(1 for each in routes if each in self._gone)
            count = f"{len(routes)} bridged{f', {gone} of them gone' if gone else ''}"
            state, reason = self._state(entry, len(routes), count if routes else "")
            here = self._is_local(entry)
            yield PatternSnapshot(
                key=self.key_of(entry.topic),
                link=self._link.name,
                spec=entry.topic,
                state=state,
                reason=reason,
                here=here,
                source=entry.source.text,
                routes=len(routes),
                gone=gone,
                beyond=entry.beyond + (0 if here else self._unseen),
            )

    def _state(self, entry: PatternEntry, routes: int, count: str) -> tuple[State, str]:
        link, here = self._link, self._is_local(entry)
        some = f"{count}; " if count else ""
        if entry.beyond:
            return State.DOWN, f"{some}{_limit_reached(entry, routes)}"
        if entry.left_out:
            name, reason = next(iter(entry.left_out.items()))
            return State.DOWN, f"{some}{len(entry.left_out)} not bridged: {name}: {reason}"
        if entry.topic.paused:
            return State.PAUSED, count
        if not here and self._unseen:
            return State.DOWN, f"{some}{self._unseen} more match than the other side can list: narrow the patterns"
        if not here and self.there is None:
            why = "it has just been asked" if link.linked else f"not linked: {link.down_reason or 'not connected yet'}"
            return State.WAITING, f"{some}the other side's names are unknown: {why}"
        if not count:
            side = f"in domain {self._context.domain_id}" if here else "on the other side"
            but = " except what it leaves out" if entry.topic.excepts else ""
            return State.WAITING, f"nothing {side} matches {entry.source.text}{but}"
        return State.OK, count


def _identity_of(route: Route) -> Identity:
    """Return the identity of the pattern that has made a route."""
    return route.spec.kind, route.pattern, route.spec.direction


def _limit_reached(entry: PatternEntry, routes: int) -> str:
    """Return how many names exceed which limit, with the remedy."""
    limit = f"{ROUTES_BY_PATTERNS} for all patterns of a link"
    if routes >= ROUTES_PER_PATTERN:
        limit = f"{ROUTES_PER_PATTERN} for a pattern"
    remedy = "make it narrower, leave some out (except), or list them by name"
    return f"{entry.beyond} more match, and are not bridged: the limit is {limit}; {remedy}"
