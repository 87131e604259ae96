"""The names in the graphs of both sides that a link's patterns match."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, TypeAlias

import msgspec

from rsb_bridge.config.grants import uses
from rsb_bridge.config.rights import Use, as_if_listed
from rsb_bridge.model.names import client_topic, is_topic_name, server_topic
from rsb_bridge.model.patterns import Pattern, is_hidden
from rsb_bridge.model.qos import AUTO
from rsb_bridge.model.type_names import expand_type_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rsb_bridge.config.rights import Rights
    from rsb_bridge.link.base_link import BaseLink
    from rsb_bridge.link.graph_watch import Names
    from rsb_bridge.model.session import Identity, Kind, Topic
    from rsb_bridge.route.route import Route

Match: TypeAlias = "tuple[bool, Kind, str, str]"
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


class PatternMatches:
    """The patterns of one link, and the names that match them.

    Attributes:
        entries: the patterns, in order.
        here: matching names of this side's graph, or None as long as they are unknown.
        there: the same of the peer's graph.
    """

    def __init__(self, link: BaseLink) -> None:
        self._context = link.context
        self._link = link
        self.entries: list[PatternEntry] = []
        self.here: Names | None = None
        self.there: Names | None = None
        self._known: dict[Match, tuple[int, Topic] | None] = {}  # which pattern matches

    def use(self, entries: list[PatternEntry]) -> None:
        """Use other patterns."""
        self.entries = entries
        self._known.clear()

    def new_names(self) -> list[Match]:
        """Return the names of both graphs that `learn` has to match first."""
        return [key for key in self.names() if key not in self._known]

    def learn(self, key: Match, rights: Rights) -> None:
        """Find the first pattern that matches a name, for `wanted`, where the peer has these rights."""
        self._known[key] = self._first_match(*key, rights)

    def claiming(self, route: Route) -> list[PatternEntry]:
        """Return the patterns that would bring back a route of this side, in order."""
        return [each for each in self.entries if each.claims(route.spec)] if route.proposed_here else []

    def is_local(self, entry: PatternEntry) -> bool:
        """Whether an entry follows this side's graph."""
        return entry.from_client == self._link.is_client

    def names_for(self, entry: PatternEntry) -> Names | None:
        """Return the names of the graph that an entry follows, or None as long as they are unknown."""
        return self.here if self.is_local(entry) else self.there

    def names(self) -> Iterator[Match]:
        """Yield the names of both graphs, with their types."""
        for local, names in ((True, self.here), (False, self.there)):
            for (kind, name), type_name in (names or {}).items():
                yield local, kind, name, type_name

    def wanted(self) -> dict[Identity, tuple[PatternEntry, Topic]]:
        """Return the matching topics, each with its winning pattern, in the order of patterns and names."""
        session, rights = self._context.session, as_if_listed(self._link.end.rights)
        own = set(session.own_topics) - {None}  # as most topics have no remote_topic
        found: list[tuple[int, str, Topic]] = []
        before, self._known = self._known, {}  # names that are gone are forgotten
        for key in self.names():
            match = self._known[key] = before[key] if key in before else self._first_match(*key, rights)
            if match is not None and own.isdisjoint((key[2], match[1].topic, match[1].remote_topic)):
                found.append((match[0], key[2], match[1]))
        found.sort(key=itemgetter(0, 1))
        wanted: dict[Identity, tuple[PatternEntry, Topic]] = {}
        for at, _, topic in found:
            wanted.setdefault(topic.identity, (self.entries[at], topic))
        return wanted

    def _first_match(
        self, local: bool, kind: Kind, name: str, type_name: str, rights: Rights
    ) -> tuple[int, Topic] | None:
        """Return the index of the first pattern that matches a name, and the topic to bridge."""
        for at, entry in enumerate(self.entries):
            if entry.topic.kind == kind and self.is_local(entry) == local:
                topic = entry.match(name, type_name)
                if topic is not None and self._may_have(entry, topic, rights):
                    return at, topic
        return None

    def entry_of(self, route: Route) -> PatternEntry | None:
        """Return the pattern that matches a route's topic, which may be gone, or None."""
        rights = as_if_listed(self._link.end.rights)
        for entry in self.claiming(route):
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
