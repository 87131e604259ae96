"""The subscriptions of a topic, by whether they hear a publisher."""

from __future__ import annotations

import msgspec


class Deaf(msgspec.Struct, frozen=True):
    """A node with a subscription that DDS does not match with the publisher."""

    node: str  # its full name, or empty while only its subscription is discovered
    cause: str  # ``type_conflict``, ``qos_incompatible``, or empty if neither type nor QoS keeps them apart
    reason: str  # the same in words, with the remedy


class Audience(msgspec.Struct, frozen=True, omit_defaults=True):
    """The subscriptions of other nodes to a publisher's topic."""

    count: int = 0  # subscriptions that DDS has matched: only these get its messages
    nodes: tuple[str, ...] = ()  # some of the nodes that can be among them
    deaf: tuple[Deaf, ...] = ()  # some of the nodes that cannot

    @property
    def subscribers(self) -> tuple[str, ...]:
        """All of these nodes whose names are known."""
        return tuple(sorted({*self.nodes, *(each.node for each in self.deaf if each.node)}))

    @property
    def is_settled(self) -> bool:
        """Whether nothing is left that DDS may still match."""
        return all(each.cause for each in self.deaf)


NOBODY = Audience()
