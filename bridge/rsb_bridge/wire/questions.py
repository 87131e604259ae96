"""What either side asks the other, and the answers (PROTOCOL.md, 3)."""

from __future__ import annotations

# msgspec resolves the annotations at run time
from rsb_bridge.wire.fields import Count, DescriptionText, Kinds, RouteId  # noqa: TC001
from rsb_bridge.wire.message import ControlMessageBase
from rsb_bridge.wire.records import TopicEntry  # noqa: TC001


class ListTopics(ControlMessageBase, frozen=True):
    """Either side asks for the peer's topics. Answered by a `TopicList` with the same request number.

    Attributes:
        request: counts up.
        kinds: what is asked for besides topics; those that are not known are a newer peer's, and ignored.
    """

    request: Count
    kinds: Kinds = ()


class TopicList(ControlMessageBase, frozen=True):
    """The answer to `ListTopics`."""

    request: Count
    topics: tuple[TopicEntry, ...]


class AskType(ControlMessageBase, frozen=True):
    """Either side asks for the description of a route's type. Answered by a `TypeText`.

    Attributes:
        route: route id.
    """

    route: RouteId


class TypeText(ControlMessageBase, frozen=True):
    """The answer to `AskType`.

    Attributes:
        route: route id.
        text: the description, zstd-compressed (`rsb_bridge.cdr.description`); empty: this side does not know it.
    """

    route: RouteId
    text: DescriptionText = b""
