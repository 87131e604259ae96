"""The ends of internal routes: sources of their messages, and drains where they arrive. They never reach DDS.

A route gets its endpoints from the `InternalEnds` of its purpose, as a topic's route gets them from
`rsb_bridge.ros.ros_interface.RosInterface`.
"""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rsb_bridge.model.qos import Qos
from rsb_bridge.ros.ros_interface import Endpoint, Liveliness, Publisher, RawMessage, RosError, Subscription

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.ros.publication_numbers import PublicationNumbers
    from rsb_bridge.ros.ros_interface import OnFailure, Sink, TopicSpec

_NODE = "/rsb_internal"
GID = b"rsb_internal".ljust(16, b"\0")
HEADER = b"\x00\x01\x00\x00"
"""The encapsulation header of CDR, little endian, with which each message of a route begins (PROTOCOL.md, 3)."""

SourceT = TypeVar("SourceT", bound=Subscription)
DrainT = TypeVar("DrainT", bound=Publisher)


class BytesSource:
    """Sends bytes of its user's making on one internal route."""

    def __init__(self, sink: Sink, closed: Callable[[], None]) -> None:
        self._sink = sink
        self._closed = closed
        self._number = 0
        self.liveliness = Liveliness(alive=1)
        self.matched = 1
        self.refuses = False
        self.closed = False

    def send(self, content: bytes, stamp: int) -> None:
        """Send a message. This may block, so not on the I/O thread.

        Args:
            stamp: ns since the epoch, when it came to the link.
        """
        if not self.closed:
            self._number += 1
            self._sink([RawMessage(HEADER + content, stamp, GID, self._number)])

    def close(self) -> None:
        """Send nothing more."""
        self.closed = True
        self._closed()


class BytesDrain:
    """Takes the bytes of a `BytesSource` where they arrive.

    Attributes:
        taken: called with each message, maybe on the ROS thread; set by the user.
    """

    subscriber_count = 1
    refuses = False
    acknowledged = True

    def __init__(self, closed: Callable[[], None]) -> None:
        self._closed = closed
        self.taken: Callable[[bytes], None] = lambda _: None
        self.gid = secrets.token_bytes(len(GID))

    def assert_liveliness(self) -> None:
        """Do nothing: its messages have no lease."""

    def publish(self, payload: bytes) -> None:
        """Take one message."""
        self.taken(payload[len(HEADER) :])

    def close(self) -> None:
        """Take no more."""
        self._closed()


class InternalEnds(Generic[SourceT, DrainT]):
    """The ends of all internal routes of one purpose, over all links. Only a link that serves the purpose has ends.

    Attributes:
        sources: make the messages of the internal routes that this side sends on, by internal route and link.
        drains: take the messages of the internal routes that this side receives on, by internal route and link.
    """

    def __init__(self, purpose: Purpose) -> None:
        self._endpoint = Endpoint(_NODE, purpose.type_name, purpose.type_hash, Qos(), GID)
        self._purpose = purpose
        self._made: dict[Hashable, tuple[Callable[[Sink, Callable[[], None]], SourceT], Callable[..., DrainT]]] = {}
        self.sources: dict[tuple[str, Hashable], SourceT] = {}
        self.drains: dict[tuple[str, Hashable], DrainT] = {}

    def serve(
        self,
        link: Hashable,
        source: Callable[[Sink, Callable[[], None]], SourceT],
        drain: Callable[[Callable[[], None]], DrainT],
    ) -> None:
        """Make the ends of a link's internal routes from now on.

        Args:
            source: makes a source, which passes its messages to the sink, and calls the function once it is closed.
            drain: makes a drain, which calls the function once it is closed.
        """
        self._made[link] = source, drain

    def forget(self, link: Hashable) -> None:
        """Make no more ends of a link that was removed."""
        self._made.pop(link, None)

    def publishers(self, topic: str) -> list[Endpoint]:
        """See `rsb_bridge.ros.ros_interface.RouteEnds`, also for the methods below."""
        return [self._endpoint] if self._purpose.has_name(topic) else []

    subscriptions = publishers

    def subscribe(
        self,
        spec: TopicSpec,
        sink: Sink,
        origin: Hashable,
        on_failure: OnFailure | None = None,
        numbers: PublicationNumbers | None = None,
        **__: object,
    ) -> Subscription:
        key, (make, _) = (spec.topic, origin), self._makers(origin)
        source: SourceT = make(sink, lambda: _forget(self.sources, key, source))
        self.sources[key] = source
        return source

    def advertise(self, spec: TopicSpec, origin: Hashable) -> Publisher:
        key, (_, make) = (spec.topic, origin), self._makers(origin)
        drain: DrainT = make(lambda: _forget(self.drains, key, drain))
        self.drains[key] = drain
        return drain

    def _makers(self, link: Hashable) -> tuple[Callable[[Sink, Callable[[], None]], SourceT], Callable[..., DrainT]]:
        if link not in self._made:
            raise RosError(f"{link} has no internal routes for {self._purpose.name}")
        return self._made[link]


def _forget(held: dict[tuple[str, Hashable], Any], key: tuple[str, Hashable], which: object) -> None:
    # A route that was opened again has another end under this key by now.
    if held.get(key) is which:
        del held[key]
