"""What a receiving half publishes with: an output for the messages of each source (`rsb_bridge.route.sources`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import msgspec

from rsb_bridge.model.limits import KEPT_DEPTH
from rsb_bridge.ros.announcements import Origin
from rsb_bridge.ros.ros_interface import Endpoint, RosError
from rsb_bridge.route.latched import LatchedFullError, LatchedTopic
from rsb_bridge.route.publisher_qos import AUTO_DEPTH
from rsb_bridge.route.type_budget import TypeUse
from rsb_bridge.route.volatile import BURST_DEPTH, VolatileTopic

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from rsb_bridge.context import Context
    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.ros_interface import Publisher
    from rsb_bridge.route.peer import Peer
    from rsb_bridge.wire.records import Source


class Subject(NamedTuple):
    """A topic to publish.

    Attributes:
        topic: its name here.
        type_name: of its type.
        type_hash: of its type.
        qos: of the publishers; of a volatile topic, a depth of 0 means that nobody has chosen one.
    """

    topic: str
    type_name: str
    type_hash: str
    qos: Qos


class _Announced:
    """A DDS publisher that the other bridges of the domain are told of, for as long as it is open."""

    def __init__(self, publisher: Publisher, closed: Callable[[bytes], None]) -> None:
        self.gid = publisher.gid
        self.publish = publisher.publish
        self._publisher = publisher
        self._closed = closed

    @property
    def subscriber_count(self) -> int:
        return self._publisher.subscriber_count

    @property
    def acknowledged(self) -> bool:
        return self._publisher.acknowledged

    def close(self) -> None:
        self._closed(self.gid)
        self._publisher.close()


class _Output:
    """The publishers of one source.

    Attributes:
        sink: what messages are given to.
    """

    def __init__(
        self, context: Context, peer: Peer, subject: Subject, origin: Origin, failed: Callable[[Exception], None]
    ) -> None:
        self._context = context
        self._peer = peer
        self._subject = subject
        self._origin = origin
        self._gids: set[bytes] = set()
        self.came_by = origin.via[:-1]  # without the sender, which may be another process by now
        self.sink: VolatileTopic | LatchedTopic
        depth = subject.qos.depth
        if subject.qos.latched:
            self.sink = LatchedTopic(context.loop, self._advertise, peer.budget.kept, depth, failed)
        else:
            keeps_all = subject.qos.history == "keep_all"
            burst = depth == 0 and not keeps_all and subject.qos.reliability == "reliable"
            lasting = depth or AUTO_DEPTH
            first = BURST_DEPTH if burst else lasting
            self.sink = VolatileTopic(
                self._advertise(first),
                KEPT_DEPTH if keeps_all else first,
                peer.budget.unacknowledged,
                context.now,
                self._advertise,
                lasting_depth=lasting if burst else None,
            )

    def set_origin(self, origin: Origin) -> None:
        """Its messages come from elsewhere now, or none come any more; may raise RosError."""
        if origin != self._origin:
            self._origin = origin
            for gid in tuple(self._gids):
                self._announce(gid)

    def _advertise(self, depth: int) -> Publisher:
        topic, type_name, type_hash, qos = self._subject
        publisher = self._context.ros.advertise(
            topic, type_name, type_hash, msgspec.structs.replace(qos, depth=depth), origin=self._peer.name
        )
        self._gids.add(publisher.gid)
        try:
            self._announce(publisher.gid)
        except RosError:
            self._closed(publisher.gid)
            publisher.close()
            raise
        return _Announced(publisher, self._closed)

    def _announce(self, gid: bytes) -> None:
        topic, type_name, type_hash, qos = self._subject
        endpoint = Endpoint(f"/{self._context.ros.node_name}", type_name, type_hash, qos, gid)
        self._context.announcements.announce(topic, self._peer.name, endpoint, self._origin)

    def _closed(self, gid: bytes) -> None:
        self._gids.discard(gid)
        self._context.announcements.withdraw(gid)


class Outputs:
    """A route's outputs, by the numbers of their sources.

    Attributes:
        sinks: what messages are given to, likewise.
    """

    def __init__(self, context: Context, peer: Peer, failed: Callable[[Exception], None]) -> None:
        """There are none yet.

        Args:
            context: what every part of the engine shares.
            peer: whose messages are published.
            failed: told of what goes wrong with a message later than it is published.
        """
        self._context = context
        self._peer = peer
        self._failed = failed
        self._type = TypeUse(context.ros, peer.budget.types)
        self._outputs: list[_Output] = []
        self.sinks: list[VolatileTopic | LatchedTopic] = []

    def __len__(self) -> int:
        return len(self._outputs)

    def make(self, subject: Subject, sources: Sequence[Source]) -> None:
        """Have an output for each source, or for the first so many; those that are there have this subject.

        Raises:
            RosError: not even the first can be, or the link has too many types.
            LatchedFullError: likewise.
        """
        if not self._outputs:
            self._type.begin(subject.type_name, subject.type_hash)
        for number, source in enumerate(sources):
            origin = Origin(source.via, source.live)
            try:
                if number < len(self._outputs):
                    self._outputs[number].set_origin(origin)
                else:
                    self._add(subject, origin)
            except (RosError, LatchedFullError):
                self.close(number)  # messages of what cannot be announced could go round
                if number == 0:
                    raise
                return

    def renumber(self, sources: Sequence[Source]) -> None:
        """A new opening numbers sources anew: outputs go on with the one whose messages they keep, or are closed."""
        count = 0
        for source in sources:
            rest = range(count, len(self._outputs))
            at = next((each for each in rest if self._outputs[each].came_by == source.via[:-1]), None)
            if at is None:
                break
            self._outputs.insert(count, self._outputs.pop(at))
            self.sinks.insert(count, self.sinks.pop(at))
            count += 1
        self.close(count)

    def _add(self, subject: Subject, origin: Origin) -> None:
        further = len(self._outputs) > 0
        if further and not self._peer.budget.further_publishers.take(1):
            raise RosError("this link has too many publishers")
        try:
            output = _Output(self._context, self._peer, subject, origin, self._failed)
        except (RosError, LatchedFullError):
            if further:
                self._peer.budget.further_publishers.give(1)
            raise
        self._outputs.append(output)
        self.sinks.append(output.sink)

    @property
    def subscriber_count(self) -> int:
        """How many subscriptions of other nodes there are."""
        return max((sink.subscriber_count for sink in self.sinks), default=0)

    def close(self, first: int = 0) -> None:
        """Close the outputs from that number on."""
        while len(self._outputs) > first:
            self.sinks.pop()
            self._outputs.pop().sink.close()
            if self._outputs:
                self._peer.budget.further_publishers.give(1)
        if not first:
            self._type.end()

    # --- of latched topics

    def _latched(self) -> list[LatchedTopic]:
        return [sink for sink in self.sinks if isinstance(sink, LatchedTopic)]

    def opened(self) -> dict[bytes, int]:
        """A new opening begins; the number of the newest message of each publisher of the sending side."""
        newest: dict[bytes, int] = {}
        for topic in self._latched():
            topic.opened()
            newest |= topic.newest()
        return newest

    @property
    def has_kept(self) -> bool:
        """Whether messages of the sending side are kept."""
        return any(topic.has_kept for topic in self._latched())

    def present(self, publishers: Collection[bytes]) -> None:
        """The sending side tells which of its publishers are there."""
        for topic in self._latched():
            topic.present(publishers)

    def tick(self) -> None:
        """Once a second."""
        for topic in self._latched():
            topic.tick()
