"""Patterns that this side of a link proposes: each matching name has a route for as long as the name exists."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.config.rights import as_if_listed
from rsb_bridge.config.validation import validate_topic
from rsb_bridge.link.extension import Denied, Extension, LinkError
from rsb_bridge.link.pattern_matches import Match, PatternEntry, PatternMatches
from rsb_bridge.link.pattern_routes import PatternRoutes, limit_reached
from rsb_bridge.link.proposals import KINDS
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.patterns import (
    EXCEPTIONS_PER_PATTERN,
    NAMES_FOLLOWED,
    PATTERNS_PER_LINK,
    Pattern,
    is_valid,
)
from rsb_bridge.model.snapshot import Level, PatternSnapshot, State
from rsb_bridge.tasks import MOST_AT_ONCE, in_slices
from rsb_bridge.wire.messages import Follow, Followed, FoundName, NamePattern, Welcome

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.graph_watch import Named, Names
    from rsb_bridge.link.pattern_hints import PatternHints
    from rsb_bridge.link.proposed_routes import ProposedTopics
    from rsb_bridge.link.route_table import RouteTable
    from rsb_bridge.model.session import Identity, Kind, Topic
    from rsb_bridge.route.route import Route

_IN_ONE_MESSAGE = 200
"""Names of either list: even the longest ones, with four bytes a character, take less than the 1 MiB of a frame."""


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

    Attributes:
        names: the entries, and the names that match them.
        made: the routes that they have made.
        followed: what the peer follows, or None if it follows no names.
    """

    def __init__(self, link: BaseLink, table: RouteTable, proposed: ProposedTopics, hints: PatternHints) -> None:
        self._context = link.context
        self._hints = hints
        self._link = link
        self.followed: PeerSubscription | None = None
        self.messages = {Follow: self._asked, Followed: self._receive}
        self.names = PatternMatches(link)
        self.made = PatternRoutes(link, table, proposed, self.names)
        self._unseen = 0  # further matching names that the peer does not tell
        self._request = 0
        self._due = False  # the peer has sent other names, or given up a route
        table.on_removed = self.leave_out
        table.on_given_up = self._given_up

    # --- what operators want

    def all(self) -> tuple[Topic, ...]:
        """Return the patterns, in order. May be called from any thread."""
        return tuple(entry.topic for entry in tuple(self.names.entries))

    def add(self, topic: Topic) -> str:
        """Follow one more pattern, and return its key.

        Raises:
            LinkError: it has a mistake or exists already, or there are too many patterns.
        """
        self.check_replace(None, topic)
        if len(self.names.entries) >= PATTERNS_PER_LINK:
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
        name, claiming = route.spec.topic, self.names.claiming(route)
        if not claiming:
            return
        if problem := self.brings_back(route):  # a session with more exceptions is invalid: the route comes back
            self._link.log(Level.WARNING, EventCode.LINK_PATTERN_FULL, problem, topic=name)
            return
        self._set(
            msgspec.structs.replace(each.topic, excepts=(*each.topic.excepts, name)) if each in claiming else each.topic
            for each in self.names.entries
        )

    def brings_back(self, route: Route) -> str:
        """Return why a pattern cannot leave out a route's topic, or an empty string if all can."""
        for entry in self.names.claiming(route):
            if len(entry.topic.excepts) >= EXCEPTIONS_PER_PATTERN:
                limit = f"{EXCEPTIONS_PER_PATTERN} exceptions already, which is the limit"
                return f"pattern {entry.topic.topic} has {limit}: edit it, and use patterns in except"
        return ""

    def key_of(self, topic: Topic) -> str:
        """Return the key of a pattern in commands and snapshots of this side. No route has such a key."""
        return f"{self._link.name} {'→' if topic.direction == 'transmit' else '←'} pattern {topic.kind} {topic.topic}"

    def find(self, key: str) -> Topic | None:
        """Return the pattern with a key, or None."""
        return next((topic for topic in self.all() if self.key_of(topic) == key), None)

    def _set(self, topics: Iterable[Topic], *, by_operator: bool = True) -> None:
        """Follow other patterns. An operator waits until the routes are removed that none matches any more."""
        link = self._link
        prefixed, always = link.end.prefixed, isinstance(link.peer, Welcome) and link.peer.use_name
        self.made.use(
            [PatternEntry(topic, client=link.name, prefixed=prefixed, always_prefixed=always) for topic in topics]
        )
        self._context.demands.changed()
        self._ask()
        self._context.names_changed()
        if not by_operator:
            self._match_names()
        else:
            self.made.reconcile()

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
        self.names.there, self._unseen = None, 0
        self.made.reconcile()

    def _ask(self) -> None:
        entries = (entry for entry in self.names.entries if not self.names.is_local(entry))
        theirs = tuple(NamePattern(entry.source.text, entry.topic.kind) for entry in entries)
        if self._link.linked and (theirs or self._request):  # without patterns, it only ends an earlier Follow
            self._request += 1
            self.names.there, self._unseen = None, 0
            self._link.send(Follow(self._request, theirs))

    def _asked(self, message: Follow) -> None:
        """Take the peer's patterns, which replace its earlier ones."""
        self.followed = PeerSubscription(self._link, message)
        self._context.names_changed()

    def _receive(self, message: Followed) -> None:
        if message.request != self._request:
            return
        names = {} if self.names.there is None else self.names.there
        for each in message.gone:
            if (kind := KINDS.get(each.kind)) is not None:
                names.pop((kind, each.name), None)
        for each in message.present:  # the new type of a known name counts even if the table is full
            kind = KINDS.get(each.kind)
            if kind is not None and ((kind, each.name) in names or len(names) < NAMES_FOLLOWED):
                names[kind, each.name] = each.type
        # `tick` acts on it: names are matched once a second, however often the peer sends some.
        self.names.there, self._unseen, self._due = names, message.more, True

    def patterns_here(self) -> Collection[tuple[Kind, Pattern]]:
        return [(entry.topic.kind, entry.source) for entry in self.names.entries if self.names.is_local(entry)]

    def update_names(self, names: Names) -> None:
        if self.names.entries and names != self.names.here:
            self.names.here = names
            self._match_names()

    # --- routes

    def _match_names(self) -> None:
        """Match the names of the two graphs, many new ones in slices, and reconcile the routes with them."""
        matches, rights = self.names, as_if_listed(self._link.end.rights)
        entries, new = matches.entries, matches.new_names()

        def match(key: Match) -> None:
            if matches.entries is entries:  # else other patterns or rights have replaced these between two slices
                matches.learn(key, rights)

        async def match_all() -> None:
            await in_slices(new, match)
            self.made.reconcile()

        if len(new) > MOST_AT_ONCE:
            self._link.spawn(match_all())
        else:
            self.made.reconcile()

    def tick(self) -> None:
        """Take the peer's latest names, and remove routes whose topic has long been gone."""
        if self._due:
            self._due = False
            self._match_names()
        self.made.drop_overdue()

    def _given_up(self) -> None:
        """Look soon whether a pattern matches what the other side has given up."""
        self._due = True

    # --- what operators see

    def snapshots(self) -> Iterator[PatternSnapshot]:
        """Yield a snapshot of each pattern."""
        for entry in self.names.entries:
            routes = self.made.routes_of(entry.topic)
            gone = sum(1 for each in routes if each in self.made.gone)
            count = f"{len(routes)} bridged{f', {gone} of them gone' if gone else ''}"
            state, reason = self._state(entry, len(routes), count if routes else "")
            here = self.names.is_local(entry)
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
        link, here = self._link, self.names.is_local(entry)
        some = f"{count}; " if count else ""
        if entry.beyond:
            return State.DOWN, f"{some}{limit_reached(entry, routes)}"
        if entry.left_out:
            name, reason = next(iter(entry.left_out.items()))
            return State.DOWN, f"{some}{len(entry.left_out)} not bridged: {name}: {reason}"
        if entry.topic.paused:
            return State.PAUSED, count
        if not here and self._unseen:
            return State.DOWN, f"{some}{self._unseen} more match than the other side can list: narrow the patterns"
        if not here and self.names.there is None:
            why = "it has just been asked" if link.linked else f"not linked: {link.down_reason or 'not connected yet'}"
            return State.WAITING, f"{some}the other side's names are unknown: {why}"
        if not count:
            side = f"in domain {self._context.domain_id}" if here else "on the other side"
            but = " except what it leaves out" if entry.topic.excepts else ""
            return State.WAITING, f"nothing {side} matches {entry.source.text}{but}{self._hints.of(entry)}"
        return State.OK, count
