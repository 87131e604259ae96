"""An entry of a session whose name is a pattern, ready to be held against names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.names import client_topic, expand_type_name, is_topic_name, server_topic
from rsb_bridge.model.patterns import Pattern, is_hidden
from rsb_bridge.model.qos import AUTO

if TYPE_CHECKING:
    from rsb_bridge.model.session import Topic


def from_client_graph(topic: Topic) -> bool:
    """Whether an entry follows the client's graph: where it is published, or where the provider is."""
    return (topic.direction == "transmit") == (topic.kind == "topic")


class PatternEntry:
    """One entry.

    Args:
        topic: whose name is a pattern; validated.
        client: the client's name: the prefix.
        prefixed: whether the server's names of what has no `Topic.remote_topic` have the prefix.
        always_prefixed: whether the others have it, too, unless they begin with it already.

    Attributes:
        topic: likewise.
        source: the pattern of names in the graph that is followed.
        from_client: whether that is the client's.
        left_out: what the last names that matched could not be bridged for, by name.
        beyond: how many more names match than there is room for.
    """

    def __init__(self, topic: Topic, *, client: str, prefixed: bool, always_prefixed: bool = False) -> None:
        self.topic = topic
        self.from_client = from_client_graph(topic)
        self.left_out: dict[str, str] = {}
        self.beyond = 0
        self._here = Pattern(topic.topic)
        self._remote = None if topic.remote_topic is None else Pattern(topic.remote_topic)
        self._excepts = [Pattern(each) for each in topic.excepts]
        self._type = "" if topic.type == AUTO else expand_type_name(topic.type)
        self._client = client
        self._prefixed = prefixed if self._remote is None else False
        self._always = always_prefixed
        self.source = self._here if self.from_client else Pattern(self.server_name(topic.remote_topic or topic.topic))

    def server_name(self, name: str) -> str:
        """The server's name of what the client, or its session's `Topic.remote_topic`, calls so."""
        if self._prefixed or (self._always and client_topic(name, self._client) is None):
            return server_topic(name, self._client)
        return name

    def match(self, name: str, type_name: str | None) -> Topic | None:
        """What a name of the graph that is followed is to be bridged as; None: it does not match.

        Args:
            name: in that graph.
            type_name: its type there; empty: its endpoints disagree; None: whatever it is.
        """
        parts = self.source.match(name)
        if parts is None or (self._type and type_name is not None and type_name != self._type):
            return None
        on_client = self._here.fill(parts)
        remote = None if self._remote is None else self._remote.fill(parts)
        if is_hidden(on_client) or not is_topic_name(on_client) or self.excepts(on_client):
            return None
        return msgspec.structs.replace(self.topic, topic=on_client, remote_topic=remote, excepts=())

    def matches_client(self, name: str) -> bool:
        """Whether a name on the client is one of those that it stands for."""
        return self._here.match(name) is not None and not self.excepts(name)

    def excepts(self, name: str) -> bool:
        """Whether it leaves out a name on the client."""
        return any(each.match(name) is not None for each in self._excepts)
